"""What an update found settled, so that the next one only looks whether anything moved: fleets of very many maps.

One sealed document per fleet in the store. A map's line holds what its row was and what that depended on: its entry
in the fleet file, its recordings, the files its run watched (with size, times and inode), what `latest` names, when
something fetched from a server gets too old. Code and library versions count for all lines at once. Where
anything differs, or a file is so young that its stamp may lie, the map is planned.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from flexmap_tasks.engine.finished import Watched, code_files
from flexmap_tasks.engine.libraries import library_versions
from flexmap_tasks.engine.sources import RACY_NS, Look, is_old, look
from flexmap_tasks.errors import FlexMapError
from flexmap_tasks.fleet_config import FleetConfig, FleetMap
from flexmap_tasks.store.artifact import canonical_json, digest_of, seal, unseal
from flexmap_tasks.store.store import Store
from flows.fleet_recordings import choose, find_recordings

FORMAT = 1


@dataclass(frozen=True, slots=True)
class Settled:
    """A map's line.

    entry : digest of its part of the fleet file and of its recordings; files : stamp by path
    latest : what `latest` named; expires_s : seconds since 1970, None for never; row : the row of the summary
    """

    entry: str
    files: Mapping[str, Look]
    latest: str | None
    expires_s: float | None
    row: Mapping[str, Any]


class Index:
    """The lines of one fleet by map; empty when code or libraries are not those it was written with."""

    def __init__(self, store: Store, fleet: FleetConfig, made_with: str) -> None:
        self._store, self._fleet, self._made_with = store, fleet, made_with
        body = unseal(store.backend.get(_path(fleet)))
        usable = body is not None and body.get("format") == FORMAT and body["made_with"] == made_with
        self._lines: dict[str, dict[str, Any]] = body["lines"] if usable and body is not None else {}
        self._shared = digest_of(canonical_json(fleet.parameters))

    def row(self, entry: FleetMap) -> Mapping[str, Any] | None:
        """The row of a map for which nothing moved; None when it has to be planned."""
        line = self._lines.get(entry.name)
        if line is None or (line["expires_s"] is not None and line["expires_s"] < time.time()):
            return None
        if any(look(path) != was for path, was in line["files"].items()):
            return None
        if _latest(self._store, entry.name) != line["latest"] or self._mark(entry)[0] != line["entry"]:
            return None
        row: Mapping[str, Any] = line["row"]
        return row

    def line(
        self, entry: FleetMap, watched: Watched, expires_s: float | None, row: Mapping[str, Any]
    ) -> Settled | None:
        """A line for a map just settled; None when its files are too young to trust their stamps."""
        mark, newest_ns = self._mark(entry)
        config = look(entry.config)
        now_ns = time.time_ns()
        if mark is None or not watched.steady or not is_old(config, now_ns) or newest_ns > now_ns - RACY_NS:
            return None
        files = {**watched.inputs, str(entry.config): config}
        return Settled(mark, files, _latest(self._store, entry.name), expires_s, row)

    def write(self, entries: Iterable[FleetMap], new: Mapping[str, Settled]) -> None:
        """Keep the lines of maps that are in the fleet, with those that are new."""
        lines = {e.name: self._lines[e.name] for e in entries if e.name in self._lines}
        lines |= {name: asdict(line) for name, line in new.items()}
        if lines != self._lines:
            body = {"format": FORMAT, "made_with": self._made_with, "lines": lines}
            self._store.backend.put(_path(self._fleet), seal(body), replace=True)

    def _mark(self, entry: FleetMap) -> tuple[str | None, int]:
        """Digest of a map's entry and recordings, and the newest stamp of those; None while one is on its way."""
        found: list[Any] = [self._shared, entry.model_dump(mode="json")]
        newest_ns = 0
        if entry.recordings is not None:
            try:
                arrived, moving = find_recordings(entry.recordings, time.time())
            except FlexMapError:
                return None, 0
            if moving:
                return None, 0
            choices = choose(entry.recordings, arrived, time.time())
            found.append([[c.recording.path, c.recording.stamp, c.used] for c in choices])
            newest_ns = max((max(recording.stamp[1:3]) for recording in arrived), default=0)
        return digest_of(canonical_json(found)), newest_ns


def made_with() -> str:
    """Digest over the stamps of our code and the versions of the libraries."""
    root = Path(__file__).resolve().parents[1]
    code = [str(path) for package in ("flexmap_tasks", "flows") for path in code_files(root / package)]
    return digest_of(canonical_json([[[path, look(path)] for path in code], library_versions(), sys.version]))


def _latest(store: Store, name: str) -> str | None:
    try:
        return os.readlink(f"{store.releases}/{name}/latest")  # noqa: PTH115 - asked of every map of a fleet
    except OSError:
        return None


def _path(fleet: FleetConfig) -> str:
    return f"fleets/{fleet.name}.json"
