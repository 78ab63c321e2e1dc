"""Least-squares adjustment with variance components: Gauss-Newton whose weights are estimated, not tuned.

An observation group has one unknown noise scale. It is found by maximum (restricted) likelihood: the sum of
squared residuals of a group must equal its redundancy (Helmert 1924, Foerstner 1979). Robust weights follow
Cauchy's kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Generic, NamedTuple, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.stats import chi2

from flexmap_tasks.geometry.normal_equations import Factor, factor, inverse_on_pattern

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

KERNEL = 2.385
"""Kernel width at which Cauchy keeps 95 % efficiency on Gaussian noise (Holland and Welsch 1977)."""


EXPECTED_WEIGHT = 4.0
"""What is expected of a noise scale counts as so many observations of it."""


class Unknowns(Protocol):
    """What is adjusted."""

    def moved(self, step: Floats) -> Self:
        """The unknowns after a correction of all of them."""
        ...


S = TypeVar("S", bound=Unknowns)


class Group(NamedTuple):
    """Observations with one common noise scale.

    residual : (r,) in units of `unit`; jacobian : (r, u); unit : (r,) assumed standard deviation of each row
    at scale 1; robust : (r,) int64 rows with equal numbers share one robust weight, or None for none at all
    scale_of : the group whose noise scale holds here; itself when the scale is to be found, -1 when it is 1
    """

    residual: Floats
    jacobian: sparse.csr_matrix
    unit: Floats
    robust: Ints | None
    scale_of: int


class Solution(NamedTuple, Generic[S]):
    """What an adjustment found.

    state : the unknowns; scale : (g,) noise scale of every group; weight : robust weights of every group
    groups : the observations before the last step; step : that last step
    normal, lu : the normal equations of that step, and their factor
    """

    state: S
    scale: Floats
    weight: list[Floats]
    groups: list[Group]
    step: Floats
    normal: sparse.csc_matrix
    lu: Factor

    @property
    def misfit(self) -> float:
        """Weighted sum of squares that the last step leaves (to first order)."""
        left = 0.0
        for group, scale, weight in zip(self.groups, self.scale, self.weight, strict=True):
            after = (group.residual + group.jacobian @ self.step) / (group.unit * scale)
            left += float(weight @ after**2)
        return left


def adjust(
    state: S,
    groups: Callable[[S], list[Group]],
    scale: Floats,
    floor: Floats,
    rounds: int,
    shared: int,
    expected: Floats | None = None,
    order: Ints | None = None,
) -> Solution[S]:
    """Gauss-Newton with the noise scales estimated `rounds` times on the way; a last step ends it.

    groups : the observations, linearised at a state; scale : (g,) where the noise scales start
    floor : (g,) the smallest value of every noise scale
    shared : how many unknowns at the end take part in very many observations
    expected : (g,) noise scales that are believed as much as `EXPECTED_WEIGHT` observations would be
    order : in which an adjustment of nearly the same observations eliminated the unknowns: finding it costs as much
    as a step
    Raises RuntimeError when the observations do not determine the unknowns.
    """
    for left in range(rounds, -1, -1):
        observed = groups(state)
        scale = np.array([scale[g.scale_of] if g.scale_of >= 0 else 1.0 for g in observed])
        weight = [_weights(g, s) for g, s in zip(observed, scale, strict=True)]
        normal, right = _normal(observed, scale, weight)
        lu = factor(normal, shared, order)
        order = lu.order
        step = -lu.solve(right)
        if not np.isfinite(step).all():
            raise RuntimeError("the observations do not determine the unknowns")
        state = state.moved(step)
        if left:
            inverse = _on_pattern_of(normal, inverse_on_pattern(lu))
            scale = _estimated(observed, scale, weight, step, inverse, shared, floor, expected)
    return Solution(state, scale, weight, observed, step, normal, lu)


def _weights(group: Group, scale: float) -> Floats:
    if group.robust is None:
        return np.ones(len(group.residual))
    square = (group.residual / (group.unit * scale)) ** 2
    members = np.bincount(group.robust)
    mean = np.bincount(group.robust, square) / np.maximum(members, 1)
    weight: Floats = (1.0 / (1.0 + mean / KERNEL**2))[group.robust]
    return weight


def _normal(groups: list[Group], scale: Floats, weight: list[Floats]) -> tuple[sparse.csc_matrix, Floats]:
    jacobian = sparse.vstack([g.jacobian for g in groups]).tocsr()
    residual = np.concatenate([g.residual for g in groups])
    p = np.concatenate([w / (g.unit * s) ** 2 for g, s, w in zip(groups, scale, weight, strict=True)])
    weighted = sparse.diags(p) @ jacobian
    return (jacobian.T @ weighted).tocsc(), weighted.T @ residual


def _on_pattern_of(normal: sparse.csc_matrix, inverse: sparse.csc_matrix) -> sparse.csr_matrix:
    """The inverse where the normal equations are not zero: the factor has many more entries."""
    pattern = normal.copy()
    pattern.data = np.ones_like(pattern.data)
    out: sparse.csr_matrix = inverse.multiply(pattern).tocsr()
    return out


def _variances(jacobian: sparse.csr_matrix, inverse: sparse.csr_matrix, shared: int) -> Floats:
    """Variance of every row's prediction, J Z J^T on the diagonal; shared unknowns apart, for they are dense."""
    cut = jacobian.shape[1] - shared
    own, common = jacobian[:, :cut], jacobian[:, cut:].toarray()
    mixed = inverse[:cut, cut:].toarray()
    alone = (own @ inverse[:cut, :cut]).multiply(own).sum(axis=1)
    together = 2.0 * ((own @ mixed) * common).sum(axis=1)
    both = ((common @ inverse[cut:, cut:].toarray()) * common).sum(axis=1)
    out: Floats = np.asarray(alone).ravel() + together + both
    return out


def _estimated(
    groups: list[Group],
    scale: Floats,
    weight: list[Floats],
    step: Floats,
    inverse: sparse.csr_matrix,
    shared: int,
    floor: Floats,
    expected: Floats | None,
) -> Floats:
    """The variance of every group: its squares over its redundancy, with what is expected (conjugate prior) where a
    drive says little of it.
    """
    squares, redundancy = np.zeros(len(groups)), np.zeros(len(groups))
    if expected is not None:
        squares[: len(expected)] = EXPECTED_WEIGHT * expected**2
        redundancy[: len(expected)] = EXPECTED_WEIGHT
    for group, w in zip(groups, weight, strict=True):
        k = group.scale_of
        if k < 0 or len(group.residual) == 0:
            continue
        p = w / group.unit**2
        after = group.residual + group.jacobian @ step
        squares[k] += float(p @ after**2)
        explained = float(p @ _variances(group.jacobian, inverse, shared)) / scale[k] ** 2
        free = w.sum() - explained
        # what the unknowns explain is too small for robust weights to tell: there they keep all of it
        redundancy[k] += free * (1.0 - (1.0 - _kept(group.robust)) * max(free, 0.0) / w.sum())
    new = scale.copy()
    told = redundancy > 1.0
    new[told] = np.sqrt(squares[told] / redundancy[told])
    new[: len(floor)] = np.maximum(new[: len(floor)], np.where(told[: len(floor)], floor, 0.0))
    return new


def _kept(robust: Ints | None) -> float:
    """Share of a normal variance that robust weights leave in the weighted mean of squares."""
    if robust is None:
        return 1.0
    return _kept_of(round(len(robust) / max(len(np.unique(robust)), 1)))


@cache
def _kept_of(members: int) -> float:
    def weight(square: float) -> float:
        return 1.0 / (1.0 + square / members / KERNEL**2)

    law = chi2(members)
    return float(law.expect(lambda s: weight(s) * s / members) / law.expect(weight))
