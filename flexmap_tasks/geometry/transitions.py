"""How well two places on a road graph follow each other, for many pairs at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Net:
    """A road graph as the kernel sees it.

    tail, head : (k,) int64, nodes of every link; length_m : (k,) float64
    near_offset : (nodes + 1,) int64, near_node : (m,) int64, near_m : (m,) float64: nodes within the limit of
    each node, itself included, and how far they are
    """

    tail: Ints
    head: Ints
    length_m: Floats
    near_offset: Ints
    near_node: Ints
    near_m: Floats


def pair_weights(
    state_offset: Ints, link: Ints, direction: Ints, s_m: Floats, edges: Ints, edge_m: Floats,
    scale_m: Floats, net: Net, cost_max: float, gap_cost: float,
) -> tuple[Ints, Floats]:  # fmt: skip
    """Weights exp(-cost) of all pairs of states along every edge: (offset (e + 1,), weights row by row).

    link, direction, s_m : (m,) per state: link (-1 no counterpart), +1 or -1 along it, metres along it
    edge_m : (e,) metres travelled between the two places; scale_m : (e,) metres of difference per unit of cost

    cost = |network distance - metres travelled| / scale, at most `cost_max`, which also stands for places that
    are not connected nearby; from a road to no counterpart or back: `gap_cost`.
    """
    size = np.diff(state_offset)
    table = size[edges[:, 0]] * size[edges[:, 1]]
    offset = np.concatenate([[0], np.cumsum(table)]).astype(np.int64)
    out = np.empty(offset[-1])
    _fill(
        state_offset, link, direction, s_m, np.ascontiguousarray(edges), edge_m, scale_m, net.tail, net.head,
        net.length_m, net.near_offset, net.near_node, net.near_m, cost_max, gap_cost, offset, out,
    )  # fmt: skip
    return offset, out


@njit(cache=True)
def _fill(  # type: ignore[no-untyped-def]  # pragma: no cover
    state,
    link,
    direction,
    s,
    edges,
    metres,
    scale,
    tail,
    head,
    length,
    near_at,
    near_node,
    near_m,
    most,
    gap,
    at,
    out,
):
    for e in range(len(edges)):
        k = at[e]
        for i in range(state[edges[e, 0]], state[edges[e, 0] + 1]):
            a = link[i]
            for j in range(state[edges[e, 1]], state[edges[e, 1] + 1]):
                b = link[j]
                if a < 0 or b < 0:
                    out[k] = 1.0 if a < 0 and b < 0 else np.exp(-gap)
                    k += 1
                    continue
                cost = most
                if a == b and direction[i] == direction[j]:
                    cost = min(cost, abs((s[j] - s[i]) * direction[i] - metres[e]) / scale[e])
                left = length[a] - s[i] if direction[i] > 0 else s[i]
                lead = s[j] if direction[j] > 0 else length[b] - s[j]
                if left + lead - metres[e] < most * scale[e]:
                    exit_node = head[a] if direction[i] > 0 else tail[a]
                    entry = tail[b] if direction[j] > 0 else head[b]
                    for q in range(near_at[exit_node], near_at[exit_node + 1]):
                        if near_node[q] == entry:
                            cost = min(cost, abs(left + near_m[q] + lead - metres[e]) / scale[e])
                            break
                out[k] = np.exp(-cost)
                k += 1
