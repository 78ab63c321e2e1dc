"""The map frame."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Projection:
    """UTM metres minus the origin: x east, y north on the grid, z as recorded.

    epsg : EPSG code of the UTM zone, 326zz north or 327zz south (WGS84)
    origin_lat_deg, origin_lon_deg : the origin, WGS84
    origin_easting_m, origin_northing_m : the same in the zone
    convergence_deg : grid north seen from true north at the origin, clockwise positive
    point_scale_factor : grid metres per ellipsoid metre at the origin
    grid_scale_factor : grid metres per true metre at the origin's height
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

    @property
    def zone(self) -> str:
        """UTM zone such as "32N"."""
        return f"{self.epsg % 100}{'N' if self.epsg // 100 == 326 else 'S'}"
