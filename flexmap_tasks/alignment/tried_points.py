"""What control points would do to a pose graph that is solved without them: adjusted from where it stands.

Rigid start, association of the fixes and the search for stretches that stand off are not done again: they cost
nearly all of a run's time. A run with the same points may therefore differ a little.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from flexmap_tasks.alignment.correspondence import Correspondence
from flexmap_tasks.alignment.drive import Drive
from flexmap_tasks.alignment.observations import EXPECTED, FLOOR, START, Known, groups_of
from flexmap_tasks.alignment.pose_graph import checked_drive, control_of, first_stamp, no_control
from flexmap_tasks.alignment.solve import Solved, solve
from flexmap_tasks.config import PoseGraphParams
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.geometry.adjustment import Solution, adjust
from flexmap_tasks.geometry.graph2d import GLOBALS, Rows, State, fix_rows
from flexmap_tasks.geometry.se2 import wrapped
from flexmap_tasks.model.alignment import ControlPoints, RigidMotion, Warp
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.bend import Bend
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import GnssTrack, Trajectory

ROUNDS = 2
"""Estimates of the noise on the way."""


class SolvedDrive(NamedTuple):
    """A drive whose pose graph is solved without control points."""

    drive: Drive
    solved: Solved
    params: PoseGraphParams


class Tried(NamedTuple):
    """What points would do.

    warp : in the plane, heights stay; antenna_m : (k, 2) where the nodes' antenna goes
    residual_m : (n,) how far each point is from its target then; left_out_m : (n,) how far it is if all others in
    use but not itself are used
    """

    warp: Warp
    antenna_m: Floats
    residual_m: Floats
    left_out_m: Floats


def solved_drive(
    slam: Trajectory, gnss: GnssTrack, projection: Projection, params: PoseGraphParams
) -> SolvedDrive:
    """The graph without control points. Raises AlignmentError as the stage does."""
    drive = checked_drive(slam, params)
    log_scale = float(np.log(projection.grid_scale_factor))
    return SolvedDrive(drive, solve(drive, gnss, first_stamp(slam), log_scale, no_control(), params), params)


def tried(base: SolvedDrive, points: ControlPoints, motion: RigidMotion) -> Tried:
    """The graph with the points; `motion` is the rigid start that their sources are given after."""
    solved, used = base.solved, points.used
    state = solved.solution.state
    every, sigma_m = control_of(replace(points, used=np.ones(len(points), bool)), motion, base.drive)
    chosen, _ = control_of(points, motion, base.drive)
    if not len(every.node):
        return Tried(_warp(base, state), state.antenna, np.zeros(0), np.zeros(0))
    solution = None
    if used.any():
        known = solved.known._replace(control=chosen, control_sigma_m=sigma_m[used])
        solution = _adjusted(known, solved.found, state, solved.solution.scale)
        state = solution.state
    residual = _apart(fix_rows(state, every, antenna=False).residual)
    left_out = residual.copy()
    if solution is not None:
        left_out[used] = _left_out(fix_rows(state, chosen, antenna=False), sigma_m[used], solution)
    return Tried(_warp(base, state), state.antenna, residual, left_out)


def _apart(residual: Floats) -> Floats:
    """(n,) lengths of (2n,) pairs."""
    apart: Floats = np.hypot(*residual.reshape(-1, 2).T)
    return apart


def _adjusted(known: Known, found: Correspondence, state: State, scale: Floats) -> Solution[State]:
    """From where the graph stands, without looking for other places of the fixes."""
    try:
        observed = partial(groups_of, known, found)
        return adjust(state, observed, scale[: len(START)], FLOOR, ROUNDS, GLOBALS, EXPECTED)
    except RuntimeError:
        raise AlignmentError("control points", "contradict each other and the drive") from None


def _left_out(rows: Rows, sigma_m: Floats, solution: Solution[State]) -> Floats:
    """(n,) residuals as if each observation had not taken part, in closed form: (I - H)^-1 r per point, where H is
    its block of the hat matrix.
    """
    jacobian = rows.jacobian.toarray()
    spread = jacobian @ solution.lu.solve(np.ascontiguousarray(jacobian.T))
    n = len(sigma_m)
    own = spread.reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n)] / sigma_m[:, None, None] ** 2
    free = np.eye(2) - own
    alone = np.asarray(np.linalg.solve(free, rows.residual.reshape(n, 2, 1)), np.float64)
    return _apart(alone)


def _warp(base: SolvedDrive, state: State) -> Warp:
    nodes = base.drive.pose[base.drive.node]
    fit, n = base.solved.fit, len(nodes)
    zero, one = np.zeros(n), np.ones(n)
    bend = Bend.level(
        source_xy_m=np.ascontiguousarray(nodes[:, :2]),
        target_xy_m=np.ascontiguousarray(state.pose[:, :2]),
        turn_rad=wrapped(state.pose[:, 2] - nodes[:, 2]),
        stretch=one * float(np.exp(state.shared[2])),
        lift_m=zero,
        sigma_m=zero,
        sigma_turn_rad=zero,
        blend_m=one * base.params.blend_sigma_m,
        source_z_m=base.drive.z_m[base.drive.node],
    )
    return Warp(RigidMotion(fit.rotation, fit.translation, 1.0, fit.scale, fit.rmse), None, bend=bend)
