"""A height model, cut to where the drive was."""

from __future__ import annotations

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from flexmap_tasks.config import HeightModelParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import CoverageError, InputError
from flexmap_tasks.formats.height_grid import Grid, read_height_grid
from flexmap_tasks.model.height_model import HeightModel
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import GnssTrack

MARGIN_M = 500.0
"""Kept around the GNSS track: SLAM drives where GNSS was silent, too."""


@stage("height_model")
def ingest_height_model(
    source: Source, gnss: GnssTrack, projection: Projection, params: HeightModelParams
) -> HeightModel:
    """The part of the model around the GNSS track.

    Raises InputError where nothing says what its coordinates are, CoverageError where it lies elsewhere.
    """
    grid = read_height_grid(source.name, source.path)
    epsg = params.epsg or grid.epsg
    if epsg is None:
        raise InputError(
            source.name, "does not say what its coordinates are; give alignment.height_model.epsg"
        )
    try:
        crs = CRS.from_epsg(epsg)
    except CRSError:
        raise InputError(source.name, f"EPSG:{epsg} is not known") from None
    datum = params.vertical_datum or (f"EPSG:{grid.vertical_epsg}" if grid.vertical_epsg else "not stated")
    corners = gnss.xyz_m[:, :2]
    low, high = corners.min(axis=0) - MARGIN_M, corners.max(axis=0) + MARGIN_M
    box = np.array([[x, y] for x in np.linspace(low[0], high[0], 5) for y in np.linspace(low[1], high[1], 5)])
    to_model = Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    x, y = (np.asarray(v, np.float64) for v in to_model.transform(*projection.to_lonlat_deg(box).T))
    rows, columns = grid.height_m.shape
    left, right = _span(x, grid.first_x, grid.step_x, columns)
    top, bottom = _span(y, grid.first_y, grid.step_y, rows)
    cut = grid.height_m[top:bottom, left:right]
    if min(cut.shape) < 2 or not np.isfinite(cut).any():
        raise CoverageError(source.name, f"{_extent(grid, epsg)}; the drive lies elsewhere")
    return HeightModel(
        np.ascontiguousarray(cut).ravel(), right - left, grid.first_x + left * grid.step_x,
        grid.first_y + top * grid.step_y, grid.step_x, grid.step_y, epsg, datum,
    )  # fmt: skip


def _span(values: np.ndarray, first: float, step: float, count: int) -> tuple[int, int]:
    """Cells from and to which some coordinates reach, within the grid."""
    place = (values - first) / step
    if not np.isfinite(place).all():
        return 0, 0
    return int(np.clip(np.floor(place.min()), 0, count)), int(np.clip(np.ceil(place.max()) + 1, 0, count))


def _extent(grid: Grid, epsg: int) -> str:
    rows, columns = grid.height_m.shape
    x = sorted((grid.first_x, grid.first_x + (columns - 1) * grid.step_x))
    y = sorted((grid.first_y, grid.first_y + (rows - 1) * grid.step_y))
    return f"covers {x[0]:.6g} to {x[1]:.6g} and {y[0]:.7g} to {y[1]:.7g} in EPSG:{epsg}"
