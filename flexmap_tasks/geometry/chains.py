"""Items that hang together end to end, as ordered chains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def chains(partner: Ints) -> tuple[Ints, Ints, Bools]:
    """Every item in exactly one chain.

    partner : (2 n,) int64; item i has the ends 2 i (its start) and 2 i + 1; partner[e] is the end that e is
    joined to, -1 where it is free. Joints are mutual: partner[partner[e]] == e.

    Returns (offset (c + 1,), item (n,), reversed (n,)). A chain begins at the free start of its lowest item,
    else at a free end, and a ring at its lowest item: the order of the items alone decides.
    """
    n = len(partner) // 2
    to = partner.tolist()
    seen = bytearray(n)
    order: list[int] = []
    offset = [0]
    free = np.flatnonzero(partner < 0)
    starts = [free[free % 2 == 0].tolist(), free[free % 2 == 1].tolist(), range(0, 2 * n, 2)]
    for start in (e for group in starts for e in group):
        if seen[start >> 1]:
            continue
        entry = start
        while entry >= 0 and not seen[entry >> 1]:
            seen[entry >> 1] = 1
            order.append(entry)
            entry = to[entry ^ 1]
        offset.append(len(order))
    entries = np.array(order, dtype=np.int64)
    return np.array(offset, dtype=np.int64), entries >> 1, (entries & 1).astype(bool)


def reciprocated(partner: Ints) -> Ints:
    """A copy of `partner` in which an end stays joined only where its partner has chosen it in turn."""
    out = partner.copy()
    joined = np.flatnonzero(partner >= 0)
    out[joined[partner[partner[joined]] != joined]] = -1
    return out
