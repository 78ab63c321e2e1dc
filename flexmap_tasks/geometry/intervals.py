"""What an offset common to an interval of observations would be, for all intervals at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

PRIOR_M = 10.0
"""An offset is expected to be about this large at most; keeps a direction that nothing measures at zero."""


class Offsets(NamedTuple):
    """start, cells : (k,) first cell and count of cells of every interval

    offset_m : (k, 2) east and north; score : (k,) square of it over its variance
    """

    start: Ints
    cells: Ints
    offset_m: Floats
    score: Floats


def offsets_of_intervals(
    information: Floats, right: Floats, starts: int, shortest: int, longest: int
) -> Offsets:
    """The planar offset of every interval of cells, and how significant it is.

    information : (2 c, 2 c) of the offsets of single cells, all else eliminated; right : (2 c,) its right side
    starts : intervals begin in the first so many cells; shortest, longest : their length in cells
    """
    cells = len(right) // 2
    start, length = (
        a.ravel() for a in np.meshgrid(np.arange(starts), np.arange(shortest, longest + 1), indexing="ij")
    )
    fits = start + length <= cells
    east, north, score = _scan(information, right, starts, shortest, longest, 1.0 / PRIOR_M**2)
    offset = np.column_stack([east.ravel()[fits], north.ravel()[fits]])
    return Offsets(start[fits], length[fits], offset, score.ravel()[fits])


@njit(cache=True, nogil=True)
def _scan(information, right, starts, shortest, longest, prior):  # type: ignore[no-untyped-def]  # pragma: no cover
    cells = len(right) // 2
    east = np.zeros((starts, longest - shortest + 1))
    north = np.zeros((starts, longest - shortest + 1))
    score = np.zeros((starts, longest - shortest + 1))
    for start in range(starts):
        xx, xy, yy, bx, by = prior, 0.0, prior, 0.0, 0.0
        for end in range(start, min(start + longest, cells)):
            x, y = 2 * end, 2 * end + 1
            xx += information[x, x]
            xy += information[x, y]
            yy += information[y, y]
            for other in range(start, end):
                u, v = 2 * other, 2 * other + 1
                xx += 2.0 * information[u, x]
                xy += information[u, y] + information[v, x]
                yy += 2.0 * information[v, y]
            bx += right[x]
            by += right[y]
            length = end - start + 1
            if length >= shortest:
                area = xx * yy - xy * xy
                if area > 0.0:
                    ox, oy = (yy * bx - xy * by) / area, (xx * by - xy * bx) / area
                    east[start, length - shortest] = ox
                    north[start, length - shortest] = oy
                    score[start, length - shortest] = ox * bx + oy * by
    return east, north, score
