"""A planar pose graph: residuals and Jacobians of its observations, as sparse rows.

The unknowns are x, y, yaw of every node, then the lever arm (forward, left), the logarithm of the SLAM
scale, and the clock offset. An observation is a pair of rows that is divided by its standard deviations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from flexmap_tasks.geometry.se2 import rotated, wrapped

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

GLOBALS = 4
"""Unknowns after the poses: lever forward, lever left, log scale, clock offset in seconds."""


class State(NamedTuple):
    """pose : (n, 3) x, y, yaw; shared : (4,) lever forward, lever left, log scale, clock offset."""

    pose: Floats
    shared: Floats

    def moved(self, step: Floats) -> State:
        """The state after a correction of all unknowns."""
        pose = self.pose + step[:-GLOBALS].reshape(-1, 3)
        return State(pose, self.shared + step[-GLOBALS:])


class Relative(NamedTuple):
    """What SLAM says of pairs: pose of `second` seen from `first`, in SLAM metres.

    first, second : (m,) rows; motion : (m, 3) x, y, yaw
    """

    first: Ints
    second: Ints
    motion: Floats


class Fix(NamedTuple):
    """What GNSS says of the antenna at nodes.

    node : (m,) rows; body : (m, 2) place of the body frame seen from the node, SLAM metres, and
    turn : (m,) its yaw there, velocity : (m, 2) its derivative in time, metres per second
    target : (m, 2) the fix; across : (m,) direction, radians, of the first of its two components
    """

    node: Ints
    body: Floats
    turn: Floats
    velocity: Floats
    target: Floats
    across: Floats


class Rows(NamedTuple):
    """residual : (r,); jacobian : sparse (r, u)."""

    residual: Floats
    jacobian: sparse.csr_matrix


def relative_rows(state: State, pairs: Relative) -> Rows:
    """Three rows per pair: forward, left and yaw of prediction minus SLAM."""
    i, j = pairs.first, pairs.second
    yaw = state.pose[i, 2]
    gap = state.pose[j, :2] - state.pose[i, :2]
    local = rotated(gap, -yaw)
    scale = np.exp(state.shared[2])
    turn = wrapped(state.pose[j, 2] - yaw - pairs.motion[:, 2])
    residual = np.column_stack([local - scale * pairs.motion[:, :2], turn])
    c, s, one = np.cos(yaw), np.sin(yaw), np.ones(len(i))
    d = -scale * pairs.motion
    n = 3 * len(state.pose)
    blocks = [
        (0, 3 * i, -c), (0, 3 * i + 1, -s), (0, 3 * i + 2, local[:, 1]), (0, 3 * j, c), (0, 3 * j + 1, s),
        (1, 3 * i, s), (1, 3 * i + 1, -c), (1, 3 * i + 2, -local[:, 0]), (1, 3 * j, -s), (1, 3 * j + 1, c),
        (2, 3 * i + 2, -one), (2, 3 * j + 2, one),
        (0, np.full(len(i), n + 2), d[:, 0]), (1, np.full(len(i), n + 2), d[:, 1]),
    ]  # fmt: skip
    return _rows(residual, blocks, n + GLOBALS)


def fix_rows(state: State, fixes: Fix, *, antenna: bool = True) -> Rows:
    """Two rows per fix: prediction minus fix, along `across` and at right angles to it.

    antenna : the fix is of the antenna, through lever arm and clock; else of the body's own place `body`
    """
    k, (forward, left, log_scale, offset) = fixes.node, state.shared.tolist()
    if not antenna:
        forward, left, offset = 0.0, 0.0, 0.0
    yaw, scale = state.pose[k, 2], np.exp(log_scale)
    lever = rotated(np.tile([forward, left], (len(k), 1)), fixes.turn)
    arm = scale * (fixes.body + offset * fixes.velocity) + lever
    out = rotated(arm, yaw)
    gap = state.pose[k, :2] + out - fixes.target
    to_axes = -fixes.across
    residual = rotated(gap, to_axes)
    quarter = np.column_stack([-out[:, 1], out[:, 0]])
    heading = yaw + fixes.turn
    velocity = rotated(scale * fixes.velocity, yaw)
    body = rotated(scale * fixes.body, yaw)
    n = 3 * len(state.pose)
    columns = [
        (3 * k, np.tile([1.0, 0.0], (len(k), 1))),
        (3 * k + 1, np.tile([0.0, 1.0], (len(k), 1))),
        (3 * k + 2, quarter),
        (np.full(len(k), n), np.column_stack([np.cos(heading), np.sin(heading)])),
        (np.full(len(k), n + 1), np.column_stack([-np.sin(heading), np.cos(heading)])),
        (np.full(len(k), n + 2), body + offset * velocity),
        (np.full(len(k), n + 3), velocity),
    ]
    if not antenna:
        columns = [c for c in columns if c[0].size == 0 or c[0][0] not in (n, n + 1, n + 3)]
    blocks = []
    for column, derivative in columns:
        turned = rotated(derivative, to_axes)
        blocks += [(0, column, turned[:, 0]), (1, column, turned[:, 1])]
    return _rows(residual, blocks, n + GLOBALS)


def _rows(residual: Floats, blocks: list[tuple[int, Ints, Floats]], unknowns: int) -> Rows:
    count, height = residual.shape
    row = np.concatenate([height * np.arange(count) + part for part, _, _ in blocks])
    column = np.concatenate([c for _, c, _ in blocks])
    value = np.concatenate([v for _, _, v in blocks])
    jacobian = sparse.csr_matrix((value, (row, column)), shape=(residual.size, unknowns))
    return Rows(residual.ravel(), jacobian)
