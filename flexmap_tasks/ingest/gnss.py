"""GNSS fixes of a recording."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.config import GnssParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.mcap_tracks import read_fixes
from flexmap_tasks.formats.track_rows import Rows
from flexmap_tasks.formats.track_text import is_mcap, is_nmea, read_lat_lon, read_nmea
from flexmap_tasks.model.arrays import Bools, Floats
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import STATUS_NONE, GnssFixes, rows_in_time_order


@stage("gnss_fixes")
def ingest_gnss(source: Source, params: GnssParams) -> GnssFixes:
    """Fixes of an MCAP topic or an NMEA log in the order of their stamps, or of "lat lon" lines in their own order.

    Of fixes with one stamp the first is kept. Fixes without a position stay, with status -1 and NaN.
    Raises InputError for a file or value that breaks a rule, and where no fix has a position.
    """
    rows = _read(source, params)
    status = rows.values[:, 7].copy()
    place = rows.values[:, 0:2].copy()
    missing = (status == STATUS_NONE) | ~np.isfinite(place).all(axis=1)
    status[missing] = STATUS_NONE
    _check_range(source.name, rows, ~missing)
    place[(np.abs(place) > (90, 180)).any(axis=1) | ~np.isfinite(place).all(axis=1)] = np.nan
    if missing.all():
        rule = (
            f"none of {len(rows):,} rows has a fix (status -1 or no position): choose another topic or drive"
        )
        raise InputError(source.name, rule)
    order = np.arange(len(rows)) if rows.stamp_ns is None else rows_in_time_order(rows.stamp_ns)
    sigma = _sigmas(rows.values)[order]
    return GnssFixes(
        lon_deg=place[order, 1],
        lat_deg=place[order, 0],
        alt_m=np.where(np.isfinite(rows.values[:, 2]), rows.values[:, 2], np.nan)[order],
        sigma_east_m=sigma[:, 0].copy(),
        sigma_north_m=sigma[:, 1].copy(),
        sigma_up_m=sigma[:, 2].copy(),
        status=status[order].astype(np.int64),
        stamp_ns=None if rows.stamp_ns is None else rows.stamp_ns[order],
    )


def _read(source: Source, params: GnssParams) -> Rows:
    mcap = is_mcap(source.name, source.path)
    if params.format == "mcap" and not mcap:
        raise InputError(source.name, "gnss.format is mcap, but the file does not start like MCAP")
    if params.format == "mcap" or (params.format == "auto" and mcap):
        return read_fixes(source.name, source.path, params.topic)
    if mcap:
        raise InputError(source.name, f"gnss.format is {params.format}, but the file is MCAP: use auto")
    if params.format == "nmea" or (params.format == "auto" and is_nmea(source.path)):
        return read_nmea(source.name, source.path, params.nmea_date)
    return read_lat_lon(source.name, source.path)


def _check_range(name: str, rows: Rows, valid: Bools) -> None:
    lat, lon = rows.values[:, 0], rows.values[:, 1]
    with np.errstate(invalid="ignore"):
        bad = np.flatnonzero(valid & ((np.abs(lat) > 90) | (np.abs(lon) > 180)))
    if not len(bad):
        return
    row = int(bad[0])
    swapped = abs(lat[row]) <= 180 and abs(lon[row]) <= 90
    rule = f"latitude {lat[row]:g} is outside -90..90" if abs(lat[row]) > 90 else ""
    rule = rule or f"longitude {lon[row]:g} is outside -180..180"
    hint = " (latitude and longitude look swapped)" if swapped else ""
    raise InputError(name, f"{rule}{hint}; {rows.form}", rows.where(row))


def _sigmas(values: Floats) -> Floats:
    """(n, 3) standard deviations; NaN where the covariance is of unknown type or not positive."""
    variance = values[:, 3:6]
    with np.errstate(invalid="ignore"):
        known = (values[:, 6:7] != 0) & np.isfinite(variance) & (variance > 0)
    return np.sqrt(np.where(known, variance, np.nan))
