"""The Military Grid Reference System between 80 degrees south and 84 degrees north (NGA.STND.0037, UTM part)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.geometry.utm import NORTH_LIMIT_DEG, SOUTH_LIMIT_DEG, to_utm, utm_epsg

Floats = NDArray[np.float64]
Strings = NDArray[np.object_]

SQUARE_M = 100_000.0
_BANDS = "CDEFGHJKLMNPQRSTUVWXX"
_COLUMNS = ("ABCDEFGH", "JKLMNPQR", "STUVWXYZ")
_ROWS = "ABCDEFGHJKLMNPQRSTUV"
_NOISE_M = 1e-6
"""A place this little before a grid line counts as on it: so exact is a projection there and back."""


def squares(lonlat_deg: Floats) -> tuple[Strings, Floats]:
    """The 100 km square of each place, such as "32UPU", and (n, 2) metres east and north in it.

    lonlat_deg : (n, 2), WGS84 degrees; each place in the UTM zone of its own. ValueError outside UTM's latitudes.
    """
    if not bool(((lonlat_deg[:, 1] >= SOUTH_LIMIT_DEG) & (lonlat_deg[:, 1] <= NORTH_LIMIT_DEG)).all()):
        raise ValueError("MGRS squares exist here from 80 degrees south to 84 degrees north only")
    epsg = np.array([utm_epsg(lon, lat) for lon, lat in lonlat_deg.tolist()], dtype=np.int64)
    name: Strings = np.empty(len(epsg), dtype=object)
    within = np.empty((len(epsg), 2))
    for code in np.unique(epsg).tolist():
        here = epsg == code
        name[here], within[here] = _zone_squares(lonlat_deg[here], code)
    return name, within


def _zone_squares(lonlat_deg: Floats, epsg: int) -> tuple[Strings, Floats]:
    metres = to_utm(lonlat_deg, epsg) + _NOISE_M
    cell = np.floor(metres / SQUARE_M)
    zone = epsg % 100
    columns, shift = _COLUMNS[(zone - 1) % 3], 5 * (zone % 2 == 0)
    band = np.floor((lonlat_deg[:, 1] + 80.0) / 8.0).astype(np.int64)
    name: Strings = np.empty(len(cell), dtype=object)
    name[:] = [
        f"{zone:02d}{_BANDS[b]}{columns[int(east) - 1]}{_ROWS[(int(north) + shift) % 20]}"
        for b, (east, north) in zip(band.tolist(), cell.tolist(), strict=True)
    ]
    return name, metres - cell * SQUARE_M


def codes(lonlat_deg: Floats, digits: int) -> Strings:
    """MGRS codes with `digits` (0 to 5) for east and for north each: 3 is 100 m, 5 is 1 m; cut off, not rounded."""
    name, within = squares(lonlat_deg)
    out: Strings = np.empty(len(name), dtype=object)
    if digits == 0:
        return name
    cut = np.minimum(np.floor(within / 10.0 ** (5 - digits)), 10.0**digits - 1).astype(np.int64)
    out[:] = [f"{n}{e:0{digits}d}{s:0{digits}d}" for n, (e, s) in zip(name, cut.tolist(), strict=True)]
    return out
