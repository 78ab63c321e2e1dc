"""Stretches of GNSS that stand off as a whole: multipath that no single fix betrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from flexmap_tasks.geometry.adjustment import Solution
from flexmap_tasks.geometry.graph2d import State
from flexmap_tasks.model.arrays import Bools, Floats, Ints

LENGTHS_M = (25.0, 50.0, 100.0, 200.0)
"""Stretches are tried in these lengths, each overlapping the next by half."""

SIGNIFICANT = 6.0
"""A stretch stands off when its offset is this many times its own deviation, as the whole drive shows it."""


class Offset(NamedTuple):
    """A stretch that stands off: fixes (rows of the group), offset in metres, and its significance."""

    rows: Bools
    offset_m: float
    significance: float


def standing_off(
    solution: Solution[State], group: int, along_m: Floats, components: int, minimum_m: float
) -> Offset | None:
    """The stretch whose own constant offset explains the most, or None.

    For every stretch the adjustment is asked what an offset of its own would come out as and how sure
    that would be (Baarda's test of an outlier, for a whole stretch; exact, one solution per stretch).
    The deviations are scaled by what is usual on this drive, so that a SLAM that is worse than its
    estimated noise does not make every stretch suspicious.
    along_m : (m,) place of every fix along the track; components : rows of the group per fix
    """
    observed, scale, weight = solution.groups[group], solution.scale[group], solution.weight[group]
    p = weight / (observed.unit * scale) ** 2
    after = observed.residual + observed.jacobian @ solution.step
    spans = _spans(along_m)
    rows, columns = _members(spans, along_m, components)
    pick = sparse.csr_matrix((p[rows], (rows, columns)), shape=(len(p), components * len(spans)))
    weighted = observed.jacobian.T @ pick
    solved = solution.lu.solve(weighted.toarray())
    total = np.asarray(pick.sum(axis=0)).ravel()
    information = total - np.asarray(weighted.multiply(solved).sum(axis=0)).ravel()
    usable = information > 1e-3 * np.maximum(total, 1e-300)
    safe = np.where(usable, information, 1.0)
    offset = np.where(usable, (pick.T @ after) / safe, 0.0).reshape(-1, components)
    score = (offset**2 * safe.reshape(-1, components) * usable.reshape(-1, components)).sum(axis=1)
    usual = float(np.median(score[score > 0])) if (score > 0).any() else 0.0
    significance = np.sqrt(score / max(usual, 0.455 * components))
    size = np.hypot(*offset.T) if components == 2 else np.abs(offset[:, 0])
    significance[size < minimum_m] = 0.0
    best = int(significance.argmax())
    if significance[best] < SIGNIFICANT:
        return None
    inside = (along_m >= spans[best, 0]) & (along_m < spans[best, 1])
    return Offset(inside, float(size[best]), float(significance[best]))


def _spans(along_m: Floats) -> Floats:
    low, high = float(along_m.min()), float(along_m.max())
    spans = []
    for length in LENGTHS_M:
        starts = np.arange(low, max(high - length / 2, low + 1e-6), length / 2)
        spans.append(np.column_stack([starts, starts + length]))
    return np.concatenate(spans)


def _members(spans: Floats, along_m: Floats, components: int) -> tuple[Ints, Ints]:
    order = np.argsort(along_m, kind="stable")
    first = np.searchsorted(along_m[order], spans[:, 0])
    count = np.searchsorted(along_m[order], spans[:, 1]) - first
    span = np.repeat(np.arange(len(spans)), count)
    start = np.repeat(first - np.concatenate([[0], np.cumsum(count)[:-1]]), count)
    fix = order[start + np.arange(len(span))]
    part = np.tile(np.arange(components), len(span))
    return np.repeat(fix, components) * components + part, np.repeat(span, components) * components + part
