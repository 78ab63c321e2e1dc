"""Measures along and to polylines."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


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
    ends = np.round(np.stack([line[rows], line[rows + 1]], axis=1), 9)  # GEOS fails at steps of 1e-200
    segments = shapely.linestrings(ends)
    found, near = shapely.STRtree(segments).query_nearest(shapely.points(points), all_matches=True)
    first = np.flatnonzero(np.diff(found, prepend=-1))
    nearest = rows[np.minimum.reduceat(near, first)]  # ties to the earlier segment, whatever the index
    start, edge = line[nearest], line[nearest + 1] - line[nearest]
    square = (edge**2).sum(axis=1)
    along = ((points - start) * edge).sum(axis=1)
    share = np.clip(np.divide(along, square, out=np.zeros_like(along), where=square > 0), 0.0, 1.0)
    gap = points - start - share[:, None] * edge
    return Nearest(np.hypot(gap[:, 0], gap[:, 1]), nearest, share)


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
