"""Heights: SLAM's own shape, held by the altitudes of the fixes."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from scipy import sparse

from flexmap_tasks.geometry.adjustment import Group, adjust
from flexmap_tasks.geometry.normal_equations import inverse_on_pattern
from flexmap_tasks.model.arrays import Floats, Ints

UNKNOWN_SIGMA_M = 0.06
"""Of an altitude that states none: twice the horizontal one."""

_STEP_M = 3.0
_START, _FLOOR = np.array([0.02, 1.0]), np.array([1e-4, 0.2])


class Lift(NamedTuple):
    """lift : (n,) what is added to the height of every node."""

    lift: Floats

    def moved(self, step: Floats) -> Self:
        """The lifts after a correction."""
        return self._replace(lift=self.lift + step)


def lifted(
    step_m: Floats, node: Ints, misfit_m: Floats, sigma_m: Floats, rounds: int = 5
) -> tuple[Floats, Floats]:
    """Lift and its standard deviation, (n,) each: a random walk along the way, seen at nodes through altitudes.

    step_m : (n - 1,) way between nodes
    node, misfit_m, sigma_m : (m,) which node, altitude minus SLAM height there, its stated deviation (NaN unknown)
    """
    n = len(step_m) + 1
    each, ones = np.arange(n - 1), np.ones(n - 1)
    ends = (np.tile(each, 2), np.concatenate([each, each + 1]))
    walk = sparse.csr_matrix((np.concatenate([-ones, ones]), ends), shape=(n - 1, n))
    seen = sparse.csr_matrix((np.ones(len(node)), (np.arange(len(node)), node)), shape=(len(node), n))
    unit = np.sqrt(np.maximum(step_m, 0.1) / _STEP_M)
    stated = np.where(np.isfinite(sigma_m) & (sigma_m > 0), np.maximum(sigma_m, 0.01), UNKNOWN_SIGMA_M)

    def groups(at: Lift) -> list[Group]:
        return [
            Group(walk @ at.lift, walk, unit, None, 0),
            Group(seen @ at.lift - misfit_m, seen, stated, np.arange(len(node)), 1),
        ]

    start = Lift(np.full(n, float(np.median(misfit_m))))
    solution = adjust(start, groups, _START, _FLOOR, rounds, 0)
    variance = inverse_on_pattern(solution.lu).diagonal()
    return solution.state.lift, np.sqrt(variance)
