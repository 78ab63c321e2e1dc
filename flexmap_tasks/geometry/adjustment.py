"""Least-squares adjustment with variance components: Gauss-Newton whose weights are estimated, not tuned.

An observation group has one unknown noise scale. It is found by maximum (restricted) likelihood: the sum of
squared residuals of a group must equal its redundancy (Helmert 1924, Foerstner 1979). Robust weights follow
Cauchy's kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from flexmap_tasks.geometry.graph2d import State
from flexmap_tasks.geometry.normal_equations import factor, inverse_on_pattern

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_CAUCHY = 2.385
"""Kernel width at which Cauchy keeps 95 % efficiency on Gaussian noise (Holland and Welsch 1977)."""


class Group(NamedTuple):
    """Observations with one common noise scale.

    residual : (r,) in units of `unit`; jacobian : (r, u); unit : (r,) assumed standard deviation of each row
    at scale 1; estimate : whether the scale is to be found; robust : (r,) int64 rows with equal numbers share
    one robust weight, or None for none at all
    """

    residual: Floats
    jacobian: sparse.csr_matrix
    unit: Floats
    estimate: bool
    robust: Ints | None


class Solution(NamedTuple):
    """state; scale : noise scale of every group; inverse : entries of the covariance; weight : per group."""

    state: State
    scale: Floats
    inverse: sparse.csc_matrix
    weight: list[Floats]


def adjust(
    state: State, groups: Callable[[State], list[Group]], scale: Floats, rounds: int, floor: Floats
) -> Solution:
    """Alternate one Gauss-Newton step and one estimate of the noise scales.

    groups : the observations, linearised at a state; floor : (g,) smallest noise scale of every group
    Raises RuntimeError when the observations do not determine the unknowns.
    """
    scale = scale.copy()
    for k in range(rounds + 1):
        observed = groups(state)
        weight = [_weights(g, s) for g, s in zip(observed, scale, strict=True)]
        normal, right = _normal(observed, scale, weight)
        lu = factor(normal)
        step = -lu.solve(right)
        if not np.isfinite(step).all():
            raise RuntimeError("singular")
        state = state.moved(step)
        last = k == rounds
        if last or k % 2 == 1:
            inverse = inverse_on_pattern(lu)
            if not last:
                scale = _estimated(observed, scale, weight, step, inverse, floor)
    return Solution(state, scale, inverse, weight)


def _weights(group: Group, scale: float) -> Floats:
    if group.robust is None:
        return np.ones(len(group.residual))
    square = (group.residual / (group.unit * scale)) ** 2
    members = np.bincount(group.robust)
    mean = np.bincount(group.robust, square) / np.maximum(members, 1)
    weight: Floats = (1.0 / (1.0 + mean / _CAUCHY**2))[group.robust]
    return weight


def _normal(groups: list[Group], scale: Floats, weight: list[Floats]) -> tuple[sparse.csc_matrix, Floats]:
    jacobian = sparse.vstack([g.jacobian for g in groups]).tocsr()
    residual = np.concatenate([g.residual for g in groups])
    p = np.concatenate([w / (g.unit * s) ** 2 for g, s, w in zip(groups, scale, weight, strict=True)])
    weighted = sparse.diags(p) @ jacobian
    return (jacobian.T @ weighted).tocsc(), weighted.T @ residual


def _estimated(
    groups: list[Group],
    scale: Floats,
    weight: list[Floats],
    step: Floats,
    inverse: sparse.csc_matrix,
    floor: Floats,
) -> Floats:
    new = scale.copy()
    for k, (group, w) in enumerate(zip(groups, weight, strict=True)):
        if not group.estimate or len(group.residual) == 0:
            continue
        p = w / group.unit**2
        after = group.residual + group.jacobian @ step
        used = (group.jacobian @ inverse).multiply(group.jacobian).sum(axis=1)
        redundancy = w.sum() - float(p @ np.asarray(used).ravel()) / scale[k] ** 2
        if redundancy > 1.0:
            new[k] = max(np.sqrt(float(p @ after**2) / redundancy), floor[k])
    return new
