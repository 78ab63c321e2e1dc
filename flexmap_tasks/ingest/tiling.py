"""Points of any number cut into tiles of the SLAM frame, in bounded memory.

The points are read once, block by block. Each block is sorted by tile and laid down in a spill file, where a tile
is a few runs of rows; tiles are then read back one at a time. Memory holds a block or a tile, never the cloud.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from flexmap_tasks.config import PointCloudParams
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.cloud_reader import CloudReader
from flexmap_tasks.formats.pcd import Records, positions, to_cloud
from flexmap_tasks.formats.pcd_open3d import check_open3d, inlier_rows
from flexmap_tasks.formats.pcd_spill import Spill
from flexmap_tasks.geometry.tiles import group_by_tile, nearest_per_voxel
from flexmap_tasks.model.arrays import Floats, Ints, strings
from flexmap_tasks.model.clouds import PointCloud, TileIndex, Tiles, cloud_findings, tile_key, tile_numbers

MAX_COORDINATE_M = 1e8
"""Further out than any map frame; a coordinate beyond it is a broken number."""

MAX_TILES = 1_000_000
"""400 km2 of solid 20 m tiles; more are stray points."""


def tile_cloud(reader: CloudReader, name: str, params: PointCloudParams) -> Tiles:
    """All usable points of a reader in tiles, in the order they come within each; `name` is for messages.

    Points without finite coordinates are left out and counted in the findings. With `voxel_size_m` the point
    nearest to the middle of every voxel of a tile stays (a voxel on the edge of two tiles has one in each). With
    `outlier_neighbours` isolated points go; neighbours are looked for within the tile.

    Raises InputError when no point is usable.
    """
    if params.outlier_neighbours:
        check_open3d()
    spilled, dropped = _spill(reader, name, params.tile_size_m)
    findings = [*reader.findings(), *_findings(reader, spilled, dropped)]
    cleaned = spilled
    if params.outlier_neighbours:
        cleaned = cleaned.cleaned(
            lambda records: inlier_rows(
                positions(records), params.outlier_neighbours, params.outlier_deviations
            )
        )
        gone = spilled.points - cleaned.points
        findings.append(
            ("cloud-outliers", "info", f"{gone} isolated points of {spilled.points} were left out")
        )
    if params.voxel_size_m:
        before = cleaned.points
        cleaned = cleaned.cleaned(lambda records: _thin(records, params.voxel_size_m))
        rule = f"{cleaned.points:,} of {before:,} points stay, one per voxel of {params.voxel_size_m:g} m"
        findings.append(("cloud-thinned", "info", rule))
    return Tiles(cleaned.index(), cleaned, cloud_findings(findings))


def _thin(records: Records, size_m: float) -> Ints:
    return nearest_per_voxel(positions(records), size_m, lambda row: records[row].tobytes())


@dataclass(frozen=True, slots=True, eq=False)
class _Runs:
    """Stretches of rows in a spill that belong to one tile each.

    tile : (r, 2) int64; start, count : (r,) int64; low_m, high_m : (r, 3) box of the points
    """

    tile: Ints
    start: Ints
    count: Ints
    low_m: Floats
    high_m: Floats

    def take(self, rows: Ints) -> _Runs:
        return _Runs(self.tile[rows], self.start[rows], self.count[rows], self.low_m[rows], self.high_m[rows])

    @classmethod
    def joined(cls, parts: list[_Runs]) -> _Runs:
        """All runs by tile, those of one tile in the order they were written."""
        columns = ("tile", "start", "count", "low_m", "high_m")
        all_runs = cls(*(np.concatenate([getattr(p, c) for p in parts]) for c in columns))
        return all_runs.take(np.lexsort((all_runs.tile[:, 1], all_runs.tile[:, 0])))


class SpilledTiles(Mapping[str, PointCloud]):
    """Tiles by key, in the order of (ix, iy), each read from the spill when it is asked for."""

    def __init__(self, spill: Spill, runs: _Runs) -> None:
        self._spill, self._runs = spill, runs
        new = np.any(np.diff(runs.tile, axis=0) != 0, axis=1)
        self._first = (
            np.concatenate([[0], np.flatnonzero(new) + 1]) if len(runs.tile) else np.empty(0, np.int64)
        )
        self._last = np.append(self._first[1:], len(runs.tile)) if len(runs.tile) else self._first
        self._row = {tile_key(x, y): i for i, (x, y) in enumerate(runs.tile[self._first].tolist())}

    def __len__(self) -> int:
        return len(self._row)

    def __iter__(self) -> Iterator[str]:
        return iter(self._row)

    def __getitem__(self, key: str) -> PointCloud:
        return to_cloud(self._records(self._row[key]))

    @property
    def points(self) -> int:
        """Points in all tiles."""
        return int(self._runs.count.sum())

    @property
    def reach_m(self) -> float:
        """Largest absolute coordinate."""
        return float(max(np.abs(self._runs.low_m).max(), np.abs(self._runs.high_m).max()))

    def _records(self, tile: int) -> Records:
        runs = slice(self._first[tile], self._last[tile])
        return self._spill.read(self._runs.start[runs], self._runs.count[runs])

    def index(self) -> TileIndex:
        """Key, number of points and box of every tile."""
        if not len(self):
            nothing = np.empty(0)
            return TileIndex(strings([]), np.empty(0, np.int64), *[nothing] * 6)
        low = np.minimum.reduceat(self._runs.low_m, self._first).T
        high = np.maximum.reduceat(self._runs.high_m, self._first).T
        return TileIndex(strings(self._row), np.add.reduceat(self._runs.count, self._first), *low, *high)

    def cleaned(self, keep: Callable[[Records], Ints]) -> SpilledTiles:
        """The same tiles with only the rows that `keep` returns for each, in a spill of their own."""
        spill = Spill(self._spill.record_type)
        parts = []
        for key, tile in self._row.items():
            records = self._records(tile)
            rows = keep(records)
            if len(rows):
                cells = np.array([tile_numbers(key)])
                parts.append(_write(spill, _rows(records, rows), cells, np.array([0, len(rows)])))
        return SpilledTiles(spill, _Runs.joined(parts))


def _spill(reader: CloudReader, name: str, size_m: int) -> tuple[SpilledTiles, int]:
    """All usable points in a spill, sorted by tile block by block; and how many were not usable."""
    spill = Spill(reader.record_type)
    parts: list[_Runs] = []
    dropped = 0
    for block in reader.blocks():
        xyz_m = positions(block)
        reach_m = max(-xyz_m.min(initial=0.0), xyz_m.max(initial=0.0))
        if not reach_m <= MAX_COORDINATE_M:  # which NaN is not either
            rows = np.flatnonzero((np.abs(xyz_m) <= MAX_COORDINATE_M).all(axis=1))
            dropped += len(block) - len(rows)
            block, xyz_m = _rows(block, rows), xyz_m[rows]  # noqa: PLW2901
        if len(block):
            order, starts, cells = group_by_tile(xyz_m[:, :2], size_m)
            parts.append(_write(spill, _rows(block, order), cells, starts))
    if not parts:
        raise InputError(name, f"no point with finite x, y, z among {reader.points}")
    tiles = SpilledTiles(spill, _Runs.joined(parts))
    if len(tiles) > MAX_TILES:
        raise InputError(
            name,
            f"the points lie in {len(tiles)} tiles of {size_m} m, more than {MAX_TILES}; remove stray points or "
            "set a larger point_cloud.tile_size_m",
        )
    return tiles, dropped


def _rows(records: Records, rows: Ints) -> Records:
    """records[rows] by whole points, which numpy moves faster than field by field."""
    raw = records.view(np.dtype((np.void, records.dtype.itemsize)))
    return np.take(raw, rows).view(records.dtype)


def _write(spill: Spill, records: Records, cells: Ints, starts: Ints) -> _Runs:
    """Lay sorted records down; one run per tile."""
    first, xyz_m = spill.append(records), positions(records)
    low = np.minimum.reduceat(xyz_m, starts[:-1])
    high = np.maximum.reduceat(xyz_m, starts[:-1])
    return _Runs(cells, first + starts[:-1], np.diff(starts), low, high)


def _findings(reader: CloudReader, tiles: SpilledTiles, dropped: int) -> list[tuple[str, str, str]]:
    rows = []
    if dropped:
        message = f"{dropped} points of {reader.points} have no usable coordinates and were left out"
        rows.append(("cloud-point-without-position", "warning", message))
    if reader.record_type["x"].itemsize == 4:
        step_m = float(np.spacing(np.float32(tiles.reach_m)))
        if step_m > 0.001:
            message = (
                f"float32 coordinates up to {tiles.reach_m:.0f} m come in steps of {1000 * step_m:.1f} mm"
            )
            rows.append(("cloud-coarse-coordinates", "warning", message))
    return rows
