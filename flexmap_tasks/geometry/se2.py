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


def along_arc(first: Floats, second: Floats, share: Floats) -> tuple[Floats, Floats]:
    """(n, 3) poses at shares of the way from `first` to `second`, both (n, 3), and (n, 2) their derivative by it.

    The way is that of constant speed and turn, the geodesic of SE(2) (Sola, Deray and Atchuthan 2018, eq. 153-158).
    """
    step = between(first, second)
    half = step[:, 2] / 2
    straight = half / np.tan(np.where(np.abs(half) < 1e-9, 1.0, half))
    straight[np.abs(half) < 1e-9] = 1.0
    twist = np.column_stack(
        [straight * step[:, 0] + half * step[:, 1], straight * step[:, 1] - half * step[:, 0]]
    )
    turn = share * step[:, 2]
    chord = share * np.sinc(turn / (2 * np.pi))
    xy = first[:, :2] + rotated(chord[:, None] * twist, first[:, 2] + turn / 2)
    return np.column_stack([xy, wrapped(first[:, 2] + turn)]), rotated(twist, first[:, 2] + turn)
