"""OpenStreetMap around the track, from a server."""

from __future__ import annotations

from math import ceil, cos, floor, radians

import numpy as np

from flexmap_tasks.config import OsmFetchParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.osm_fetch import download_extract
from flexmap_tasks.model.maps import GeoBox
from flexmap_tasks.model.tracks import STATUS_NONE, GnssFixes

METRES_PER_DEGREE = 110_574.0
"""The shortest degree of latitude, at the equator: a margin is never smaller than asked for."""
STEPS_PER_DEGREE = 10_000
"""Boxes end on whole steps, so that a fix more or less does not fetch again."""
MAX_SIDE_DEG = 5.0
MAX_LAT_DEG = 84.0


@stage("track_box")
def track_box(fixes: GnssFixes, params: OsmFetchParams) -> GeoBox:
    """The box around all fixes with a position, grown by the margin, outwards to whole 1e-4 degrees.

    Raises InputError without such fixes, at the antimeridian and near the poles, and for fixes far apart.
    """
    lon, lat = fixes.lon_deg, fixes.lat_deg
    usable = (fixes.status != STATUS_NONE) & (np.abs(lon) <= 180) & (np.abs(lat) <= 90)
    usable &= (lon != 0) | (lat != 0)  # what receivers write that know nothing
    if not usable.any():
        raise InputError("GNSS", "no fix has a position; OpenStreetMap cannot be fetched around the track")
    west, east = float(lon[usable].min()), float(lon[usable].max())
    south, north = float(lat[usable].min()), float(lat[usable].max())
    up = params.margin_m / METRES_PER_DEGREE
    if south - up < -MAX_LAT_DEG or north + up > MAX_LAT_DEG:
        rule = (
            f"the track reaches latitude {max(north, -south):.4f}, too near to a pole; give an extract file"
        )
        raise InputError("GNSS", rule)
    aside = up / cos(radians(max(abs(south), abs(north))))
    if east - west > 180 or west - aside < -180 or east + aside > 180:
        rule = "the track and its margin cross the antimeridian, which a server's box cannot; give an extract file"
        raise InputError("GNSS", rule)
    if max(east - west, north - south) > MAX_SIDE_DEG:
        rule = (
            f"the fixes span {east - west:.2f} by {north - south:.2f} degrees, more than one drive; "
            "remove fixes far off, or give an extract file"
        )
        raise InputError("GNSS", rule)
    return GeoBox(_down(west - aside), _down(south - up), _upwards(east + aside), _upwards(north + up))


@stage("osm_extract", outside=True)
def fetch_osm(box: GeoBox, params: OsmFetchParams) -> dict[str, bytes]:
    """The server's OpenStreetMap XML for the box, as the file `extract.osm`.

    Raises OsmServerError when trying again may help, InputError when it will not.
    """
    return {"extract.osm": download_extract(params.endpoint, params.api, box, params.timeout_s)}


def _down(degrees: float) -> float:
    return floor(degrees * STEPS_PER_DEGREE) / STEPS_PER_DEGREE


def _upwards(degrees: float) -> float:
    return ceil(degrees * STEPS_PER_DEGREE) / STEPS_PER_DEGREE
