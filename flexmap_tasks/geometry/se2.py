"""Planar poses: x, y, yaw."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def wrapped(angle: Floats) -> Floats:
    """Angles in -pi..pi."""
    out: Floats = (angle + np.pi) % (2 * np.pi) - np.pi
    return out


def rotated(xy: Floats, angle: Floats | float) -> Floats:
    """(n, 2) vectors turned counter-clockwise by (n,) angles."""
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([c * xy[:, 0] - s * xy[:, 1], s * xy[:, 0] + c * xy[:, 1]])


def between(first: Floats, second: Floats) -> Floats:
    """(n, 3) poses of `second` seen from `first`, both (n, 3)."""
    step = rotated(second[:, :2] - first[:, :2], -first[:, 2])
    return np.column_stack([step, wrapped(second[:, 2] - first[:, 2])])
