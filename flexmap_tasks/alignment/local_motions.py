"""A drive laid on the GNSS line piece by piece: a rigid motion at stations along it, blended between them.

One motion for the whole drive would leave it by kilometres after fifty of them: SLAM drifts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flexmap_tasks.geometry.colinear import Seeds
from flexmap_tasks.model.arrays import Bools, Floats

STATION_M, REACH_M = 100.0, 250.0
"""A motion is fitted at every such way, over poses this far to either side."""

LEAST_WEIGHT = 10.0
"""A station around which fewer poses agree with the line says nothing of its own."""


class LocalMotions(NamedTuple):
    """at_m : (k,) arc length of the stations on the SLAM track; turn_rad : (k,) unwrapped

    source, target : (k,) complex; the motion of a station turns about `source` and carries it to `target`
    """

    at_m: Floats
    turn_rad: Floats
    source: np.ndarray
    target: np.ndarray

    def turn_at(self, along_m: Floats) -> Floats:
        """(n,) rotations at arc lengths."""
        out: Floats = np.interp(along_m, self.at_m, self.turn_rad)
        return out

    def apply(self, xy_m: Floats, along_m: Floats) -> Floats:
        """(n, 2) places of the SLAM track at arc lengths (n,), moved; the last motion holds beyond the ends."""
        xy, k = (
            xy_m @ (1, 1j),
            np.clip(np.searchsorted(self.at_m, along_m) - 1, 0, max(len(self.at_m) - 2, 0)),
        )
        after = np.minimum(k + 1, len(self.at_m) - 1)
        length = np.maximum(self.at_m[after] - self.at_m[k], 1e-9)
        share = np.clip((along_m - self.at_m[k]) / length, 0.0, 1.0)
        one, two = (
            self.target[s] + np.exp(1j * self.turn_rad[s]) * (xy - self.source[s]) for s in (k, after)
        )
        moved = (1 - share) * one + share * two
        return np.column_stack([moved.real, moved.imag])

    @classmethod
    def of(cls, chain: Seeds) -> LocalMotions:
        """Those of a chain of pieces."""
        return cls(chain.first_m, np.unwrap(chain.turn_rad), chain.source, chain.target)

    def refined(
        self, xy_m: Floats, along_m: Floats, target_m: Floats, seen: Bools, usual_m: float
    ) -> LocalMotions:
        """Fitted anew to the places of the line that belong to the poses: weighted by misfit, around every station.

        xy_m, target_m : (n, 2); along_m, seen : (n,); usual_m : misfit at which a pose counts half
        """
        a, b = xy_m @ (1, 1j), target_m @ (1, 1j)
        gap = np.hypot(*(target_m - self.apply(xy_m, along_m)).T)
        w = np.where(seen, 1.0 / (1.0 + (gap / usual_m) ** 2), 0.0)
        count = max(int((along_m[-1] - along_m[0]) / STATION_M), 1)
        at = np.linspace(along_m[0], along_m[-1], count + 1)
        low, high = np.searchsorted(along_m, at - REACH_M), np.searchsorted(along_m, at + REACH_M)
        # sums over windows as differences of running sums, about a common centre for the sake of their last bits
        a0, b0 = a.mean(), b.mean()
        running = np.concatenate(
            [
                [[0, 0, 0, 0]],
                np.cumsum(
                    np.column_stack([w, w * (a - a0), w * (b - b0), w * (a - a0).conj() * (b - b0)]), axis=0
                ),
            ]
        )
        weight, sum_a, sum_b, product = (running[high] - running[low]).T
        weight = weight.real
        kept = weight >= min(LEAST_WEIGHT, 0.1 * w.sum())
        weight, sum_a, sum_b, product = weight[kept], sum_a[kept], sum_b[kept], product[kept]
        turn = np.angle(product - sum_a.conj() * sum_b / weight)
        return LocalMotions(at[kept], np.unwrap(turn), a0 + sum_a / weight, b0 + sum_b / weight)
