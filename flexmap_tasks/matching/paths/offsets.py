"""How roads are displaced against the lanelets from place to place, and how much scatter is left."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from flexmap_tasks.matching.paths.samples import Samples
from flexmap_tasks.matching.paths.states import States, best_states
from flexmap_tasks.model.arrays import Floats, Ints

CELL_M = 20.0
REACH_M = 18.0
"""Standard deviation of the kernel over which displacements are alike."""
PRIOR_M = 15.0
"""The displacement of the whole map is believed half when this length of road shows it."""
LOCAL_PRIOR_M, LOCAL_SCATTER_M = 20.0, 1.5
"""A local one when this length, weighed by the kernel, shows it and local ones scatter by this much over the map:
by the ridge that is right for displacements of that size."""
SIGMA_MIN_M, SIGMA_MAX_M = 1.0, 6.0
SURE = 0.6
USUAL_MIN_M = 1.0
ROBUST_ROUNDS = 8


def displacement(samples: Samples, states: States, probability: Floats) -> tuple[Floats, float]:
    """(n, 2) displacement at every sample, and the scatter left about it, metres.

    A straight road shows only how far it is displaced across, so that each place is a small least-squares
    problem over the roads around it, drawn towards the displacement of the whole map.
    """
    best = best_states(states, probability)
    sure = (states.link[best] >= 0) & (probability[best] > SURE) & ~samples.connector
    rows = np.flatnonzero(sure)
    shift = np.zeros((len(samples), 2))
    if not len(rows):
        return shift, SIGMA_MAX_M
    normal = np.stack([samples.heading[rows, 1], -samples.heading[rows, 0]], axis=1)
    seen = np.einsum("ij,ij->i", states.offset_m[best[rows]], normal)
    weight = probability[best[rows]] * samples.step_m[rows]
    everywhere = np.zeros(len(rows), dtype=np.int64)
    overall, trust = np.zeros(2), np.ones(len(rows))
    for _ in range(ROBUST_ROUNDS):
        overall = _solve(*_sums(normal, seen, weight * trust, everywhere, 1), PRIOR_M)[0]
        rest = seen - normal @ overall
        usual = max(1.4826 * _weighted_median(np.abs(rest), weight), USUAL_MIN_M)
        # A wrong road far away must not pull its surroundings over to it.
        trust = 4.0 / (3.0 + (rest / usual) ** 2)
    grid = np.floor((samples.point_m - samples.point_m.min(axis=0)) / CELL_M).astype(np.int64)
    cell, of = np.unique(grid, axis=0, return_inverse=True)
    of = of.ravel()
    sums = _sums(normal, rest, weight * trust, of[rows], len(cell))
    kernel = _kernel(np.asarray(cell * CELL_M, dtype=np.float64))
    prior = LOCAL_PRIOR_M * (LOCAL_SCATTER_M / usual) ** 2
    shift = overall + _solve(kernel @ sums[0], kernel @ sums[1], prior)[of]
    left = np.abs(seen - np.einsum("ij,ij->i", normal, shift[rows]))
    sigma = 1.4826 * _weighted_median(left, weight)
    return shift, float(np.clip(1.25 * sigma, SIGMA_MIN_M, SIGMA_MAX_M))


def _sums(normal: Floats, seen: Floats, weight: Floats, cell: Ints, n: int) -> tuple[Floats, Floats]:
    """Normal equations per cell: (n, 3) for the matrix xx, xy, yy and (n, 2) for the right-hand side."""
    x, y = normal.T
    matrix = [np.bincount(cell, weights=weight * c, minlength=n) for c in (x * x, x * y, y * y)]
    side = [np.bincount(cell, weights=weight * c * seen, minlength=n) for c in (x, y)]
    return np.stack(matrix, axis=1), np.stack(side, axis=1)


def _solve(matrix: Floats, side: Floats, prior: float) -> Floats:
    a, b, c = matrix[:, 0] + prior, matrix[:, 1], matrix[:, 2] + prior
    det = a * c - b * b
    x = (c * side[:, 0] - b * side[:, 1]) / det
    y = (a * side[:, 1] - b * side[:, 0]) / det
    return np.stack([x, y], axis=1)


def _kernel(centre_m: Floats) -> csr_array:
    """(n, n) weight of every cell for every other, 1 for itself."""
    tree = cKDTree(centre_m)
    pairs = tree.query_pairs(2.5 * REACH_M, output_type="ndarray")
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    distance2 = ((centre_m[pairs[:, 0]] - centre_m[pairs[:, 1]]) ** 2).sum(axis=1)
    value = np.exp(-distance2 / (2 * REACH_M**2))
    n = len(centre_m)
    every = np.arange(n)
    return coo_array(
        (
            np.concatenate([np.ones(n), value, value]),
            (
                np.concatenate([every, pairs[:, 0], pairs[:, 1]]),
                np.concatenate([every, pairs[:, 1], pairs[:, 0]]),
            ),
        ),
        shape=(n, n),
    ).tocsr()


def _weighted_median(value: Floats, weight: Floats) -> float:
    order = np.argsort(value, kind="stable")
    cumulated = np.cumsum(weight[order])
    return float(value[order][np.searchsorted(cumulated, cumulated[-1] / 2)])
