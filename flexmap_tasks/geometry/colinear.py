"""The longest run of places that two tracks pass in the same order, from short pieces that look alike.

The way long sequences are aligned: seeds are found by a search for similar pieces, then chained by dynamic
programming over the ones shortly before (as in Li 2018, minimap2, there for reads of a genome).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

LOOK_BACK, SKIP_M = 800, 3000.0
"""A seed may follow any of so many before it, no further back than this."""

PLACE_M, PLACE_SHARE = 5.0, 0.04
"""Where one seed expects the next: metres, and share of the way between them."""

ANGLE_RAD, ANGLE_WALK_RAD = 0.06, 0.004
"""How far their turns may differ: at once, and per root of metre."""

SKIP_COST, MISFIT_COST = 0.05, 10.0
"""What a metre that was seen costs without a seed, and a seed as far off as is usual; in distinctive metres."""


class Seeds(NamedTuple):
    """Pieces of one track that look like pieces of another, in the order of the first.

    first_m, second_m : (k,) arc length of their middles on both tracks
    unseen_m : (k,) how much of the second track before its middle nobody saw
    source, target : (k,) complex centres of both pieces; turn_rad : (k,) from the first to the second
    worth : (k,) 0 to 1, how distinctive; cover_m : (k,) way that a seed stands for
    """

    first_m: Floats
    second_m: Floats
    unseen_m: Floats
    source: NDArray[np.complex128]
    target: NDArray[np.complex128]
    turn_rad: Floats
    worth: Floats
    cover_m: Floats

    def take(self, rows: Ints | Bools) -> Seeds:
        """Some of them."""
        return Seeds(
            self.first_m[rows],
            self.second_m[rows],
            self.unseen_m[rows],
            self.source[rows],
            self.target[rows],
            self.turn_rad[rows],
            self.worth[rows],
            self.cover_m[rows],
        )


def best_chain(seeds: Seeds) -> tuple[float, Ints]:
    """The chain with the most distinctive way, in metres, and its rows; 0 and none without seeds."""
    if not len(seeds.first_m):
        return 0.0, np.empty(0, np.int64)
    score, before = _chained(*seeds)
    last = int(score.argmax())
    rows = []
    while last >= 0:
        rows.append(last)
        last = int(before[last])
    return float(score.max()), np.array(rows[::-1])


@njit(cache=True, nogil=True)
def _chained(first, second, unseen, source, target, turn, worth, cover):  # type: ignore[no-untyped-def]  # pragma: no cover
    n = len(first)
    score, before = np.empty(n), np.full(n, -1, np.int64)
    for p in range(n):
        best, which = worth[p] * cover[p], -1
        for q in range(p - 1, max(p - LOOK_BACK, 0) - 1, -1):
            ds, dg = first[p] - first[q], second[p] - second[q]
            if ds > SKIP_M:
                break
            if ds <= 0.0 or dg <= 0.0:
                continue
            slack = 2.0 * PLACE_M + PLACE_SHARE * ds
            if dg - ds > slack or (ds - dg > slack and unseen[p] - unseen[q] <= 0.0):
                continue
            skipped = max(dg - unseen[p] + unseen[q] - cover[p], 0.0)
            gained = score[q] + worth[p] * min(ds, cover[p]) - SKIP_COST * skipped
            if gained <= best:
                continue
            off = (turn[p] - turn[q] + np.pi) % (2.0 * np.pi) - np.pi
            if abs(off) > ANGLE_RAD + ANGLE_WALK_RAD * np.sqrt(ds):
                continue
            middle = turn[q] + off / 2.0
            reach = (source[p] - source[q]) * (np.cos(middle) + 1j * np.sin(middle))
            miss = abs(target[q] + reach - target[p]) / (PLACE_M + PLACE_SHARE * ds)
            if miss > 2.0:
                continue
            gained -= MISFIT_COST * miss * miss
            if gained > best:
                best, which = gained, q
        score[p], before[p] = best, which
    return score, before
