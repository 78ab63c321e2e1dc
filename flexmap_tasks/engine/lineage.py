"""Where a value of a released map comes from: back to the way, its version, the match, the settings and the files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from flexmap_tasks.engine.explain import source_files, upstream
from flexmap_tasks.engine.released import Released
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.artifacts import decode
from flexmap_tasks.model.conflation import LaneCheck, Matches, Transfers
from flexmap_tasks.store.store import Store

T = TypeVar("T")
TRANSFER_STAGES = ("transfer", "match")


@dataclass(frozen=True, slots=True)
class ValueOrigin:
    """One value that OSM offered a lanelet.

    transfer : its row of transfer.parquet; matches : the rows of matches.parquet between that lanelet and that way
    """

    transfer: Mapping[str, Any]
    matches: tuple[Mapping[str, Any], ...]


@dataclass(frozen=True, slots=True)
class FileOrigin:
    """A released file.

    stages : the stage that wrote it and all before it, nearest first; sources : the files from outside they read
    """

    file: str
    sha256: str
    stages: tuple[str, ...]
    sources: Mapping[str, Mapping[str, Any]]


def file_lineage(store: Store, release: Released, file: str) -> FileOrigin:
    """From a released file back to the files it was made of."""
    entry = release.manifest["files"][file]
    stages = upstream(release, entry["stage"])
    known = source_files(store, release)
    sources = {name: source for name, source in known.items() if name.split(".")[0] in stages}
    return FileOrigin(file, entry["sha256"], tuple(stages), sources)


def value_lineage(release: Released, lanelet_id: int, key: str | None = None) -> list[ValueOrigin]:
    """From a lanelet's attributes back to OpenStreetMap; empty when none of them (or not `key`) came from there.

    Raises InputError where the map has no such lanelet, or the release was made without OpenStreetMap.
    """
    transfers = _table(release, Transfers, "transfer.parquet")
    matches = _table(release, Matches, "matches.parquet")
    hit = (transfers.lanelet_id == lanelet_id) | (transfers.source_lanelet_id == lanelet_id)
    if not hit.any() and lanelet_id not in _known_lanelets(release, matches):
        raise InputError(release.id, f"has no lanelet {lanelet_id} that takes part in matching")
    if key is not None:
        hit &= transfers.key == key
    return [_value_origin(row, matches) for row in _rows(transfers, np.flatnonzero(hit))]


def settings_behind(release: Released) -> dict[str, Mapping[str, Any]]:
    """Settings of the stages that decide what is transferred."""
    stages = release.manifest["stages"]
    return {name: stages[name]["params"] for name in TRANSFER_STAGES if name in stages}


def _value_origin(row: Mapping[str, Any], matches: Matches) -> ValueOrigin:
    same = (matches.lanelet_id == row["source_lanelet_id"]) & (matches.way_id == row["way_id"])
    return ValueOrigin(row, tuple(_rows(matches, np.flatnonzero(same))))


def _known_lanelets(release: Released, matches: Matches) -> set[int]:
    known = set(matches.lanelet_id.tolist())
    if "lane_check.parquet" in release.manifest["files"]:
        known |= set(_table(release, LaneCheck, "lane_check.parquet").lanelet_id.tolist())
    return known


def _rows(table: Any, rows: Any) -> Iterator[dict[str, Any]]:
    columns = {f.name: getattr(table, f.name)[rows].tolist() for f in fields(table)}
    for i in range(len(rows)):
        yield {name: values[i] for name, values in columns.items()}


def _table(release: Released, kind: type[T], file: str) -> T:
    name = file.removesuffix(".parquet")
    files = _Files({file: release.folder / file}, release)
    try:
        value: T = decode(kind, files, name)
    except (KeyError, ValueError, TypeError) as error:
        rule = "was written by another version of FlexMap, or is no such table"
        raise InputError(str(release.folder / file), rule) from error
    return value


@dataclass(frozen=True, slots=True)
class _Files:
    """Released files as `decode` reads artifacts."""

    files: Mapping[str, Path]
    release: Released

    def names(self) -> list[str]:
        return sorted(self.files)

    def read(self, name: str) -> bytes:
        return self.release.read(name)

    def local(self, name: str) -> Path:
        self.release.read(name)
        return self.files[name]

    def sub(self, prefix: str) -> _Files:
        inner = {path[len(prefix) :]: file for path, file in self.files.items() if path.startswith(prefix)}
        return _Files(inner, self.release)
