"""Kernels over bounds of lanelets: polylines as `offset` (k + 1,) into (m, 3) vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

SAME_FRACTION = 1e-9
"""Two vertices of a centreline nearer than this share of its length are one."""


def offsets(size: Ints) -> Ints:
    """(k + 1,) int64 offsets of k pieces of the given sizes."""
    out = np.zeros(len(size) + 1, dtype=np.int64)
    np.cumsum(size, out=out[1:])
    return out


def gather(offset: Ints, rows: Ints, inverted: Bools) -> tuple[Ints, Ints]:
    """Flat positions of the chosen pieces, those with `inverted` backwards; returns (offset, positions)."""
    size = np.diff(offset)[rows]
    out = offsets(size)
    step = np.repeat(np.where(inverted, -1, 1), size)
    first = np.repeat(np.where(inverted, offset[rows + 1] - 1, offset[rows]), size)
    return out, first + step * (np.arange(out[-1]) - np.repeat(out[:-1], size))


def join(left: Ints, right: Ints) -> tuple[Ints, Ints]:
    """All pairs (i, j) with left[i] == right[j], ordered by i, then j."""
    order = np.argsort(right, kind="stable")
    first = np.searchsorted(right[order], left, side="left")
    count = np.searchsorted(right[order], left, side="right") - first
    start = offsets(count)
    i = np.repeat(np.arange(len(left)), count)
    return i, order[first[i] + np.arange(start[-1]) - start[i]]


def along_m(offset: Ints, xyz_m: Floats) -> Floats:
    """(m,) metres from the start of its polyline to each vertex, in the plane."""
    step = np.zeros(len(xyz_m))
    step[1:] = np.hypot(*np.diff(xyz_m[:, :2], axis=0).T)
    step[offset[:-1]] = 0.0
    # Summed per polyline, by doubling: figures must not depend on what stands before it in the array.
    place = np.arange(len(step)) - np.repeat(offset[:-1], np.diff(offset))
    reach, longest = 1, int(np.diff(offset).max(initial=0))
    while reach < longest:
        step[reach:] = step[reach:] + np.where(place[reach:] >= reach, step[:-reach], 0.0)
        reach *= 2
    return step


def lengths_m(offset: Ints, xyz_m: Floats) -> Floats:
    """(k,) length of each polyline in the plane, metres; every polyline has at least one vertex."""
    total: Floats = along_m(offset, xyz_m)[offset[1:] - 1]
    return total


def fractions(offset: Ints, xyz_m: Floats) -> Floats:
    """(m,) share of its polyline's length at each vertex, 0 to 1; by count where the length is 0."""
    along = along_m(offset, xyz_m)
    size = np.diff(offset)
    total = np.repeat(along[offset[1:] - 1], size)
    place = np.arange(len(along)) - np.repeat(offset[:-1], size)
    by_count = place / np.repeat(np.maximum(size - 1, 1), size)
    share: Floats = np.divide(along, total, out=by_count, where=total > 0)
    share[offset[1:] - 1] = 1.0
    return share


def middle_points(offset: Ints, xyz_m: Floats) -> Floats:
    """(k, 3) vertex number size // 2 of each polyline; between the ends where there are only two."""
    size = np.diff(offset)
    between = (xyz_m[offset[:-1]] + xyz_m[offset[1:] - 1]) * 0.5
    middle: Floats = np.where((size > 2)[:, None], xyz_m[offset[:-1] + size // 2], between)
    return middle


def sides(offset: Ints, xyz_m: Floats, point_m: Floats) -> NDArray[np.int8]:
    """(k,) where point i lies seen from polyline i: 1 left, -1 right, 0 on it.

    The nearest segment decides; where its end is the nearest point, the corner with the next segment does:
    a point in the outer sector of a corner has both segments on the same side only by the corner's turn.
    Every polyline has at least two vertices.
    """
    last = np.zeros(len(xyz_m), dtype=bool)
    last[offset[1:] - 1] = True
    a = np.flatnonzero(~last)
    owner = np.repeat(np.arange(len(offset) - 1), np.diff(offset) - 1)
    start, run, point = xyz_m[a], xyz_m[a + 1] - xyz_m[a], point_m[owner]
    square = np.einsum("ij,ij->i", run, run)
    t = np.einsum("ij,ij->i", point - start, run)
    t = np.clip(np.divide(t, square, out=np.zeros_like(t), where=square > 0), 0.0, 1.0)
    foot = np.where((t >= 1.0)[:, None], xyz_m[a + 1], start + t[:, None] * run)
    distance = np.linalg.norm(point - foot, axis=1)
    best = _first_minimum(offset[:-1] - np.arange(len(offset) - 1), distance)
    p1, p2 = xyz_m[a[best]], xyz_m[a[best] + 1]
    left = _left_of(p1, p2, point_m)
    corner = (t[best] >= 1.0) & ~last[a[best] + 1]
    p3 = xyz_m[np.minimum(a[best] + 2, len(xyz_m) - 1)]
    flip = corner & (left != _left_of(p2, p3, point_m)) & (left == _left_of(p1, p2, p3))
    return np.where(distance[best] > 0, np.where(left ^ flip, 1, -1), 0).astype(np.int8)


def _left_of(p1: Floats, p2: Floats, point: Floats) -> Bools:
    run, to = p2 - p1, point - p1
    return np.asarray(run[:, 0] * to[:, 1] - run[:, 1] * to[:, 0] > 0)


def _first_minimum(start: Ints, value: Floats) -> Ints:
    """(k,) position of the first smallest value in each piece; pieces begin at `start` and are not empty."""
    if not len(start):
        return np.zeros(0, dtype=np.int64)
    least = np.repeat(np.minimum.reduceat(value, start), np.diff(np.append(start, len(value))))
    hit = np.flatnonzero(value == least)
    return hit[np.searchsorted(hit, start)]


def centrelines(
    left_offset: Ints, left_xyz_m: Floats, right_offset: Ints, right_xyz_m: Floats
) -> tuple[Ints, Floats]:
    """Middle of two bounds that run alike: (offset, (m, 3) vertices).

    A vertex stands wherever either bound has one, by share of the bound's length; it is the mean of both
    bounds at that share. Ends are the exact means of the ends.
    """
    k = len(left_offset) - 1
    share = np.concatenate([fractions(left_offset, left_xyz_m), fractions(right_offset, right_xyz_m)])
    row = np.concatenate([np.repeat(np.arange(k), np.diff(o)) for o in (left_offset, right_offset)])
    is_left = np.arange(len(share)) < len(left_xyz_m)
    order = np.lexsort((share, row))
    share, row, is_left = share[order], row[order], is_left[order]
    first = np.append(True, row[1:] != row[:-1])[: len(row)]
    final = np.append(row[1:] != row[:-1], True)[: len(row)]
    step = np.diff(share, prepend=0.0)
    keep = first | final | ((step > SAME_FRACTION) & (share > SAME_FRACTION) & (share < 1.0 - SAME_FRACTION))
    left = _at(left_offset, left_xyz_m, np.cumsum(is_left)[keep] - 1, row[keep], share[keep])
    right = _at(right_offset, right_xyz_m, np.cumsum(~is_left)[keep] - 1, row[keep], share[keep])
    return offsets(np.bincount(row[keep], minlength=k)), (left + right) * 0.5


def _at(offset: Ints, xyz_m: Floats, before: Ints, row: Ints, share: Floats) -> Floats:
    """Points at the given shares; `before` is the last vertex not beyond, give or take the piece's ends."""
    at = fractions(offset, xyz_m)
    i = np.clip(before, offset[row], offset[row + 1] - 2)
    gap = at[i + 1] - at[i]
    t = np.divide(share - at[i], gap, out=np.zeros_like(share), where=gap > 0)[:, None]
    return np.where(t >= 1.0, xyz_m[i + 1], xyz_m[i] + t * (xyz_m[i + 1] - xyz_m[i]))
