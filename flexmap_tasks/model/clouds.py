"""Point clouds in tiles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from flexmap_tasks.model.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """Points with all their fields.

    xyz_m : (n, 3) float64, metres
    fields : every other field by name, (n,) or (n, k), in its own type, in the order of the file
    """

    xyz_m: Floats
    fields: dict[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.xyz_m)
