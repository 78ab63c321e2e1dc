"""The map frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.geometry import utm
from flexmap_tasks.model.arrays import Floats


@dataclass(frozen=True, slots=True)
class Projection:
    """UTM metres minus the origin: x east, y north on the grid, z as recorded.

    epsg : EPSG code of the UTM zone, 326zz north or 327zz south (WGS84)
    origin_lat_deg, origin_lon_deg : the origin, WGS84
    origin_easting_m, origin_northing_m : the same in the zone
    convergence_deg : grid north seen from true north at the origin, clockwise positive
    point_scale_factor : grid metres per ellipsoid metre at the origin
    grid_scale_factor : grid metres per true metre at the origin's height; the point scale factor where the
        height is not known
    datum : as the user states it; WGS84 unless told otherwise
    """

    epsg: int
    origin_lat_deg: float
    origin_lon_deg: float
    origin_easting_m: float
    origin_northing_m: float
    convergence_deg: float
    point_scale_factor: float
    grid_scale_factor: float
    datum: str

    @classmethod
    def at(
        cls,
        lon_deg: float,
        lat_deg: float,
        *,
        height_m: float = float("nan"),
        epsg: int | None = None,
        datum: str = "WGS84",
    ) -> Projection:
        """The map frame with its origin at a place; in the place's own UTM zone unless `epsg` says otherwise."""
        code = utm.utm_epsg(lon_deg, lat_deg) if epsg is None else epsg
        ((easting, northing),) = utm.to_utm(np.array([[lon_deg, lat_deg]]), code).tolist()
        convergence, point_scale = utm.grid_factors(lon_deg, lat_deg, code)
        grid_scale = point_scale * (utm.height_factor(height_m) if np.isfinite(height_m) else 1.0)
        return cls(
            code, lat_deg, lon_deg, easting, northing, convergence, point_scale, float(grid_scale), datum
        )

    @property
    def zone(self) -> str:
        """UTM zone such as "32N"."""
        return f"{self.epsg % 100}{'N' if self.epsg // 100 == 326 else 'S'}"

    def to_xy_m(self, lonlat_deg: Floats) -> Floats:
        """(n, 2) metres in the map frame of (n, 2) longitude and latitude in degrees; NaN stays NaN."""
        origin: Floats = np.array([self.origin_easting_m, self.origin_northing_m])
        xy: Floats = utm.to_utm(lonlat_deg, self.epsg) - origin
        return xy

    def to_lonlat_deg(self, xy_m: Floats) -> Floats:
        """(n, 2) longitude and latitude in degrees of (n, 2) metres in the map frame; NaN stays NaN."""
        return utm.to_lonlat(xy_m + np.array([self.origin_easting_m, self.origin_northing_m]), self.epsg)
