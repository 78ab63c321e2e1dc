"""What other tools open: features with a place on the earth and columns of their own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.model.arrays import require


@dataclass(frozen=True, slots=True, eq=False)
class VectorLayer:
    """One table of features.

    name : the name of the table, a plain word
    kind : what every geometry is
    geometry : (n,) object, shapely geometries in longitude and latitude, WGS84 degrees
    columns : (n,) arrays by name: float64 (NaN where unknown), int64, bool, or str
    """

    name: str
    kind: Literal["Point", "LineString", "Polygon"]
    geometry: NDArray[np.object_]
    columns: dict[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.geometry)

    def __post_init__(self) -> None:
        require(all(len(c) == len(self.geometry) for c in self.columns.values()), "one value per feature")
