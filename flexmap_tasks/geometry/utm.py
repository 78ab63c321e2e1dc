"""Longitude and latitude to UTM metres and back (PROJ's transverse Mercator, nanometres over a zone)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pyproj import Proj

Floats = NDArray[np.float64]

SOUTH_LIMIT_DEG, NORTH_LIMIT_DEG = -80.0, 84.0
"""UTM ends here; beyond lie the polar projections."""

MEAN_RADIUS_M = 6_371_008.8
"""Mean radius of WGS84; good to 0.4 % of the height's share of the grid scale, i.e. 1e-6 at 1,600 m."""

_MAX_FROM_CENTRE_DEG = 30.0
"""A forced zone further away than this is a mistake: scale is off by 10 % there."""


def utm_epsg(lon_deg: float, lat_deg: float) -> int:
    """EPSG code of the UTM zone of a place, with the wider zones of Norway and Svalbard.

    The exceptions are kept because Autoware and Lanelet2 choose the zone through GeographicLib, which
    keeps them: another choice would put maps of Bergen 6 degrees away.
    """
    lon = (lon_deg + 180.0) % 360.0 - 180.0
    zone = min(int((lon + 180.0) // 6.0) + 1, 60)
    if 56.0 <= lat_deg < 64.0 and 3.0 <= lon < 12.0:
        zone = 32
    elif lat_deg >= 72.0 and 0.0 <= lon < 42.0:
        zone = 31 if lon < 9.0 else 33 if lon < 21.0 else 35 if lon < 33.0 else 37
    return (32600 if lat_deg >= 0.0 else 32700) + zone


def epsg_of_zone(zone: str) -> int:
    """EPSG code of a zone written as "32N" or "7S"; ValueError when it is not one."""
    number, side = zone[:-1], zone[-1:].upper()
    if not number.isdecimal() or not 1 <= int(number) <= 60 or side not in ("N", "S"):
        raise ValueError(f'expected a UTM zone such as "32N", found "{zone}"')
    return (32600 if side == "N" else 32700) + int(number)


def central_meridian_deg(epsg: int) -> float:
    """Longitude of the zone's middle."""
    return (epsg % 100) * 6.0 - 183.0


def in_reach(epsg: int, lon_deg: float, lat_deg: float) -> bool:
    """Whether the zone can hold the place without absurd distortion."""
    off = (lon_deg - central_meridian_deg(epsg) + 180.0) % 360.0 - 180.0
    return abs(off) <= _MAX_FROM_CENTRE_DEG and SOUTH_LIMIT_DEG <= lat_deg <= NORTH_LIMIT_DEG


@lru_cache(maxsize=8)
def _proj(epsg: int) -> Proj:
    if epsg // 100 not in (326, 327) or not 1 <= epsg % 100 <= 60:
        raise ValueError(f"EPSG:{epsg} is not a UTM zone on WGS84")
    return Proj(proj="utm", zone=epsg % 100, ellps="WGS84", south=epsg // 100 == 327)


def to_utm(lonlat_deg: Floats, epsg: int) -> Floats:
    """Easting and northing, (n, 2) metres, of (n, 2) longitude and latitude in degrees; NaN stays NaN."""
    if len(lonlat_deg) == 0:
        return np.empty((0, 2))
    east, north = _proj(epsg)(lonlat_deg[:, 0], lonlat_deg[:, 1])
    return _finite(np.column_stack([east, north]))


def to_lonlat(easting_northing_m: Floats, epsg: int) -> Floats:
    """Longitude and latitude, (n, 2) degrees, of (n, 2) easting and northing in metres; NaN stays NaN."""
    if len(easting_northing_m) == 0:
        return np.empty((0, 2))
    lon, lat = _proj(epsg)(easting_northing_m[:, 0], easting_northing_m[:, 1], inverse=True)
    return _finite(np.column_stack([lon, lat]))


def grid_factors(lon_deg: float, lat_deg: float, epsg: int) -> tuple[float, float]:
    """Convergence (degrees, grid north clockwise from true north) and point scale factor at a place."""
    factors = _proj(epsg).get_factors(lon_deg, lat_deg)
    return float(factors.meridian_convergence), float(factors.meridional_scale)


def height_factor(height_m: float) -> float:
    """Metres on the ellipsoid per true metre at a height above it."""
    return MEAN_RADIUS_M / (MEAN_RADIUS_M + height_m)


def _finite(values: Floats) -> Floats:
    values[~np.isfinite(values)] = np.nan  # PROJ marks what it cannot project with infinity
    return values
