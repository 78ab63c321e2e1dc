"""The vertical part of a pose graph: lift and tilt of every node, linear in all of them.

Roll and pitch that SLAM has wrong tilt all it sees from there on, so heights drift with the way times the tilt. A
tilt is written as the slope that must be added along both axes of the SLAM frame: for the small angles in question
that is the turn about the level axes, and it does not change where the vehicle turns (Sola, Deray and Atchuthan
2018, left perturbation). Lifts and tilts change x and y by the square of a tilt only, some millimetres over 100 m:
the plane is adjusted before and apart.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LIFT, TILT_X, TILT_Y, SLOW = range(4)
"""Unknowns of a node: what is added to its height, the slope added along x and y of the SLAM frame in metres per
metre, and by how many of their deviations altitudes are too high there for a while.
"""

PER_NODE, SHARED = 4, 2
"""Unknowns of every node, and those after all others: the tilt of the whole frame along x and y."""


class UpState(NamedTuple):
    """node : (n, 4) see above; frame : (2,)"""

    node: Floats
    frame: Floats

    def moved(self, step: Floats) -> UpState:
        """The state after a correction of all unknowns."""
        own = step[:-SHARED].reshape(-1, PER_NODE)
        return UpState(self.node + own, self.frame + step[-SHARED:])

    def vector(self) -> Floats:
        """All unknowns in one."""
        return np.concatenate([self.node.ravel(), self.frame])


class Rows(NamedTuple):
    """Observations: jacobian @ unknowns should be `expected`, (r, u) and (r,)."""

    jacobian: sparse.csr_matrix
    expected: Floats

    def residual(self, at: UpState) -> Floats:
        """(r,) how much the unknowns exceed what was expected."""
        out: Floats = self.jacobian @ at.vector() - self.expected
        return out


def start(nodes: int, lift_m: float) -> UpState:
    """All nodes lifted alike."""
    node = np.zeros((nodes, PER_NODE))
    node[:, LIFT] = lift_m
    return UpState(node, np.zeros(SHARED))


def climb_rows(nodes: int, first: Ints, second: Ints, xyz_m: Floats, scale: float) -> Rows:
    """What SLAM says of the heights of pairs: their difference, through the tilt of both.

    first, second : (m,) nodes; xyz_m : (n, 3) nodes in the SLAM frame; scale : metres per SLAM metre
    """
    way = scale * (xyz_m[second] - xyz_m[first])
    one = np.ones(len(first))
    columns = [(_at(second, LIFT), one), (_at(first, LIFT), -one)]
    columns += [(_at(k, TILT_X + axis), -way[:, axis] / 2) for k in (first, second) for axis in (0, 1)]
    return _rows(nodes, columns, way[:, 2] * (1.0 - 1.0 / scale))


def turn_rows(nodes: int, first: Ints, second: Ints) -> Rows:
    """What SLAM says of pairs that it sees from one another: they are tilted alike, along x, then all along y."""
    one = np.ones(len(first))
    return _both(
        _rows(nodes, [(_at(second, part), one), (_at(first, part), -one)], 0 * one)
        for part in (TILT_X, TILT_Y)
    )


def drift_rows(nodes: int, kept: Floats) -> Rows:
    """How tilts wander: of what a node is tilted beyond the frame the next one keeps a share (n - 1,).

    Along x, then all along y; the first row of both ties the first node to the frame.
    """
    kept, frame = np.append(0.0, kept), np.full(nodes, PER_NODE * nodes)
    return _both(
        _rows(nodes, [*_walk(TILT_X + axis, kept), (frame + axis, kept - 1.0)], 0 * kept) for axis in (0, 1)
    )


def _both(axes: Iterable[Rows]) -> Rows:
    """One noise holds along both axes, so that the way the frame is turned does not matter."""
    parts = list(axes)
    jacobian = sparse.vstack([p.jacobian for p in parts]).tocsr()
    return Rows(jacobian, np.concatenate([p.expected for p in parts]))


def slow_rows(nodes: int, kept: Floats) -> Rows:
    """How slow errors of altitudes wander: the next node keeps a share (n - 1,) of them."""
    kept = np.append(0.0, kept)
    return _rows(nodes, _walk(SLOW, kept), 0 * kept)


def _walk(part: int, kept: Floats) -> list[tuple[Ints, Floats]]:
    each = np.arange(len(kept))
    return [(_at(each, part), np.ones(len(kept))), (_at(np.maximum(each - 1, 0), part), -kept)]


def frame_rows(nodes: int) -> Rows:
    """The frame as a whole is about level."""
    return _rows(nodes, [(PER_NODE * nodes + np.arange(SHARED), np.ones(SHARED))], np.zeros(SHARED))


def height_rows(nodes: int, node: Ints, arm_m: Floats, misfit_m: Floats, slow_m: Floats) -> Rows:
    """Heights seen at nodes.

    arm_m : (m, 2) from the node to what was seen, along x and y of the SLAM frame
    misfit_m : (m,) how much higher it lies than SLAM has it; slow_m : (m,) deviation of its slow error
    """
    columns = [(_at(node, LIFT), np.ones(len(node))), (_at(node, SLOW), slow_m)]
    columns += [(_at(node, TILT_X + axis), arm_m[:, axis]) for axis in (0, 1)]
    return _rows(nodes, columns, misfit_m)


def _at(node: Ints, part: int) -> Ints:
    """Columns of an unknown of nodes."""
    return PER_NODE * node + part


def _rows(nodes: int, columns: list[tuple[Ints, Floats]], expected: Floats) -> Rows:
    """Rows from the columns that each has, and its values there: all (r,)."""
    count = len(expected)
    row = np.tile(np.arange(count), len(columns))
    column = np.concatenate([c for c, _ in columns])
    value = np.concatenate([v for _, v in columns])
    shape = (count, PER_NODE * nodes + SHARED)
    return Rows(sparse.csr_matrix((value, (row, column)), shape=shape), expected)
