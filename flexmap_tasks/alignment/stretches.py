"""Stretches of GNSS that stand off as a whole: multipath that no single fix betrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from flexmap_tasks.geometry.adjustment import Solution
from flexmap_tasks.geometry.graph2d import State
from flexmap_tasks.model.arrays import Bools, Floats, Ints

LENGTHS_M = (25.0, 50.0, 100.0, 200.0)
"""Stretches are tried in these lengths, every quarter of their length."""

SUSPECTS, GROWTH_ROUNDS = 6, 3
GROWTH_M = (0.0, -24.0, -12.0, -6.0, -3.0, 3.0, 6.0, 12.0, 24.0)
"""How many of the most suspicious stretches are tried again, how often, and how far their ends move at a time."""

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
    that would be (Baarda's test of an outlier, for a whole stretch; exact, one solution per stretch). A stretch
    must hold all of the false fixes, or the rest of them ties the drive to their error: the most suspicious
    ones are therefore tried again, grown at either end. The deviations are scaled by what is usual on this
    drive, so that a SLAM that is worse than its estimated noise does not make every stretch suspicious.
    along_m : (m,) place of every fix along the track; components : rows of the group per fix
    """
    coarse = _spans(along_m)
    _, score = _tested(solution, group, along_m, components, coarse)
    usual = float(np.median(score[score > 0])) if (score > 0).any() else 0.0
    grown = coarse[np.argsort(-score, kind="stable")[:SUSPECTS]]
    size, score = _tested(solution, group, along_m, components, grown)
    for _ in range(GROWTH_ROUNDS):  # each end in turn moves to where the stretch stands off the most
        for end in (0, 1):
            tried = np.repeat(grown, len(GROWTH_M), axis=0)
            tried[:, end] += np.tile(GROWTH_M, len(grown))
            tried[:, 1] = np.maximum(tried[:, 1], tried[:, 0] + LENGTHS_M[0] / 2)
            size, score = _tested(solution, group, along_m, components, tried)
            pick = score.reshape(len(grown), -1).argmax(axis=1) + len(GROWTH_M) * np.arange(len(grown))
            grown, size, score = tried[pick], size[pick], score[pick]
    significance = np.sqrt(score / max(usual, 0.455 * components))
    significance[size < minimum_m] = 0.0
    best = int(significance.argmax())
    if significance[best] < SIGNIFICANT:
        return None
    inside = (along_m >= grown[best, 0]) & (along_m < grown[best, 1])
    return Offset(inside, float(size[best]), float(significance[best]))


def _tested(
    solution: Solution[State], group: int, along_m: Floats, components: int, spans: Floats
) -> tuple[Floats, Floats]:
    """Size of every stretch's own offset in metres, and its square over its variance."""
    observed, scale, weight = solution.groups[group], solution.scale[group], solution.weight[group]
    p = weight / (observed.unit * scale) ** 2
    after = observed.residual + observed.jacobian @ solution.step
    rows, columns = _members(spans, along_m, components)
    pick = sparse.csr_matrix((p[rows], (rows, columns)), shape=(len(p), components * len(spans)))
    weighted = observed.jacobian.T @ pick
    solved = solution.lu.solve(weighted.toarray())
    total = np.asarray(pick.sum(axis=0)).ravel()
    information = total - np.asarray(weighted.multiply(solved).sum(axis=0)).ravel()
    usable = information > 1e-6 * np.maximum(total, 1e-300)
    safe = np.where(usable, information, 1.0)
    offset = np.where(usable, (pick.T @ after) / safe, 0.0).reshape(-1, components)
    score: Floats = (offset**2 * safe.reshape(-1, components)).sum(axis=1)
    return np.sqrt((offset**2).sum(axis=1)), score


def _spans(along_m: Floats) -> Floats:
    low, high = float(along_m.min()), float(along_m.max())
    spans = []
    for length in LENGTHS_M:
        starts = np.arange(low, max(high - length / 2, low + 1e-6), length / 4)
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
