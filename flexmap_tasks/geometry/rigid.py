"""Best planar motion between two point sets (Umeyama 1991)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class PlanarFit(NamedTuple):
    """target = rotation @ source + translation, and what the fit says beside it.

    rotation : (2, 2) orthonormal, det +1; translation : (2,)
    scale : the scale a similarity would have, not part of the motion
    rmse : root mean square distance that is left, in the unit of the points
    """

    rotation: Floats
    translation: Floats
    scale: float
    rmse: float


def fit_planar_motion(source: Floats, target: Floats, weight: Floats | None = None) -> PlanarFit:
    """Least-squares motion from `source` onto `target`, both (n, 2); Umeyama 1991, eq. 34-43.

    Points on one line are enough: reflections are excluded by the sign in eq. 39.
    weight : (n,) non-negative; equal when None
    Raises ValueError when the source points fall into one.
    """
    share = np.full(len(source), 1.0 / len(source)) if weight is None else weight / weight.sum()
    mean_source, mean_target = share @ source, share @ target  # eq. 34, 35
    a, b = source - mean_source, target - mean_target
    spread = float(share @ (a**2).sum(axis=1))  # eq. 36
    if not spread > 0.0:
        raise ValueError("all points fall into one: no direction can be found")
    u, singular, vt = np.linalg.svd((share[:, None] * b).T @ a)  # eq. 38
    sign = np.array([1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt)) or 1.0])  # eq. 39, 43
    rotation = (u * sign) @ vt  # eq. 40
    scale = float((singular * sign).sum() / spread)  # eq. 42
    translation = mean_target - rotation @ mean_source  # eq. 41 with scale 1
    left = target - source @ rotation.T - translation
    return PlanarFit(rotation, translation, scale, float(np.sqrt(share @ (left**2).sum(axis=1))))
