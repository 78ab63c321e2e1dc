"""Orientations as unit quaternions x y z w."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def turned_about_z(quaternion: Floats, angle_rad: Floats) -> Floats:
    """(n, 4) orientations turned counter-clockwise about the frame's z axis by (n,) angles."""
    x, y, z, w = quaternion.T
    c, s = np.cos(angle_rad / 2), np.sin(angle_rad / 2)
    return np.column_stack([c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z])


def yaw_rad(quaternion: Floats) -> Floats:
    """(n,) heading of the body's x axis in the frame's plane, counter-clockwise from the frame's x axis."""
    x, y, z, w = quaternion.T
    yaw: Floats = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2))
    return yaw


def track_heading(xy_m: Floats) -> Floats:
    """(n,) direction of travel by the neighbours of every pose."""
    step = np.gradient(xy_m, axis=0)
    heading: Floats = np.arctan2(step[:, 1], step[:, 0])
    return heading
