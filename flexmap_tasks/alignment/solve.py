"""The pose graph solved: from tracks to adjusted nodes."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from flexmap_tasks.alignment.correspondence import (
    Correspondence,
    by_shape,
    by_time,
    gnss_seconds,
    timed_start,
)
from flexmap_tasks.alignment.drive import Drive
from flexmap_tasks.alignment.gnss_line import GnssLine, driven_line
from flexmap_tasks.alignment.observations import BEGIN, EXPECTED, FLOOR, GNSS, START, Known, groups_of
from flexmap_tasks.alignment.overlap import refuse_other_shape
from flexmap_tasks.alignment.revisits import closes, revisit_edges
from flexmap_tasks.alignment.rigid_start import Start, rigid_start
from flexmap_tasks.alignment.stretches import standing_off
from flexmap_tasks.config import PoseGraphParams
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.geometry.adjustment import Solution, adjust
from flexmap_tasks.geometry.graph2d import GLOBALS, Fix, Relative, State
from flexmap_tasks.geometry.rigid import PlanarFit
from flexmap_tasks.geometry.se2 import between
from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.model.tracks import GnssTrack

UNKNOWN_SIGMA_M = 0.03
"""Stands for the sigma of fixes that state none; its factor is estimated like every other."""

MULTIPATH = "multipath: a stretch that stands off as a whole"

LOOSE = (30.0, 5.0, 1.0, 1.0)
"""How many times its stated sigma GNSS is given in the first steps, while the start is metres off."""

FIRM = 2
"""Steps after them with the noise that is expected: they tell which start fits best."""

LEVER_STARTS_M = (1.5, -1.5)
"""Without time a corner looks nearly alike from an antenna ahead and one behind: both are tried."""

SCALE_ROUNDS, SETTLED_SHARE, SETTLED_M = 12, 0.06, 0.002
"""Noise is estimated so many times at most, until it changes by less than a share and no pose by more than this."""

MIN_FIXES = 3

MIN_LINE_M = 20.0
"""A shorter drive has no direction worth the name."""

SEARCHES = 6
"""Stretches near one another are switched off one after the other, those far apart at once."""


class Solved(NamedTuple):
    """The adjusted drive, with all that led to it.

    fit : the rigid start; timed : whether stamps were used; line, reason : the GNSS line, and why fixes are not on it
    found : the fixes in use; solution : of the last adjustment; start : how shapes began it, or None when timed
    """

    fit: PlanarFit
    timed: bool
    line: GnssLine
    reason: Strings
    known: Known
    found: Correspondence
    solution: Solution[State]
    start: Start | None

    @property
    def along_m(self) -> Floats | None:
        """(k,) arc length on the line per node, or None when timed."""
        return None if self.start is None else self.start.along_m


class _Tie(NamedTuple):
    """How fixes find their nodes: by time, or by shape from an arc length per node.

    off : (k,) fixes of the line that are switched off
    """

    drive: Drive
    line: GnssLine
    sigma_m: Floats
    gnss_s: Floats | None
    along_m: Floats | None
    off: Bools

    def at(self, state: State) -> Correspondence:
        """The fixes tied to nodes at a state."""
        if self.along_m is not None:
            found = by_shape(state, self.line, self.along_m, self.sigma_m)
        else:
            gnss_s = np.empty(0) if self.gnss_s is None else self.gnss_s
            found = by_time(state, self.drive, self.line, gnss_s, self.sigma_m)
        keep = ~self.off[found.line_row]
        return Correspondence(found.fix.take(keep), found.line_row[keep], found.sigma_m[keep])


def solve(
    drive: Drive,
    gnss: GnssTrack,
    first_ns: int,
    log_scale: float,
    control: tuple[Fix, Floats],
    params: PoseGraphParams,
    withheld: Bools | None = None,
    *,
    search: bool = True,
    closed: bool | None = None,
) -> Solved:
    """Rigid start, then adjustment and association in turns, then stretches that stand off switched off.

    first_ns : stamp of the first pose; withheld : (m,) fixes that must not be used
    search : look for stretches that stand off, which costs more than all the rest
    closed : whether SLAM closes its loops, where that is known; found out when None
    Raises AlignmentError when the tracks do not determine an alignment.
    """
    line, reason = driven_line(gnss, withheld)
    _check(line)
    gnss_s = None if drive.stamp_s is None else gnss_seconds(gnss, line, first_ns)
    fit, offset, start = _start(drive, line, gnss_s, params.clock_offset_max_s)
    levers = (0.0,) if start is None else LEVER_STARTS_M
    known = _known(drive, log_scale, control, start is None, params.clock_offset_max_s)
    if start is not None and withheld is None:
        refuse_other_shape(start, drive.pose[drive.node, :2], line)
    along = None if start is None else start.along_m
    tie = _Tie(drive, line, _sigmas(gnss, line), gnss_s, along, np.zeros(len(line.fix), bool))
    pose = _moved(drive, fit) if start is None else start.pose
    drift = np.zeros((int(drive.part[-1]) + 1, 2))
    starts = [State(pose, drift, np.array([forward, 0.0, log_scale, offset])) for forward in levers]
    revisit = revisit_edges(drive.pose[drive.node], params.revisit_radius_m)
    found, solution = _begun(known, tie, starts)
    if closed:
        known = known._replace(revisit=revisit)
    order = None if closed else solution.lu.order
    found, solution = _adjusted(known, tie, solution.state, START, SCALE_ROUNDS, order)
    if closed is None and closes(revisit, solution):
        known = known._replace(revisit=revisit)
        found, solution = _adjusted(known, tie, solution.state, solution.scale, SCALE_ROUNDS)
    for _ in range(SEARCHES if search else 0):
        stretches = standing_off(solution, GNSS, found.fix, params.multipath_min_m)
        if not stretches:
            break
        off = tie.off.copy()
        for stretch in stretches:
            rows = found.line_row[stretch.rows]
            off[rows.min() : rows.max() + 1] = True
        tie = tie._replace(off=off)
        reason[line.fix[tie.off]] = MULTIPATH
        found, solution = _adjusted(
            known, tie, solution.state, solution.scale, SCALE_ROUNDS, solution.lu.order
        )
    return Solved(fit, known.timed, line, reason, known, found, solution, start)


def _start(
    drive: Drive, line: GnssLine, gnss_s: Floats | None, offset_max_s: float
) -> tuple[PlanarFit, float, Start | None]:
    """Rigid fit, clock offset, and where shapes lay the nodes when time does not tie the tracks."""
    timed = None if gnss_s is None else timed_start(drive, line, gnss_s, offset_max_s)
    if timed is not None:
        return *timed, None
    start = rigid_start(drive.pose[drive.node], line)
    return start.fit, 0.0, start


def _moved(drive: Drive, fit: PlanarFit) -> Floats:
    nodes = drive.pose[drive.node]
    turn = float(np.arctan2(fit.rotation[1, 0], fit.rotation[0, 0]))
    return np.column_stack([nodes[:, :2] @ fit.rotation.T + fit.translation, nodes[:, 2] + turn])


def _known(
    drive: Drive, log_scale: float, control: tuple[Fix, Floats], timed: bool, offset_max_s: float
) -> Known:
    nodes = drive.pose[drive.node]
    row = np.arange(len(nodes) - 1)
    return Known(
        odometry=Relative(row, row + 1, between(nodes[:-1], nodes[1:]), drive.part[:-1]),
        revisit=revisit_edges(nodes, 0.0),
        control=control[0],
        control_sigma_m=control[1],
        timed=timed,
        log_scale=log_scale,
        clock_sigma_s=offset_max_s if timed else 0.0,
    )


def _begun(known: Known, tie: _Tie, starts: list[State]) -> tuple[Correspondence, Solution[State]]:
    """From every start by steps that believe GNSS, then SLAM, more and more; the one that fits best."""
    best: tuple[Correspondence, Solution[State]] | None = None
    order: Ints | None = None
    for start in starts:
        state = start
        first = START if known.timed else BEGIN
        loose = [first * np.where(np.arange(len(first)) == GNSS, factor, 1.0) for factor in LOOSE]
        for scale in [*loose, *[START] * FIRM]:
            found, solution = _adjusted(known, tie, state, scale, 0, order)
            state, order = solution.state, solution.lu.order
        if best is None or solution.misfit < best[1].misfit:
            best = found, solution
    if best is None:
        raise ValueError("a start is needed")
    return best


def _adjusted(
    known: Known, tie: _Tie, state: State, scale: Floats, rounds: int, order: Ints | None = None
) -> tuple[Correspondence, Solution[State]]:
    """Associate and adjust in turns until the estimated noise settles, at most `rounds` times.

    With 0 rounds once, with the given noise. order : of elimination, where the graph has been adjusted before
    """
    for turn in range(max(rounds, 1)):
        found = tie.at(state)
        if len(found.sigma_m) < MIN_FIXES:
            raise AlignmentError(
                "GNSS track",
                f"only {len(found.sigma_m)} fixes belong to the SLAM trajectory; check both inputs",
            )
        try:
            solution = adjust(
                state,
                partial(groups_of, known, found),
                scale,
                FLOOR,
                min(rounds, 1),
                GLOBALS,
                EXPECTED,
                order,
            )
        except RuntimeError:
            raise AlignmentError(
                "tracks", "SLAM and GNSS do not determine an alignment; a longer drive with turns is needed"
            ) from None
        moved = float(np.abs(solution.state.pose[:, :2] - state.pose[:, :2]).max())
        settled = (
            np.abs(solution.scale[: len(scale)] / scale - 1.0).max() < SETTLED_SHARE and moved < SETTLED_M
        )
        state, scale, order = solution.state, solution.scale[: len(scale)], solution.lu.order
        if settled and turn:
            break
    return found, solution


def _sigmas(gnss: GnssTrack, line: GnssLine) -> Floats:
    sigma = np.hypot(*gnss.sigma_m[line.fix, :2].T) / np.sqrt(2)
    return np.clip(np.where(np.isfinite(sigma) & (sigma > 0), sigma, UNKNOWN_SIGMA_M), 0.005, None)


def _check(line: GnssLine) -> None:
    if len(line.fix) < 3 or line.along_m[-1] < MIN_LINE_M:
        length = line.along_m[-1] if len(line.fix) else 0.0
        raise AlignmentError(
            "GNSS track",
            f"{len(line.fix)} usable fixes over {length:.1f} m; at least 3 over {MIN_LINE_M:g} m are needed",
        )
