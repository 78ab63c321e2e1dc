"""Buffers around segments: 12-gons that reach past both ends, with cut corners (Zhang and Meng 2005)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class BufferShape:
    """A 12-gon around a segment.

    half_width_m : reach to either side; overshoot_m : reach past either end
    corner : share of width and overshoot that the corners lose, in two steps: seen from the segment's end
    the outline runs (0, w), (p (1 - c / 2), w (1 - c / 2)), (p, w (1 - c)) and the same mirrored
    """

    half_width_m: float
    overshoot_m: float
    corner: float

    @property
    def reach_m(self) -> float:
        """No point of the buffer is further than this from its segment."""
        return float(np.hypot(self.half_width_m, self.overshoot_m))

    def enlarged(self, factor: float) -> BufferShape:
        """The same shape, wider and longer."""
        return BufferShape(self.half_width_m * factor, self.overshoot_m * factor, self.corner)


def inside(point_m: Floats, a_m: Floats, b_m: Floats, shape: BufferShape) -> Bools:
    """(n,) whether point i lies in the buffer of segment i, its outline included; no segment is a point."""
    run = b_m - a_m
    length = np.hypot(*run.T)
    to = point_m - a_m
    along = np.einsum("ij,ij->i", to, run) / length
    aside = np.abs(run[:, 0] * to[:, 1] - run[:, 1] * to[:, 0]) / length
    past = np.maximum(np.maximum(-along, along - length), 0.0)
    half = 1.0 - shape.corner / 2.0
    outline_past = np.array([0.0, half, 1.0]) * max(shape.overshoot_m, 1e-9)
    outline_width = np.array([1.0, half, 1.0 - shape.corner]) * shape.half_width_m
    width = np.interp(past, outline_past, outline_width)
    within: Bools = (past <= shape.overshoot_m) & (aside <= width)
    return within
