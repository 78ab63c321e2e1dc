"""The vertical graph: lift and tilt of every node, from SLAM's own climb, roll and pitch and from heights seen."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from flexmap_tasks.alignment.revisits import typically_below
from flexmap_tasks.geometry import graph_up
from flexmap_tasks.geometry.adjustment import KERNEL, Group, Solution, adjust
from flexmap_tasks.geometry.graph2d import Relative
from flexmap_tasks.geometry.graph_up import UpState
from flexmap_tasks.geometry.normal_equations import inverse_on_pattern
from flexmap_tasks.geometry.polyline import steps_m
from flexmap_tasks.model.arrays import Floats, Ints

CLIMB, TILT, ALTITUDE, REVISIT, REVISIT_TILT = range(5)
"""Places of the groups whose noise is estimated."""

START = np.array([0.02, 5e-4, 1.0, 0.1, 0.005])
"""Where the estimates begin: metres and radians per 3 m of SLAM, a factor on the stated sigmas, and metres and
radians by which SLAM disagrees with itself."""

FLOOR = np.array([1e-4, 1e-6, 0.2, 0.02, 1e-3])
"""Noise below this is not believed of any sensor."""

STEP_M = 3.0
"""SLAM noise is stated over this way and grows with its root."""

SLOW_M, SLOW_SHARE = 200.0, 0.1
"""Errors of altitudes from the air and from reflections stay for about half a minute. They cannot be told from
SLAM's drift: what is stated of an altitude beyond its scatter is slow, and never less than this share of it."""

HELD_M = (1e6, 50.0)
"""SLAM's roll and pitch drift, or return to their level over this way, as gravity holds them: what altitudes make
more likely is taken."""

FRAME_RAD = 0.03
"""SLAM's frame is level to this, one standard deviation: it begins on a road. What no altitude tells stays so."""

OFFSET_M = 100.0
"""Stretches of altitudes that stand off do so by as much as this, one standard deviation."""

LOOSE = (100.0, 10.0)
"""Factors on the noise of altitudes in the first steps, while SLAM's drift is not known."""

ROUNDED_SIGMAS = 4.0
"""Altitudes rounded to more than this many of their deviations are intervals: within them they say nothing."""

SOFT = 8.0
"""The edges of such an interval are known to this part of it, at best."""

NEWS_M = 100.0
"""Pairs of poses on two passes nearer than this to one another along both say the same again."""

CLOSED = 2.0
"""What half of the squared disagreements of passes with all else stay under, in units of their variance: noise alone
gives 0.45.
"""

ASKED_M = 0.3
"""Only places whose heights are known so well without SLAM's word can tell whether that holds."""

BEFORE_M = 200.0
"""Way over which what wanders without end has come together before the drive begins."""

MIN_BEND = 1e-6
"""Curvature of an interval's likelihood far inside, where it says nothing."""

ROUNDS = 5


class Heights(NamedTuple):
    """What is known of heights at nodes.

    node : (m,); arm_m : (m, 2) from the node to what was seen, along x and y of the SLAM frame
    misfit_m : (m,) how much higher it lies than SLAM has it; sigma_m : (m,) stated deviation
    stretch : (m,) number of the stretch whose unknown offset is in it, -1 for none; rounded_m : what to, 0 for not
    """

    node: Ints
    arm_m: Floats
    misfit_m: Floats
    sigma_m: Floats
    stretch: Ints
    rounded_m: float

    def take(self, rows: Ints) -> Heights:
        """Those of the given rows."""
        return Heights(
            self.node[rows],
            self.arm_m[rows],
            self.misfit_m[rows],
            self.sigma_m[rows],
            self.stretch[rows],
            self.rounded_m,
        )

    def unmixed(self, nodes: int) -> Ints:
        """Rows that belong to the stretch of their node: one at which stretches meet can be of the last only."""
        of_node = np.full(nodes, -1)
        last = np.flatnonzero(np.diff(self.node, append=-1))
        of_node[self.node[last]] = self.stretch[last]
        return np.flatnonzero(self.stretch == of_node[self.node])


class Lifted(NamedTuple):
    """lift_m : (n,) added to the heights of nodes; tilt : (n, 2) slope added along x and y of the SLAM frame

    sigma_m, sigma_tilt : (n,) their standard deviations, of the tilt per axis
    scale : (g,) noise of every group; residual_m : (m,) what is left of every height seen
    """

    lift_m: Floats
    tilt: Floats
    sigma_m: Floats
    sigma_tilt: Floats
    scale: Floats
    residual_m: Floats


def lifted(xyz_m: Floats, revisit: Relative, scale: float, heights: Heights) -> Lifted:
    """Lift and tilt of all nodes with their deviations, by least squares with all noise estimated.

    xyz_m : (n, 3) nodes in the SLAM frame; scale : metres per SLAM metre
    """
    first = graph_up.start(len(xyz_m), float(np.median(heights.misfit_m)))
    none = Relative(revisit.first[:0], revisit.second[:0], revisit.motion[:0], revisit.part[:0])
    tried = [_known(xyz_m, none, scale, heights, held_m) for held_m in HELD_M]
    found = [_solved(_begun(first, known, heights), known, heights) for known in tried]
    best = int(np.argmax([_likelihood(solution) for solution in found]))
    known = _known(xyz_m, revisit, scale, heights, HELD_M[best])
    if not _closes(found[best], known[REVISIT].rows, revisit):
        return _lifted(found[best])
    return _lifted(_solved(found[best].state, known, heights))


class _Known(NamedTuple):
    rows: graph_up.Rows
    unit: Floats
    robust: Ints | None
    scale_of: int


def _known(xyz_m: Floats, revisit: Relative, scale: float, heights: Heights, held_m: float) -> list[_Known]:
    """All observations, in the order of their groups."""
    n = len(xyz_m)
    each, step = np.arange(n - 1), np.maximum(steps_m(xyz_m[:, :2]), 0.1)
    i, j = revisit.first, revisit.second
    pair, same_news = np.arange(len(i)), np.sqrt(_together(np.cumsum(step)[np.maximum([i, j], 1) - 1]))
    unit = np.sqrt(step / STEP_M)
    kept, wander = _wandering(step, held_m)
    stays, change, slow = _slow(step, heights)
    return [
        _Known(graph_up.climb_rows(n, each, each + 1, xyz_m, scale), unit, each, CLIMB),
        _Known(graph_up.drift_rows(n, kept), np.tile(np.sqrt(wander / STEP_M), 2), None, TILT),
        _Known(
            graph_up.height_rows(n, heights.node, heights.arm_m, heights.misfit_m, slow),
            heights.sigma_m, np.arange(len(heights.node)), ALTITUDE,
        ),
        _Known(graph_up.climb_rows(n, i, j, xyz_m, scale), same_news, pair, REVISIT),
        _Known(graph_up.turn_rows(n, i, j), np.tile(same_news, 2), np.tile(pair, 2), REVISIT_TILT),
        _Known(graph_up.slow_rows(n, stays), change, None, -1),
        _Known(graph_up.frame_rows(n), np.full(graph_up.SHARED, FRAME_RAD), None, -1),
    ]  # fmt: skip


def _together(along_m: Floats) -> Floats:
    """(m,) how many pairs, each counted too, begin and end about where it does: SLAM's drift is the same for them."""
    cell = np.floor(along_m / NEWS_M).astype(np.int64)
    _, of, count = np.unique(cell, axis=1, return_inverse=True, return_counts=True)
    return count[of.ravel()].astype(np.float64)


def _wandering(step_m: Floats, length_m: float) -> tuple[Floats, Floats]:
    """Share that a step (n - 1,) keeps of what returns over a length, and the way's worth of new (n,) on it, first
    what has come together before.
    """
    new = -length_m / 2 * np.expm1(-2 * step_m / length_m)
    return np.exp(-step_m / length_m), np.append(min(length_m / 2, BEFORE_M), new)


def _slow(step_m: Floats, heights: Heights) -> tuple[Floats, Floats, Floats]:
    """Share of slow errors that a step (n - 1,) keeps, deviation (n,) of what is new on it, and slow errors (m,) in
    metres per deviation. Where a stretch stands off they begin anew, from anywhere, and do not return.
    """
    n, slow = len(step_m) + 1, heights.sigma_m * _slow_share(heights)
    kept, new = _wandering(step_m, SLOW_M)
    change = np.sqrt(new / (SLOW_M / 2))
    stretch = np.full(n, -1)
    for k in range(int(heights.stretch.max(initial=-1)) + 1):
        rows = heights.stretch == k
        first, last = heights.node[rows].min(), heights.node[rows].max()
        stretch[first : last + 1], slow[rows] = k, np.median(slow[rows])
        change[first] = OFFSET_M / slow[rows][0]
    same = stretch[1:] == stretch[:-1]
    kept[same & (stretch[1:] >= 0)], kept[~same] = 1.0, 0.0
    change[1:][~same & (stretch[1:] < 0)] = 1.0
    return kept, change, slow


def _begun(state: UpState, known: list[_Known], heights: Heights) -> UpState:
    """By steps that believe altitudes more and more, noise as expected."""
    for loose in LOOSE:
        scales = _start(heights)
        scales[ALTITUDE] *= loose * max(1.0, heights.rounded_m / float(np.median(heights.sigma_m)))
        state = adjust(state, partial(_groups, known, None), scales, FLOOR, 0, graph_up.SHARED).state
    return state


def _solved(state: UpState, known: list[_Known], heights: Heights) -> Solution[UpState]:
    rounded = heights if heights.rounded_m > ROUNDED_SIGMAS * np.median(heights.sigma_m) else None
    return adjust(state, partial(_groups, known, rounded), _start(heights), FLOOR, ROUNDS, graph_up.SHARED)


def _groups(known: list[_Known], rounded: Heights | None, at: UpState) -> list[Group]:
    out = [Group(k.rows.residual(at), k.rows.jacobian, k.unit, k.robust, k.scale_of) for k in known]
    if rounded is not None:
        out[ALTITUDE] = _intervals(out[ALTITUDE], rounded)
    return out


def _start(heights: Heights) -> Floats:
    start = START.copy()
    start[ALTITUDE] = max(_scatter(heights), FLOOR[ALTITUDE])
    return start


def _closes(without: Solution[UpState], rows: graph_up.Rows, revisit: Relative) -> bool:
    """Whether SLAM's heights of places passed twice agree with what all else says: one that does not close its loops
    only repeats its drift there, as surely as if it knew.
    """
    sigma = _lifted(without).sigma_m
    square = sigma[revisit.first] ** 2 + sigma[revisit.second] ** 2 + FLOOR[REVISIT] ** 2
    ratio = rows.residual(without.state) ** 2 / square
    return typically_below(CLOSED, ratio[square < ASKED_M**2])


def _scatter(heights: Heights) -> float:
    """Deviation from one altitude to the next, which SLAM has no part in, as a factor on what is stated."""
    change = np.abs(np.diff(heights.misfit_m)) / np.hypot(heights.sigma_m[1:], heights.sigma_m[:-1])
    return 1.4826 * float(np.median(change)) if len(change) else 1.0


def _slow_share(heights: Heights) -> float:
    """Deviation of slow errors as a share of what is stated."""
    scatter = _scatter(heights)
    return max(float(np.sqrt(max(1.0 - scatter**2, 0.0))), SLOW_SHARE * scatter)


def _intervals(seen: Group, heights: Heights) -> Group:
    """Rounded altitudes by Newton's steps on their likelihood: the chance of being rounded to what they are."""
    half = heights.rounded_m / 2
    sigma = np.maximum(heights.sigma_m, heights.rounded_m / SOFT)
    low, high = (-half - seen.residual) / sigma, (half - seen.residual) / sigma
    # chances and densities of the tail that does not round to 1 (the function is even)
    side = np.where(seen.residual > 0, 1.0, -1.0)
    a, b = np.where(side > 0, low, -high), np.where(side > 0, high, -low)
    log_chance = log_ndtr(b) + np.log1p(-np.exp(np.minimum(log_ndtr(a) - log_ndtr(b), -1e-12)))
    pa, pb = (np.exp(-(x**2) / 2 - log_chance) / np.sqrt(2 * np.pi) for x in (a, b))
    slope = (pb - pa) * side  # of -log chance by residual, in units of 1 / sigma
    bend = np.maximum(slope**2 + b * pb - a * pa, MIN_BEND)
    return Group(slope / bend * sigma, seen.jacobian, sigma / np.sqrt(bend), seen.robust, -1)


def _likelihood(solution: Solution[UpState]) -> float:
    """Logarithm of the restricted likelihood (Patterson and Thompson 1971), but for a constant."""
    pivots = np.log(np.abs(solution.lu.lu.U.diagonal())).sum()
    out = -float(pivots) / 2
    for group, scale, weight in zip(solution.groups, solution.scale, solution.weight, strict=True):
        after = (group.residual + group.jacobian @ solution.step) / (group.unit * scale)
        loss = after**2 / 2 if group.robust is None else -(KERNEL**2) / 2 * np.log(weight)
        out -= float((np.log(group.unit * scale) + loss).sum())
    return out


def _lifted(solution: Solution[UpState]) -> Lifted:
    node = solution.state.node
    variance = inverse_on_pattern(solution.lu).diagonal()[: node.size].reshape(node.shape)
    sigma = np.sqrt(np.maximum(variance, 0.0))
    seen = solution.groups[ALTITUDE]
    return Lifted(
        node[:, graph_up.LIFT],
        node[:, graph_up.TILT_X : graph_up.TILT_Y + 1],
        sigma[:, graph_up.LIFT],
        np.sqrt((sigma[:, graph_up.TILT_X : graph_up.TILT_Y + 1] ** 2).mean(axis=1)),
        solution.scale,
        seen.residual + seen.jacobian @ solution.step,
    )
