"""The pose graph solved: from tracks to adjusted nodes."""

from __future__ import annotations

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
from flexmap_tasks.alignment.observations import FLOOR, GNSS, START, Known, groups_of, revisit_sigma
from flexmap_tasks.alignment.revisits import revisit_edges
from flexmap_tasks.alignment.rigid_start import rigid_start
from flexmap_tasks.alignment.stretches import standing_off
from flexmap_tasks.config import PoseGraphParams
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.geometry.adjustment import Solution, adjust
from flexmap_tasks.geometry.graph2d import GLOBALS, Fix, Relative, State
from flexmap_tasks.geometry.rigid import PlanarFit
from flexmap_tasks.geometry.se2 import between
from flexmap_tasks.model.arrays import Bools, Floats, Strings
from flexmap_tasks.model.tracks import GnssTrack

UNKNOWN_SIGMA_M = 0.03
"""Stands for the sigma of fixes that state none; its factor is estimated like every other."""

MIN_LINE_M = 20.0
"""A shorter drive has no direction worth the name."""

MAX_STRETCHES = 12
"""Stretches that may be switched off one after the other."""

REVISIT_ROUNDS = 4
"""A SLAM that agrees with itself earns belief step by step; one that does not never gets it."""


class Solved(NamedTuple):
    """The adjusted drive, with all that led to it.

    fit : the rigid start; timed : whether stamps were used; line, reason : the GNSS line, and why fixes are not on it
    found : the fixes in use; solution : of the last adjustment; along_m : (k,) arc length on the line per node,
    or None when timed
    """

    fit: PlanarFit
    timed: bool
    line: GnssLine
    reason: Strings
    known: Known
    found: Correspondence
    solution: Solution[State]
    along_m: Floats | None


def solve(
    drive: Drive,
    gnss: GnssTrack,
    first_ns: int,
    log_scale: float,
    control: tuple[Fix, Floats],
    params: PoseGraphParams,
    withheld: Bools | None = None,
) -> Solved:
    """Rigid start, then adjustment and association in turns, then stretches that stand off switched off.

    first_ns : stamp of the first pose; withheld : (m,) fixes that must not be used
    Raises AlignmentError when the tracks do not determine an alignment.
    """
    line, reason = driven_line(gnss, withheld)
    _check(line)
    sigma = _sigmas(gnss, line)
    nodes = drive.pose[drive.node]
    gnss_s = gnss_seconds(gnss, line, first_ns) if drive.stamp_s is not None else None
    timed = None if gnss_s is None else timed_start(drive, line, gnss_s, params.clock_offset_max_s)
    along = None
    if timed is None:
        fit, along = rigid_start(nodes[:, :2], line)
        offset = 0.0
    else:
        fit, offset = timed
    turn = float(np.arctan2(fit.rotation[1, 0], fit.rotation[0, 0]))
    pose = np.column_stack([nodes[:, :2] @ fit.rotation.T + fit.translation, nodes[:, 2] + turn])
    state = State(pose, np.array([0.0, 0.0, log_scale, offset]))
    known = Known(
        odometry=Relative(
            np.arange(len(nodes) - 1), np.arange(1, len(nodes)), between(nodes[:-1], nodes[1:])
        ),
        revisit=revisit_edges(nodes, 0.0),
        revisit_sigma=(1.0, 1.0),
        control=control[0],
        control_sigma_m=control[1],
        timed=timed is not None,
        log_scale=log_scale,
        clock_sigma_s=params.clock_offset_max_s if timed is not None else 0.0,
    )
    off = np.zeros(len(line.index), bool)

    def associate(at: State) -> Correspondence:
        if gnss_s is not None and along is None:
            found = by_time(at, drive, line, gnss_s, sigma)
        else:
            found = by_shape(at, line, along if along is not None else np.empty(0), sigma)
        return _without(found, off)

    found, solution = _adjusted(known, associate, state)
    revisit = revisit_edges(nodes, params.revisit_radius_m)
    for _ in range(REVISIT_ROUNDS if len(revisit.first) else 0):
        agreement = revisit_sigma(revisit, solution.state, solution.scale)
        known = known._replace(revisit=revisit, revisit_sigma=agreement)
        found, solution = _adjusted(known, associate, solution.state, solution.scale, rounds=(1,))
    components = 2 if known.timed else 1
    for _ in range(MAX_STRETCHES):
        where = line.along_m[found.line_row]
        stretch = standing_off(solution, GNSS, where, components, params.multipath_min_m)
        if stretch is None:
            break
        span = where[stretch.rows]
        off |= (line.along_m >= span.min() - 1e-9) & (line.along_m <= span.max() + 1e-9)
        reason[line.index[off]] = "multipath: a stretch that stands off as a whole"
        found, solution = _adjusted(known, associate, solution.state, solution.scale, rounds=(1, 1))
    return Solved(fit, known.timed, line, reason, known, found, solution, along)


def _adjusted(known, associate, state, scale=None, rounds=(0, 0, 1, 1)):  # type: ignore[no-untyped-def]
    """Associate and adjust in turns; GNSS is believed loosely at first, while the start is metres off."""
    scale = START.copy() if scale is None else scale
    for k, turns in enumerate(rounds):
        found = associate(state)
        if len(found.sigma_m) < 3:
            raise AlignmentError("GNSS track", "fewer than 3 fixes belong to the SLAM trajectory")
        used = scale.copy()
        if turns == 0:
            used[GNSS] *= 30.0 if k == 0 else 5.0
        try:
            solution = adjust(state, lambda at, f=found: groups_of(known, f, at), used, FLOOR, turns, GLOBALS)
        except RuntimeError:
            raise AlignmentError(
                "tracks", "SLAM and GNSS do not determine an alignment; a longer drive with turns is needed"
            ) from None
        state = solution.state
        if turns:
            scale = solution.scale
    return found, solution


def _without(found: Correspondence, off: Bools) -> Correspondence:
    keep = ~off[found.line_row]
    fix = Fix(*(column[keep] for column in found.fix))
    return Correspondence(fix, found.line_row[keep], found.sigma_m[keep])


def _sigmas(gnss: GnssTrack, line: GnssLine) -> Floats:
    sigma = np.hypot(*gnss.sigma_m[line.index, :2].T) / np.sqrt(2)
    return np.clip(np.where(np.isfinite(sigma) & (sigma > 0), sigma, UNKNOWN_SIGMA_M), 0.005, None)


def _check(line: GnssLine) -> None:
    if len(line.index) < 3 or line.along_m[-1] < MIN_LINE_M:
        length = line.along_m[-1] if len(line.index) else 0.0
        raise AlignmentError(
            "GNSS track",
            f"{len(line.index)} usable fixes over {length:.1f} m; at least 3 over {MIN_LINE_M:g} m are needed",
        )
