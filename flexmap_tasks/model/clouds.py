"""Point clouds in tiles.

A tile is a square of whole metres, axis-parallel; its key `"ix_iy"` says that it holds the points with
ix = floor(x / size), iy = floor(y / size).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from flexmap_tasks.model.arrays import Floats, Ints, Strings, require
from flexmap_tasks.model.maps import Findings


@dataclass(frozen=True, slots=True)
class Extent:
    """An axis-parallel box in the plane, metres."""

    x_min_m: float
    y_min_m: float
    x_max_m: float
    y_max_m: float


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """Points with all their fields.

    xyz_m : (n, 3) float64, metres, finite
    fields : every other field by name, (n,) or (n, k), in its own type, in the order of the file
    """

    xyz_m: Floats
    fields: dict[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.xyz_m)

    def __post_init__(self) -> None:
        n = len(self.xyz_m)
        require(self.xyz_m.shape == (n, 3), "points need x, y, z")
        require(all(len(f) == n for f in self.fields.values()), "point fields differ in length")

    def take(self, rows: Any) -> PointCloud:
        """The points of the given rows (indices, a mask or a slice), in that order."""
        return PointCloud(self.xyz_m[rows], {name: field[rows] for name, field in self.fields.items()})


@dataclass(frozen=True, slots=True, eq=False)
class TileIndex:
    """What is in each tile, in the order of (ix, iy).

    key : (t,) str, "ix_iy"; count : (t,) int64, points
    x_min_m ... z_max_m : (t,) float64, the box of its points
    """

    key: Strings
    count: Ints
    x_min_m: Floats
    y_min_m: Floats
    z_min_m: Floats
    x_max_m: Floats
    y_max_m: Floats
    z_max_m: Floats

    def __len__(self) -> int:
        return len(self.key)


@dataclass(frozen=True, slots=True, eq=False)
class Tiles:
    """A cloud of any size, cut into tiles.

    index : what is where
    tiles : the points by tile key, in the order of the index; may be read from disk one at a time
    findings : what reading the cloud brought to light
    """

    index: TileIndex
    tiles: Mapping[str, PointCloud]
    findings: Findings


@dataclass(frozen=True, slots=True, eq=False)
class TileKeys:
    """Which tiles a tiled cloud has.

    key : (t,) str, "ix_iy"
    """

    key: Strings
