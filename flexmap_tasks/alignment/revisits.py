"""Places that the drive passes more than once."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from flexmap_tasks.geometry.adjustment import Solution
from flexmap_tasks.geometry.graph2d import Relative, State, relative_rows
from flexmap_tasks.geometry.normal_equations import inverse_on_pattern
from flexmap_tasks.geometry.polyline import arc_length_m
from flexmap_tasks.geometry.se2 import between
from flexmap_tasks.model.arrays import Floats, Ints

KNOWN_M, MIN_TOLD = 0.5, 3
"""Pairs whose places GNSS knows to this tell whether SLAM closes its loops, if there are so many."""

AGAIN_M, AGREED_SIGMAS = 0.1, 2.0
"""A SLAM that closes loops sees a place again to about this per axis; typical pairs lie within so many deviations."""

APART_M = 50.0
"""Poses nearer along the way than this are neighbours, not a revisit."""

MAX_PER_POSE = 1
"""More partners of one pose are the same news again: SLAM agrees with itself."""

APART_RADII = 2.0
"""So are pairs nearer to one another along the way than this many times the radius: they see the same scene."""


def revisit_edges(pose: Floats, radius_m: float) -> Relative:
    """Those of `passes` that say something new, one per stretch of both passes."""
    found = passes(pose, radius_m)
    pairs = np.column_stack([found.first, found.second])
    return _pairs(pose, pairs[_separate(arc_length_m(pose[:, :2])[pairs], APART_RADII * radius_m)])


def passes(pose: Floats, radius_m: float) -> Relative:
    """Pairs of nodes on different passes within `radius_m`, and how SLAM sees one from the other.

    pose : (n, 3) nodes in the SLAM frame
    """
    if radius_m == 0.0:
        return _pairs(pose, np.empty((0, 2), np.int64))
    tree, along = cKDTree(pose[:, :2]), arc_length_m(pose[:, :2])
    found = tree.query(pose[:, :2], k=min(32, len(pose)), distance_upper_bound=radius_m)
    gap, near = np.asarray(found[0]), np.asarray(found[1])
    first = np.repeat(np.arange(len(pose)), near.shape[1]).reshape(near.shape)
    reached = np.isfinite(gap)
    i, j, d = first[reached], near[reached], gap[reached]
    other = np.abs(along[i] - along[j]) > APART_M
    i, j, d = i[other], j[other], d[other]
    order = np.lexsort((j, d, i))
    i, j = i[order], j[order]
    rank = np.arange(len(i)) - np.concatenate([[0], np.cumsum(np.bincount(i, minlength=len(pose)))])[i]
    pairs = np.sort(np.column_stack([i, j])[rank < MAX_PER_POSE], axis=1)
    pairs = np.unique(pairs, axis=0).reshape(-1, 2)
    return _pairs(pose, pairs)


def closes(found: Relative, solution: Solution[State]) -> bool:
    """Whether SLAM sees a place again where it is, as far as GNSS knows without being told of any second pass.

    A SLAM that closes no loops disagrees with itself by its drift. Pairs that GNSS places well show which kind it is;
    where there are too few of them nobody knows, and it is not assumed.
    """
    gap = relative_rows(solution.state, found).residual.reshape(-1, 3)
    poses = solution.state.pose.size
    variance = inverse_on_pattern(solution.lu).diagonal()[:poses].reshape(-1, 3)[:, :2].sum(axis=1)
    of_pair = np.maximum(variance[found.first] + variance[found.second], 0.0)
    square = (gap[:, :2] ** 2).sum(axis=1) / (of_pair + 2.0 * AGAIN_M**2)
    return typically_below(AGREED_SIGMAS**2, square[of_pair < KNOWN_M**2])


def typically_below(limit: float, squares: Floats) -> bool:
    """Whether squares of disagreement over their variance are enough to tell, and their median is below a limit."""
    return len(squares) >= MIN_TOLD and bool(np.median(squares) < limit)


def _separate(at_m: Floats, apart_m: float) -> Ints:
    """Rows of pairs of which no two lie in the same cells of the way: (m, 2) places of both passes."""
    if len(at_m) == 0:
        return np.empty(0, np.int64)
    _, first = np.unique(np.floor(at_m / apart_m).astype(np.int64), axis=0, return_index=True)
    return np.sort(first)


def _pairs(pose: Floats, pairs: Ints) -> Relative:
    first, second = pairs[:, 0].astype(np.int64), pairs[:, 1].astype(np.int64)
    return Relative(first, second, between(pose[first], pose[second]), np.full(len(first), -1))
