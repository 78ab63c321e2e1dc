"""Point clouds in tiles.

A tile is a square of whole metres, axis-parallel; its key `"ix_iy"` says that it holds the points with
ix = floor(x / size), iy = floor(y / size).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.model.arrays import Floats, Ints, Strings, require, strings
from flexmap_tasks.model.maps import Findings

STAMP_FIELD = "stamp_s"
"""Field with the time at which a point was seen: seconds since the epoch on SLAM's clock, in steps of 0.24 us."""


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


@dataclass(frozen=True, slots=True)
class CloudFrame:
    """Where the origin of the map frame lies in the frame of Autoware's projector, metres east and north."""

    as_json: ClassVar[bool] = True

    origin_x_m: float
    origin_y_m: float


def tile_key(ix: int, iy: int) -> str:
    """Key of a tile: (-3, 5) gives "-3_5"."""
    return f"{ix}_{iy}"


def tile_numbers(key: str) -> tuple[int, int]:
    """(ix, iy) of a key; the order of tiles is the order of these."""
    ix, iy = key.split("_")
    return int(ix), int(iy)


def cloud_findings(rows: Sequence[tuple[str, str, str]]) -> Findings:
    """Findings about a cloud as a whole; each row is (code, severity, message)."""
    code, severity, message = (strings(r[i] for r in rows) for i in range(3))
    return Findings(code, severity, strings(["cloud"] * len(rows)), np.zeros(len(rows), np.int64), message)
