"""A planar pose graph: residuals and Jacobians of its observations, as sparse rows.

The unknowns are x, y, yaw of every node, then how SLAM drifts in every part of the way (scale and yaw rate),
then the lever arm (forward, left), the logarithm of the SLAM scale, and the clock offset. An observation is a
few rows that are divided by their standard deviations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from flexmap_tasks.geometry.se2 import rotated, wrapped

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

GLOBALS = 4
"""Unknowns after the poses: lever forward, lever left, log scale, clock offset in seconds."""


class State(NamedTuple):
    """The unknowns, in their order.

    pose : (n, 3) x, y, yaw of the nodes
    drift : (p, 2) of every part of the way: logarithm of SLAM's scale there over the whole drive's, and radians
    per metre that SLAM misses of the turn
    shared : (4,) lever forward, lever left, log scale, clock offset
    """

    pose: Floats
    drift: Floats
    shared: Floats

    @property
    def unknowns(self) -> int:
        """How many there are."""
        return int(self.pose.size + self.drift.size + self.shared.size)

    @property
    def antenna(self) -> Floats:
        """(n, 2) where the antenna is at every node."""
        lever = np.tile(self.shared[:2], (len(self.pose), 1))
        out: Floats = self.pose[:, :2] + rotated(lever, self.pose[:, 2])
        return out

    def scale_in(self, part: Ints) -> Floats:
        """(m,) SLAM's scale in parts of the way; -1 stands for no part, where the whole drive's holds."""
        own = np.append(self.drift[:, 0], 0.0)
        out: Floats = np.exp(self.shared[2] + own[part])
        return out

    def moved(self, step: Floats) -> State:
        """The state after a correction of all unknowns."""
        poses, drifts = self.pose.size, self.drift.size
        return State(
            self.pose + step[:poses].reshape(-1, 3),
            self.drift + step[poses : poses + drifts].reshape(-1, 2),
            self.shared + step[poses + drifts :],
        )


class Relative(NamedTuple):
    """What SLAM says of pairs: pose of `second` seen from `first`, in SLAM metres.

    first, second : (m,) rows; motion : (m, 3) x, y, yaw
    part : (m,) part of the way whose drift is in it; -1 for a pair that was seen at once
    """

    first: Ints
    second: Ints
    motion: Floats
    part: Ints


class Seen(NamedTuple):
    """The body at the time of a fix as SLAM sees it from a node.

    node : (m,) rows; body : (m, 2) place in SLAM metres, turn : (m,) yaw there, velocity : (m, 2) derivative of the
    place in time, metres per second
    """

    node: Ints
    body: Floats
    turn: Floats
    velocity: Floats

    def take(self, rows: Bools) -> Seen:
        """Some of them."""
        return Seen(self.node[rows], self.body[rows], self.turn[rows], self.velocity[rows])


class Fix(NamedTuple):
    """What GNSS says of the antenna at nodes, or between two.

    before : from the node at or before it; after : from the next one, None when all lie at nodes
    share : (m,) how much the next one has to say: a random walk that both ends hold is expected on the line between
    what each of them predicts (a Brownian bridge)
    part : (m,) part of the way it lies in, or -1
    target : (m, 2) the fix; across : (m,) direction, radians, of the first of its two components
    """

    before: Seen
    after: Seen | None
    share: Floats
    part: Ints
    target: Floats
    across: Floats

    @property
    def node(self) -> Ints:
        """(m,) the node at or before every fix."""
        return self.before.node

    def take(self, rows: Bools) -> Fix:
        """Some of them."""
        after = None if self.after is None else self.after.take(rows)
        return Fix(
            self.before.take(rows),
            after,
            self.share[rows],
            self.part[rows],
            self.target[rows],
            self.across[rows],
        )


def at_nodes(node: Ints, body: Floats, part: Ints, target: Floats, across: Floats) -> Fix:
    """Fixes of places that stand still, seen from one node each."""
    zero = np.zeros(len(node))
    return Fix(Seen(node, body, zero, np.zeros_like(body)), None, zero, part, target, across)


class Rows(NamedTuple):
    """residual : (r,); jacobian : sparse (r, u)."""

    residual: Floats
    jacobian: sparse.csr_matrix


def relative_rows(state: State, pairs: Relative) -> Rows:
    """Three rows per pair: forward, left and yaw of prediction minus SLAM."""
    i, j, part = pairs.first, pairs.second, pairs.part
    yaw = state.pose[i, 2]
    gap = state.pose[j, :2] - state.pose[i, :2]
    local = rotated(gap, -yaw)
    scale = state.scale_in(part)[:, None]
    way = np.hypot(pairs.motion[:, 0], pairs.motion[:, 1])
    missed = np.append(state.drift[:, 1], 0.0)[part] * way
    turn = wrapped(state.pose[j, 2] - yaw - pairs.motion[:, 2] - missed)
    residual = np.column_stack([local - scale * pairs.motion[:, :2], turn])
    c, s, one = np.cos(yaw), np.sin(yaw), np.ones(len(i))
    d = -scale * pairs.motion[:, :2]
    log_scale = np.full(len(i), state.unknowns - GLOBALS + 2)
    blocks = [
        (0, 3 * i, -c), (0, 3 * i + 1, -s), (0, 3 * i + 2, local[:, 1]), (0, 3 * j, c), (0, 3 * j + 1, s),
        (1, 3 * i, s), (1, 3 * i + 1, -c), (1, 3 * i + 2, -local[:, 0]), (1, 3 * j, -s), (1, 3 * j + 1, c),
        (2, 3 * i + 2, -one), (2, 3 * j + 2, one),
        (0, log_scale, d[:, 0]), (1, log_scale, d[:, 1]),
    ]  # fmt: skip
    if len(part) and part[0] >= 0:
        own = state.pose.size + 2 * part
        blocks += [(0, own, d[:, 0]), (1, own, d[:, 1]), (2, own + 1, -way)]
    return _rows(residual, blocks, state.unknowns)


def fix_rows(state: State, fixes: Fix, *, antenna: bool = True) -> Rows:
    """Two rows per fix: prediction minus fix, along `across` and at right angles to it.

    antenna : the fix is of the antenna, through lever arm and clock; else of the body's own place `body`
    """
    residual = rotated(-fixes.target, -fixes.across)
    blocks: list[tuple[int, Ints, Floats]] = []
    ends = [(fixes.before, 1.0 - fixes.share)]
    if fixes.after is not None:
        ends.append((fixes.after, fixes.share))
    for seen, weight in ends:
        place, columns = _predicted(state, seen, fixes.part, antenna=antenna)
        residual += weight[:, None] * rotated(place, -fixes.across)
        for column, derivative in columns:
            turned = weight[:, None] * rotated(derivative, -fixes.across)
            blocks += [(0, column, turned[:, 0]), (1, column, turned[:, 1])]
    return _rows(residual, blocks, state.unknowns)


def _predicted(
    state: State, seen: Seen, part: Ints, *, antenna: bool
) -> tuple[Floats, list[tuple[Ints, Floats]]]:
    """(m, 2) where a node has the antenna, and the derivatives by column."""
    k, (forward, left, _, offset) = seen.node, state.shared.tolist()
    if not antenna:
        forward, left, offset = 0.0, 0.0, 0.0
    yaw, scale = state.pose[k, 2], state.scale_in(part)[:, None]
    heading = yaw + seen.turn
    velocity = rotated(scale * seen.velocity, yaw)
    stretched = rotated(scale * seen.body, yaw) + offset * velocity
    out = stretched + rotated(np.tile([forward, left], (len(k), 1)), heading)
    shared, one = state.unknowns - GLOBALS, np.ones(len(k))
    columns = [
        (3 * k, np.column_stack([one, 0 * one])),
        (3 * k + 1, np.column_stack([0 * one, one])),
        (3 * k + 2, np.column_stack([-out[:, 1], out[:, 0]])),
        (np.full(len(k), shared + 2), stretched),
    ]
    if len(k) and part[0] >= 0:
        columns.append((state.pose.size + 2 * part, stretched))
    if antenna:
        columns += [
            (np.full(len(k), shared), np.column_stack([np.cos(heading), np.sin(heading)])),
            (np.full(len(k), shared + 1), np.column_stack([-np.sin(heading), np.cos(heading)])),
            (np.full(len(k), shared + 3), velocity),
        ]
    return state.pose[k, :2] + out, columns


def _rows(residual: Floats, blocks: list[tuple[int, Ints, Floats]], unknowns: int) -> Rows:
    count, height = residual.shape
    row = np.concatenate([height * np.arange(count) + part for part, _, _ in blocks])
    column = np.concatenate([c for _, c, _ in blocks])
    value = np.concatenate([v for _, _, v in blocks])
    jacobian = sparse.csr_matrix((value, (row, column)), shape=(residual.size, unknowns))
    return Rows(residual.ravel(), jacobian)
