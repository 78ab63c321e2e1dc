"""What the editor knows of one map, what it says about pairs, and how it saves them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from flexmap_tasks.alignment.control_points import control_points
from flexmap_tasks.alignment.judge_points import sheet_left_out_m
from flexmap_tasks.alignment.rubber_sheet import rubber_sheet
from flexmap_tasks.alignment.tried_points import SolvedDrive, solved_drive, tried
from flexmap_tasks.config import FlexMapConfig, PairParams
from flexmap_tasks.errors import FlexMapError
from flexmap_tasks.evaluation.harm_geometry import shape_change
from flexmap_tasks.evaluation.quality import MUCH_WIDER_M
from flexmap_tasks.model.alignment import ControlPoints, Warp
from flexmap_tasks.model.source import Source
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.report.editing import Effect, control_point_page, preview
from flexmap_tasks.report.maps import moved
from flexmap_tasks.store.store import Store
from flows.editor.pairs import control_points_of, csv_of, own_points
from flows.editor.saved_file import SavedFile, who_and_when
from flows.editor.values import values_of

NEEDED = (
    "project_utm", "umeyama", "ingest_slam", "ingest_lanelet_map", "cloud_extent", "automatic_control_points",
)  # fmt: skip
"""Stages whose values the editor works with, as far as the run has them."""

FEWEST = 3


class EditSession:
    """The control points of one map. All methods may be called from several threads."""

    def __init__(self, config: FlexMapConfig, store: Store, file: Path, places: tuple[str, ...]) -> None:
        """Compute or fetch what comes before the control points.

        file : what they are saved to; places : the pages that there are
        """
        self._config, self._file, self._places = config, SavedFile(file), places
        values = values_of(store, map_update(config), NEEDED)
        projected = values["project_utm"]
        self._projection, self._gnss = projected.projection, projected.gnss_track
        self._slam, self._motion = values["ingest_slam"], values["umeyama"]
        self._map, self._extent = values.get("ingest_lanelet_map"), values.get("cloud_extent")
        self._automatic: ControlPoints | None = values.get("automatic_control_points")
        self._read()
        self._base = ThreadPoolExecutor(1).submit(self._solved) if self._by_graph else None

    @property
    def _by_graph(self) -> bool:
        return self._config.alignment.method == "pose_graph"

    def _solved(self) -> SolvedDrive:
        """The pose graph without control points: seconds, once; a page need not wait for it."""
        params = self._config.alignment.pose_graph
        return solved_drive(self._slam, self._gnss, self._projection, params)

    def page(self) -> bytes:
        """The page with what the file holds now."""
        base = self._file.digest()
        points = self._read()
        still = Warp(self._motion, None)
        warp = still if points is None or self._by_graph else self._warp(points)
        return control_point_page(
            self._config.map, self._projection, self._gnss, self._slam, warp, points, self._map,
            self._config.alignment.method, base, self._places,
        )  # fmt: skip

    def preview(self, sent: dict[str, Any]) -> dict[str, Any]:
        """What the pairs would do: track, deviation, lane widths, residual and leave-one-out error of each."""
        points = control_points_of(sent.get("pairs"))
        try:
            effect, error = self._effect(points), None
        except FlexMapError as problem:
            effect, error = Effect(Warp(self._motion, None)), str(problem)
        told = preview(points, effect, self._motion, self._slam, self._gnss)
        return {**told, "lanes": self._lanes(effect.warp), "error": error}

    def _effect(self, points: ControlPoints) -> Effect:
        """The warp of the pairs, by the method that runs use."""
        if self._base is not None:
            found = tried(self._base.result(), points, self._motion)
            return Effect(found.warp, found.antenna_m, found.residual_m, found.left_out_m)
        warp = self._warp(points)
        if warp.sheet is None or int(points.used.sum()) <= FEWEST:
            return Effect(warp)
        return Effect(warp, left_out_m=sheet_left_out_m(points, warp.sheet))

    def _lanes(self, warp: Warp) -> dict[str, Any] | None:
        """How wide the lanes become, over nine cross sections of each; those that change by more than 10 cm."""
        if self._map is None:
            return None
        shape = shape_change(self._map, moved(self._map, warp))
        change = shape.width_change_m.reshape(len(shape.lanelet_id), -1)
        known = np.where(np.isfinite(change), change, 0.0)
        worst = known.max(axis=1, initial=0.0)
        much = np.flatnonzero((worst > MUCH_WIDER_M) | shape.folded)
        return {
            "max_m": float(worst.max(initial=0.0)),
            "share_over_10cm": float((known > MUCH_WIDER_M).mean()) if known.size else 0.0,
            "folded": int(np.count_nonzero(shape.folded)),
            "lanelets": [[str(shape.lanelet_id[i]), round(float(worst[i]), 3)] for i in much.tolist()],
        }

    def save(self, sent: dict[str, Any]) -> dict[str, Any]:
        """Write the pairs to the file, if the pipeline would take them and nobody else wrote it meanwhile."""
        points = control_points_of(sent.get("pairs"))
        own = points if self._automatic is None else own_points(points, self._read(), self._automatic)
        content = csv_of(own, self._motion, self._projection, " ".join(who_and_when()))
        base = self._file.replace(content, sent.get("base"), self._checked)
        said = f"saved {len(own)} pairs to {self._file.name}; flexmap run makes the map with them"
        return {"said": said, "base": base}

    def _read(self) -> ControlPoints | None:
        return self._checked(self._file.path) if self._file.digest() else self._automatic

    def _checked(self, path: Path) -> ControlPoints:
        source = Source(self._file.name, path)
        alignment = self._config.alignment
        params = PairParams(**alignment.control_points.model_dump(), sheet=alignment.method == "rubber_sheet")
        return control_points(
            source,
            self._slam,
            self._gnss,
            motion=self._motion,
            projection=self._projection,
            params=params,
            automatic=self._automatic,
        )

    def _warp(self, points: ControlPoints) -> Warp:
        if int(points.used.sum()) < FEWEST:
            return Warp(self._motion, None)
        sheet = self._config.alignment.rubber_sheet
        return rubber_sheet(points, self._motion, self._slam, self._map, self._extent, params=sheet)
