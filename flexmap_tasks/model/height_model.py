"""A model of the ground's height: what a drive can be laid onto."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pyproj import Transformer

from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.projection import Projection


@dataclass(frozen=True, slots=True, eq=False)
class HeightModel:
    """A grid of heights, rows from the north.

    height_m : (rows * columns,) float64, row by row; NaN where the model knows nothing
    columns : cells in a row; first_x, first_y : centre of the first cell; step_x, step_y : to the next, step_y < 0
    epsg : what x and y are of; vertical_datum : what heights refer to, as the user or the file states it
    """

    height_m: Floats
    columns: int
    first_x: float
    first_y: float
    step_x: float
    step_y: float
    epsg: int
    vertical_datum: str

    def at_m(self, xy_m: Floats, projection: Projection) -> Floats:
        """(n,) heights at (n, 2) places of the map frame, bilinear; NaN where a cell around is not known."""
        x, y = self._own(projection.to_lonlat_deg(xy_m))
        u, v = (x - self.first_x) / self.step_x, (y - self.first_y) / self.step_y
        grid = self.height_m.reshape(-1, self.columns)
        rows = len(grid)
        inside = (u >= 0) & (v >= 0) & (u <= self.columns - 1) & (v <= rows - 1)
        u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
        i = np.minimum(u.astype(np.int64), max(self.columns - 2, 0))
        j = np.minimum(v.astype(np.int64), max(rows - 2, 0))
        s, t = u - i, v - j
        # a cell that does not count may be unknown
        out = np.zeros(len(u))
        for row, column, weight in (
            (j, i, (1 - s) * (1 - t)), (j, i + 1, s * (1 - t)), (j + 1, i, (1 - s) * t), (j + 1, i + 1, s * t)
        ):  # fmt: skip
            known = weight > 0
            out[known] += weight[known] * grid[row[known], column[known]]
        return np.where(inside, out, np.nan)

    def _own(self, lonlat_deg: Floats) -> tuple[Floats, Floats]:
        to_model = Transformer.from_crs("EPSG:4326", f"EPSG:{self.epsg}", always_xy=True)
        x, y = to_model.transform(*lonlat_deg.T)
        return np.asarray(x, np.float64), np.asarray(y, np.float64)
