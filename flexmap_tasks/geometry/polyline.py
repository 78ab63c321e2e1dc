"""Measures along and to polylines.

What follows each other on a polyline lies near each other: boxes around runs of its segments, around pairs of
runs and so on are a tree that finds the nearest segment without being built from anything but the order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_RUN = 8
"""Segments in a leaf of the tree."""

_ROUNDING = 1.0 - 1e-12
"""A box counts as this much nearer than it is: rounding must not hide a segment that is as near as the best."""


def smooth_through(at: Floats, known_at: Floats, known: Floats) -> Floats:
    """(m, c) values at places, on cubics through the known ones (n, c) with the slopes of their neighbours.

    Linear in what is known, so no direction of the axes is preferred; chords would cut every corner short.
    known_at : (n,) ascending; of equal ones the first counts. Beyond the ends the end's value holds.
    """
    known_at, first = np.unique(known_at, return_index=True)
    known, at = known[first], np.clip(at, known_at[0], known_at[-1])
    if len(known_at) < 2:
        return np.repeat(known, len(at), axis=0)
    slope = np.gradient(known, known_at, axis=0)
    out: Floats = CubicHermiteSpline(known_at, known, slope)(at)
    return out


def steps_m(points: Floats) -> Floats:
    """(n - 1,) lengths of the straight steps of (n, d) points, metres."""
    step: Floats = np.sqrt((np.diff(points, axis=0) ** 2).sum(axis=1))
    return step


def arc_length_m(points: Floats) -> Floats:
    """(n,) length of the way from the first of (n, d) points to each, metres."""
    return np.concatenate([[0.0], np.cumsum(steps_m(points))])


def resample_evenly(points: Floats, count: int) -> Floats:
    """(count, d) points spaced evenly over the arc length of (n, d) ones, both ends included."""
    along = arc_length_m(points)
    wanted = np.linspace(0.0, along[-1], count)
    return np.column_stack([np.interp(wanted, along, column) for column in points.T])


class Nearest(NamedTuple):
    """Where points lie along a polyline.

    distance_m : (n,) float64, shortest distance; NaN where the polyline has no usable segment
    segment : (n,) int64, the nearest segment, from vertex `segment` to `segment + 1`
    share : (n,) float64 in 0..1, the place on that segment
    """

    distance_m: Floats
    segment: Ints
    share: Floats


def nearest_on_polyline(points: Floats, line: Floats, usable: Bools | None = None) -> Nearest:
    """The nearest place of a polyline for every point, exact.

    points : (n, 2), metres
    line : (m, 2) vertices, metres
    usable : (m - 1,) which segments count; all when None
    """
    rows = np.arange(len(line) - 1) if usable is None else np.flatnonzero(usable)
    if len(rows) == 0 or len(points) == 0:
        return Nearest(np.full(len(points), np.nan), np.zeros(len(points), np.int64), np.zeros(len(points)))
    ends = np.concatenate([line[rows], line[rows + 1]], axis=1)
    nearest = rows[_nearest(np.ascontiguousarray(points), ends, _boxes(ends))]
    start, edge = line[nearest], line[nearest + 1] - line[nearest]
    square = (edge**2).sum(axis=1)
    along = ((points - start) * edge).sum(axis=1)
    share = np.clip(np.divide(along, square, out=np.zeros_like(along), where=square > 0), 0.0, 1.0)
    gap = points - start - share[:, None] * edge
    return Nearest(np.hypot(gap[:, 0], gap[:, 1]), nearest, share)


@njit(cache=True)
def _boxes(ends):  # type: ignore[no-untyped-def]  # pragma: no cover
    """(2 k, 4) boxes x, y, x, y around runs of the segments (m, 4); node n has the children 2 n and 2 n + 1."""
    leaves = 1
    while leaves * _RUN < len(ends):
        leaves *= 2
    boxes = np.empty((2 * leaves, 4))
    boxes[:, :2], boxes[:, 2:] = np.inf, -np.inf
    for k in range(len(ends)):
        box = boxes[leaves + k // _RUN]
        for axis in range(2):
            a, b = ends[k, axis], ends[k, 2 + axis]
            box[axis] = min(box[axis], a, b)
            box[2 + axis] = max(box[2 + axis], a, b)
    for n in range(leaves - 1, 0, -1):
        for axis in range(2):
            boxes[n, axis] = min(boxes[2 * n, axis], boxes[2 * n + 1, axis])
            boxes[n, 2 + axis] = max(boxes[2 * n, 2 + axis], boxes[2 * n + 1, 2 + axis])
    return boxes


@njit(cache=True)
def _box_square(left, below, right, above, x, y):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Square of the distance to a box, rounded down."""
    dx = max(left - x, x - right, 0.0)
    dy = max(below - y, y - above, 0.0)
    return (dx * dx + dy * dy) * _ROUNDING


@njit(cache=True)
def _segment_square(x0, y0, x1, y1, x, y):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Square of the distance to a segment; at its ends exactly that to the vertex, which two segments share."""
    ex, ey = x1 - x0, y1 - y0
    dx, dy = x - x0, y - y0
    along, square = dx * ex + dy * ey, ex * ex + ey * ey
    if along >= square > 0.0:
        dx, dy = x - x1, y - y1
    elif 0.0 < along < square:
        share = along / square
        dx, dy = dx - share * ex, dy - share * ey
    return dx * dx + dy * dy


@njit(cache=True, nogil=True)
def _nearest(points, ends, boxes):  # type: ignore[no-untyped-def]  # pragma: no cover
    """(n,) the nearest of the segments (m, 4), of equally near ones the first; begins at the one found before."""
    leaves = len(boxes) // 2
    out = np.empty(len(points), np.int64)
    waiting = np.empty(64, np.int64)
    at_least = np.empty(64)  # square of the distance to what is waiting
    best = 0
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        least = _segment_square(ends[best, 0], ends[best, 1], ends[best, 2], ends[best, 3], x, y)
        waiting[0], at_least[0], count = 1, 0.0, 1
        while count:
            count -= 1
            node = waiting[count]
            if not at_least[count] <= least:
                continue
            if node < leaves:
                a, b = 2 * node, 2 * node + 1
                to_a = _box_square(boxes[a, 0], boxes[a, 1], boxes[a, 2], boxes[a, 3], x, y)
                to_b = _box_square(boxes[b, 0], boxes[b, 1], boxes[b, 2], boxes[b, 3], x, y)
                if to_a < to_b:  # the nearer one is asked next
                    a, b, to_a, to_b = b, a, to_b, to_a
                if to_a <= least:
                    waiting[count], at_least[count], count = a, to_a, count + 1
                if to_b <= least:
                    waiting[count], at_least[count], count = b, to_b, count + 1
                continue
            first = (node - leaves) * _RUN
            for k in range(first, min(first + _RUN, len(ends))):
                square = _segment_square(ends[k, 0], ends[k, 1], ends[k, 2], ends[k, 3], x, y)
                if square < least or (square == least and k < best):
                    least, best = square, k
        out[n] = best
    return out


TIE_M = 1e-6
"""A place as near to an observed step as to an unobserved one counts as seen."""


def distance_and_seen(points: Floats, line: Floats, observed: Bools) -> tuple[Floats, Bools]:
    """Distance to a line, and whether the place is valid: what "a pose with valid GNSS" means everywhere.

    A place is valid when no unobserved step of the line (the straight chord across a gap) is nearer to it, by more
    than `TIE_M`, than the nearest observed one. A place beside the fix at the edge of a gap is as near to both steps
    that meet there: it is valid. None is valid where the line has no step, or none that was observed.
    points : (n, 2); line : (m, 2); observed : (m - 1,) steps of the line
    """
    distance = nearest_on_polyline(points, line).distance_m
    if observed.all():
        return distance, np.isfinite(distance)
    return distance, nearest_on_polyline(points, line, observed).distance_m <= distance + TIE_M
