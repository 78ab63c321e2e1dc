"""Belief propagation on a graph of places with a few states each (sum-product, Pearl 1988)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FLOOR = 1e-9
"""No message rules a state out for good: on a graph with rings it could come back."""


def beliefs(
    state_offset: Ints, unary: Floats, edges: Ints, pair_offset: Ints, pair: Floats, sweeps: int
) -> Floats:
    """(m,) probability of every state, summing to 1 per place.

    state_offset : (n + 1,) int64, place i owns the states state_offset[i]:state_offset[i + 1]
    unary : (m,) float64 > 0, how well each state fits on its own, at any scale
    edges : (e, 2) int64, places that depend on each other; pair_offset : (e + 1,) int64
    pair : float64 > 0, per edge a table of first place's states times second place's, row by row

    A sweep goes through the edges forwards, then backwards, so that on a chain of edges in order, one is
    exact; rings take a few. The order of the edges is the only thing besides the values that counts.
    """
    first, second = np.ascontiguousarray(edges[:, 0]), np.ascontiguousarray(edges[:, 1])
    size = np.diff(state_offset)
    to_second = np.concatenate([[0], np.cumsum(size[second])]).astype(np.int64)
    to_first = np.concatenate([[0], np.cumsum(size[first])]).astype(np.int64)
    belief = unary.copy()
    _propagate(
        state_offset, belief, first, second, pair_offset, pair, to_second, np.ones(to_second[-1]),
        to_first, np.ones(to_first[-1]), sweeps,
    )  # fmt: skip
    total = np.add.reduceat(belief, state_offset[:-1]) if len(belief) else belief
    probability: Floats = belief / np.repeat(total, size)
    return probability


@njit(cache=True)
def _send(belief, a, na, b, nb, pair, at, by_row, old, old_at, back, back_at, work):  # type: ignore[no-untyped-def]  # pragma: no cover
    top = 0.0
    for j in range(nb):
        total = 0.0
        for i in range(na):
            weight = pair[at + i * nb + j] if by_row else pair[at + j * na + i]
            total += belief[a + i] / back[back_at + i] * weight
        work[j] = total
        top = max(top, total)
    highest = 0.0
    for j in range(nb):
        message = max(work[j] / top, FLOOR)
        belief[b + j] *= message / old[old_at + j]
        old[old_at + j] = message
        highest = max(highest, belief[b + j])
    for j in range(nb):
        belief[b + j] = max(belief[b + j] / highest, 1e-200)


@njit(cache=True)
def _propagate(offset, belief, first, second, pair_at, pair, to_second, down, to_first, up, sweeps):  # type: ignore[no-untyped-def]  # pragma: no cover
    most = 0
    for i in range(len(offset) - 1):
        most = max(most, offset[i + 1] - offset[i])
    work = np.empty(most)
    n = len(first)
    for _ in range(sweeps):
        for e in range(n):
            a, b = offset[first[e]], offset[second[e]]
            na, nb = offset[first[e] + 1] - a, offset[second[e] + 1] - b
            _send(belief, a, na, b, nb, pair, pair_at[e], True, down, to_second[e], up, to_first[e], work)
        for k in range(n):
            e = n - 1 - k
            a, b = offset[first[e]], offset[second[e]]
            na, nb = offset[first[e] + 1] - a, offset[second[e] + 1] - b
            _send(belief, b, nb, a, na, pair, pair_at[e], False, up, to_first[e], down, to_second[e], work)
