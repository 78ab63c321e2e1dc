"""What the editor knows of one map, what it says about pairs, and how it saves them."""

from __future__ import annotations

import getpass
import os
import tempfile
import threading
import typing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from flexmap_tasks.alignment.control_points import control_points
from flexmap_tasks.alignment.rubber_sheet import rubber_sheet
from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.execute import Engine
from flexmap_tasks.engine.graph import Graph, Ref
from flexmap_tasks.engine.local import heal
from flexmap_tasks.errors import ConfigError, FlexMapError
from flexmap_tasks.model.alignment import ControlPoints, Warp
from flexmap_tasks.model.source import Source
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.report.editing import control_point_page, left_out_error_m, preview
from flexmap_tasks.store.artifact import Artifact, digest_of
from flexmap_tasks.store.store import Store
from flows.editor.pairs import control_points_of, csv_of

NEEDED = ("project_utm", "umeyama", "ingest_slam", "ingest_lanelet_map", "cloud_extent")
"""Stages whose values the editor works with, as far as the run has them."""

FEWEST = 3
MOST_LEFT_OUT = 60
"""With more pairs in use, leaving each out in turn would take longer than a person waits."""


class EditSession:
    """One map under a person's hands. All methods may be called from several threads."""

    def __init__(self, config: FlexMapConfig, store: Store) -> None:
        """Compute or fetch what comes before the control points.

        Raises ConfigError where the configuration names no control point file.
        """
        file = config.alignment.control_points_file
        if file is None:
            rule = "name the file to save to: --set alignment.method=rubber_sheet alignment.control_points_file=..."
            raise ConfigError("configuration", rule, "alignment.control_points_file")
        self._config, self._file, self._lock = config, file, threading.Lock()
        values = heal(lambda: _values(Engine(store), map_update(config)))
        projected = values["project_utm"]
        self._projection, self._gnss = projected.projection, projected.gnss_track
        self._slam, self._motion = values["ingest_slam"], values["umeyama"]
        self._map, self._extent = values.get("ingest_lanelet_map"), values.get("cloud_extent")
        self._digest, self._points = self._read()

    def page(self) -> bytes:
        """The page with what the file holds now."""
        with self._lock:
            self._digest, self._points = self._read()
            warp = self._warp(self._points) if self._points is not None else Warp(self._motion, None)
            return control_point_page(
                self._config.map,
                self._projection,
                self._gnss,
                self._slam,
                warp,
                self._points,
                self._map,
                self._config.alignment.method,
            )

    def preview(self, sent: Any) -> dict[str, Any]:
        """What the pairs would do: track, deviation, shift and leave-one-out error of each."""
        points = control_points_of(sent)
        error = None
        try:
            warp = self._warp(points)
        except FlexMapError as problem:
            warp, error = Warp(self._motion, None), str(problem)
        told = preview(points, warp, self._slam, self._gnss)
        return {**told, "left_out_m": self._left_out(points), "error": error}

    def save(self, sent: Any) -> dict[str, Any]:
        """Write the pairs to the file the pipeline reads, if it would take them and nobody else wrote it meanwhile.

        The file is there whole or not at all.
        """
        points = control_points_of(sent)
        now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        content = csv_of(points, self._motion, self._projection, f"{getpass.getuser()} {now}")
        with self._lock:
            if _digest(self._file) != self._digest:
                return {"error": f"{self._file.name} was changed by someone else; reload the page to see it"}
            handle, name = tempfile.mkstemp(dir=self._file.parent, prefix=f".{self._file.name}.")
            try:
                with os.fdopen(handle, "wb") as stream:
                    stream.write(content)
                    stream.flush()
                    os.fsync(stream.fileno())
                self._checked(Path(name))
                Path(name).chmod(0o644)
                Path(name).replace(self._file)
            finally:
                Path(name).unlink(missing_ok=True)
            self._digest = digest_of(content)
        return {
            "said": f"saved {len(points)} pairs to {self._file.name}; flexmap run makes the map with them"
        }

    def _read(self) -> tuple[str | None, ControlPoints | None]:
        return _digest(self._file), self._checked(self._file) if self._file.exists() else None

    def _checked(self, path: Path) -> ControlPoints:
        source = Source(self._file.name, path)
        params = self._config.alignment.control_points
        return control_points(
            source, self._slam, self._gnss, motion=self._motion, projection=self._projection, params=params
        )

    def _warp(self, points: ControlPoints) -> Warp:
        if int(points.used.sum()) < FEWEST:
            return Warp(self._motion, None)
        sheet = self._config.alignment.rubber_sheet
        return rubber_sheet(points, self._motion, self._slam, self._map, self._extent, params=sheet)

    def _left_out(self, points: ControlPoints) -> list[float | None]:
        """How far each pair lies from where a sheet of all others would put it."""
        used = np.flatnonzero(points.used)
        out: list[float | None] = [None] * len(points)
        if not FEWEST < len(used) <= MOST_LEFT_OUT:
            return out
        for row in used.tolist():
            try:
                others = self._warp(points.take(np.setdiff1d(used, row)))
            except FlexMapError:
                continue
            out[row] = left_out_error_m(points.source_xy_m[row], points.target_xy_m[row], others)
        return out


def _values(engine: Engine, graph: Graph) -> dict[str, Any]:
    """Values of the stages the editor needs, by name; runs them and what they need, nothing else."""
    wanted = {name for name in NEEDED if name in graph.nodes}
    needed = set(wanted)
    for node in reversed(list(graph)):
        if node.name in needed:
            needed |= set(node.upstream())
    artifacts: dict[str, Artifact] = {}
    values = {}
    for node in graph:
        if node.name not in needed:
            continue
        bound = {name: engine.bind(ref, artifacts) for name, ref in node.inputs.items()}
        artifacts[node.name] = engine.run(node, bound).artifact
        if node.name in wanted:
            kind = typing.get_type_hints(node.stage.function)["return"]
            values[node.name] = engine.load(engine.bind(Ref(node.name, node.stage.artifact), artifacts), kind)
    return values


def _digest(path: Path) -> str | None:
    try:
        return digest_of(path.read_bytes())
    except FileNotFoundError:
        return None
