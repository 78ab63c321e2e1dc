"""Stretches of GNSS that stand off as a whole: multipath that no single fix betrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.stats import chi2

from flexmap_tasks.geometry.adjustment import Group, Solution
from flexmap_tasks.geometry.graph2d import Fix, State
from flexmap_tasks.geometry.intervals import Offsets, offsets_of_intervals
from flexmap_tasks.geometry.normal_equations import factor
from flexmap_tasks.geometry.polyline import steps_m
from flexmap_tasks.model.arrays import Bools, Floats, Ints

CELL_M = 5.0
"""Stretches begin and end at multiples of this way; a longer step between two fixes counts as one such step."""

SHORTEST_CELLS, LONGEST_CELLS = 4, 50
"""Stretches from 20 to 250 m are looked for."""

CORE_CELLS, MARGIN_CELLS = 120, 60
"""Stretches that begin in a core are judged with the nodes of the core, the longest stretch and a margin around it
free, all others held: what lies further away has no say, and the cost grows with the drive alone."""

SIGNIFICANT = 6.0
"""A stretch stands off when its offset is this many times its own deviation, as the whole drive shows it."""


TOGETHER = 0.5
"""Stretches much less significant than the worst may be its shadow: they are judged again without it."""


class Offset(NamedTuple):
    """A stretch that stands off: fixes (rows of the group), offset in metres, and its significance."""

    rows: Bools
    offset_m: float
    significance: float


class _Ties(NamedTuple):
    """The fixes in the order of the drive.

    row : (m,) place of every fix in the group; node, cell : (m,); across : (m,) direction of its first component
    """

    row: Ints
    node: Ints
    cell: Ints
    across: Floats


def standing_off(solution: Solution[State], group: int, fixes: Fix, minimum_m: float) -> list[Offset]:
    """Stretches whose own constant offset explains the most, none near another; the most significant first.

    For every stretch of the drive the adjustment is asked what an offset of its own would come out as and how
    sure that would be: all its fixes left out and compared with what the rest says (Baarda's test of an outlier,
    for a whole stretch). Deviations are scaled by what is usual for stretches of that length on this drive (an
    empirical null, Efron 2004), so neither coloured noise nor noise that a bad stretch has inflated decides.
    """
    ties = _ordered(fixes)
    cells = int(ties.cell[-1]) + 1
    found = [_tested(solution, solution.groups[group], group, ties, c) for c in range(0, cells, CORE_CELLS)]
    tested = Offsets(*(np.concatenate(columns) for columns in zip(*found, strict=True)))
    significance = np.sqrt(tested.score / _usual(tested))
    size = _seen_m(tested, ties, len(solution.groups[group].residual) // len(ties.row))
    significance[size < minimum_m] = 0.0
    out: list[Offset] = []
    least = max(SIGNIFICANT, TOGETHER * float(significance.max(initial=0.0)))
    while len(significance) and significance.max() >= least:
        best = int(significance.argmax())
        low, high = tested.start[best], tested.start[best] + tested.cells[best]
        rows = np.zeros(len(fixes.node), bool)
        rows[ties.row[(ties.cell >= low) & (ties.cell < high)]] = True
        out.append(Offset(rows, float(size[best]), float(significance[best])))
        apart = (tested.start >= high + MARGIN_CELLS) | (tested.start + tested.cells <= low - MARGIN_CELLS)
        significance = np.where(apart, significance, 0.0)
    return out


def _seen_m(tested: Offsets, ties: _Ties, components: int) -> Floats:
    """(k,) how large the offsets are as fixes see them: those of one component only across the way."""
    if components == 2:
        size: Floats = np.hypot(*tested.offset_m.T)
        return size
    c, s = np.cos(ties.across), np.sin(ties.across)
    cells = int(ties.cell[-1]) + 1
    sums = [np.bincount(ties.cell, w, cells) for w in (c * c, c * s, s * s, np.ones(len(c)))]
    running = np.concatenate([[[0.0] * 4], np.cumsum(np.column_stack(sums), axis=0)])
    cc, cs, ss, count = (running[tested.start + tested.cells] - running[tested.start]).T
    east, north = tested.offset_m.T
    square = east**2 * cc + 2 * east * north * cs + north**2 * ss
    out: Floats = np.sqrt(np.maximum(square, 0.0) / np.maximum(count, 1.0))
    return out


def _ordered(fixes: Fix) -> _Ties:
    row = np.argsort(fixes.node, kind="stable")
    way = np.concatenate([[0.0], np.cumsum(np.minimum(steps_m(fixes.target[row]), CELL_M))])
    return _Ties(row, fixes.node[row], (way // CELL_M).astype(np.int64), fixes.across[row])


def _usual(tested: Offsets) -> Floats:
    """(k,) typical score of stretches of the same length, as a factor on what noise alone would give."""
    usual = np.ones(LONGEST_CELLS + 1)
    for length in np.unique(tested.cells).tolist():
        usual[length] = np.median(tested.score[tested.cells == length])
    out: Floats = np.maximum(usual[tested.cells] / chi2.median(2), 1e-6)
    return out


def _tested(solution: Solution[State], observed: Group, group: int, ties: _Ties, first: int) -> Offsets:
    """Offset and score of all stretches that begin in the core at cell `first`."""
    last = min(first + CORE_CELLS + LONGEST_CELLS, int(ties.cell[-1]) + 1)
    inside = (ties.cell >= first) & (ties.cell < last)
    unknowns = _free(ties, first - MARGIN_CELLS, last + MARGIN_CELLS, solution)
    offsets, rows = _offsets(ties, inside, first, last, len(observed.residual) // len(ties.row))
    p = solution.weight[group][rows] / (observed.unit[rows] * solution.scale[group]) ** 2
    jacobian = observed.jacobian[rows]
    weighted_offsets = (sparse.diags(p) @ offsets).tocsr()
    coupling = (jacobian[:, unknowns].T @ weighted_offsets).tocsr()
    solved = factor(solution.normal[unknowns][:, unknowns].tocsc()).solve(coupling.toarray())
    information = (offsets.T @ weighted_offsets).toarray() - coupling.T @ solved
    right = weighted_offsets.T @ (observed.residual[rows] + jacobian @ solution.step)
    starts = min(CORE_CELLS, last - first)
    found = offsets_of_intervals(information, right, starts, SHORTEST_CELLS, LONGEST_CELLS)
    return found._replace(start=found.start + first)


def _free(ties: _Ties, low: int, high: int, solution: Solution[State]) -> Ints:
    """Unknowns of the nodes between two cells, of all before the first fix and after the last, and drift there."""
    nodes, drifts = len(solution.state.pose), solution.state.drift.size
    before, behind = ties.node[ties.cell < low], ties.node[ties.cell >= high]
    start = before[-1] + 1 if len(before) else 0
    stop = behind[0] if len(behind) else nodes
    own = np.arange(3 * start, 3 * stop)
    drift = np.unique(solution.normal[3 * nodes : 3 * nodes + drifts, 3 * start : 3 * stop].nonzero()[0])
    return np.concatenate([own, 3 * nodes + drift])


def _offsets(
    ties: _Ties, inside: Bools, first: int, last: int, components: int
) -> tuple[sparse.csr_matrix, Ints]:
    """How an offset east and north of every cell enters the rows of the fixes inside, and which rows these are."""
    cell, across = ties.cell[inside] - first, ties.across[inside]
    part = np.arange(components)
    rows = (components * ties.row[inside][:, None] + part).ravel()
    angle = (across[:, None] + part * np.pi / 2).ravel()
    value = np.column_stack([np.cos(angle), np.sin(angle)]).ravel()
    column = 2 * np.repeat(cell, 2 * components) + np.tile([0, 1], len(rows))
    row = np.repeat(np.arange(len(rows)), 2)
    return sparse.csr_matrix((value, (row, column)), shape=(len(rows), 2 * (last - first))), rows
