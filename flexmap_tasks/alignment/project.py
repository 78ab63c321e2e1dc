"""GNSS fixes into the map frame."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.config import GeoPoint, ProjectionParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import AlignmentError, ConfigError
from flexmap_tasks.geometry import utm
from flexmap_tasks.geometry.breaks import observed_steps
from flexmap_tasks.model.arrays import Bools, Ints
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import STATUS_NONE, GnssFixes, GnssTrack, Projected


@stage("projected")
def project_utm(fixes: GnssFixes, params: ProjectionParams) -> Projected:
    """The fixes in UTM metres minus the origin, which is the first usable fix or the configured point.

    Left out are fixes without a position: no number, status "no fix", or exactly 0, 0 as receivers write
    that know nothing. Steps over jumps and outages are marked as not observed.

    Raises AlignmentError when no usable fix is left or a fix lies where UTM ends, ConfigError when the
    configured zone cannot hold the origin.
    """
    rows = _checked_rows(fixes)
    projection = _projection(fixes, int(rows[0]), params)
    return Projected(_track(fixes, rows, projection), projection)


def projected_track(fixes: GnssFixes, projection: Projection) -> GnssTrack:
    """The fixes in a map frame that is there already.

    Raises AlignmentError when no usable fix is left or the first lies where the frame's UTM zone does not reach.
    """
    rows = _checked_rows(fixes)
    lon, lat = float(fixes.lon_deg[rows[0]]), float(fixes.lat_deg[rows[0]])
    if not utm.in_reach(projection.epsg, lon, lat):
        rule = f"the first fix at {lat:.5f}, {lon:.5f} (lat, lon) is out of reach of the map's EPSG:{projection.epsg}"
        raise AlignmentError("GNSS fixes", rule)
    return _track(fixes, rows, projection)


def _checked_rows(fixes: GnssFixes) -> Ints:
    """Rows with a position that UTM covers."""
    rows = np.flatnonzero(_usable(fixes))
    if len(rows) == 0:
        raise AlignmentError(
            "GNSS fixes", f"none of {len(fixes)} fixes has a position; choose another topic or file"
        )
    _check_latitudes(fixes, rows.tolist())
    return rows


def _track(fixes: GnssFixes, rows: Ints, projection: Projection) -> GnssTrack:
    xy_m = projection.to_xy_m(np.column_stack([fixes.lon_deg[rows], fixes.lat_deg[rows]]))
    stamp_ns = None if fixes.stamp_ns is None else fixes.stamp_ns[rows]
    return GnssTrack(
        xyz_m=np.column_stack([xy_m, fixes.alt_m[rows]]),
        sigma_m=np.column_stack([fixes.sigma_east_m, fixes.sigma_north_m, fixes.sigma_up_m])[rows],
        status=fixes.status[rows],
        row=rows,
        observed=observed_steps(xy_m, None if stamp_ns is None else (stamp_ns - stamp_ns[0]) * 1e-9),
        stamp_ns=stamp_ns,
    )


def _usable(fixes: GnssFixes) -> Bools:
    nowhere = (fixes.lon_deg == 0.0) & (fixes.lat_deg == 0.0)
    finite = np.isfinite(fixes.lon_deg) & np.isfinite(fixes.lat_deg)
    usable: Bools = finite & ~nowhere & (fixes.status != STATUS_NONE)
    return usable


def _check_latitudes(fixes: GnssFixes, rows: list[int]) -> None:
    lat = fixes.lat_deg[rows]
    beyond = np.flatnonzero((lat < utm.SOUTH_LIMIT_DEG) | (lat > utm.NORTH_LIMIT_DEG))
    if len(beyond):
        row = rows[int(beyond[0])]
        raise AlignmentError(
            "GNSS fixes",
            f"UTM covers latitudes from {utm.SOUTH_LIMIT_DEG:g} to {utm.NORTH_LIMIT_DEG:g} degrees, "
            f"found {fixes.lat_deg[row]:.6f}",
            f"row {row}",
        )


def _projection(fixes: GnssFixes, first: int, params: ProjectionParams) -> Projection:
    lon, lat = float(fixes.lon_deg[first]), float(fixes.lat_deg[first])
    if isinstance(params.origin, GeoPoint):
        lon, lat = params.origin.lon_deg, params.origin.lat_deg
    epsg = utm.utm_epsg(lon, lat) if params.zone is None else utm.epsg_of_zone(params.zone)
    for name, x, y in (("origin", lon, lat), ("first fix", fixes.lon_deg[first], fixes.lat_deg[first])):
        if not utm.in_reach(epsg, float(x), float(y)):
            natural = utm.utm_epsg(float(x), float(y))
            raise ConfigError(
                "configuration",
                f"the {name} at {y:.5f}, {x:.5f} (lat, lon) cannot be mapped in the UTM zone of EPSG:{epsg}; "
                f"its own zone is {natural % 100}{'N' if natural < 32700 else 'S'}",
                "projection",
            )
    known = fixes.alt_m[np.isfinite(fixes.alt_m)]
    height = float(known[0]) if len(known) else float("nan")
    return Projection.at(lon, lat, height_m=height, epsg=epsg, datum=params.datum)
