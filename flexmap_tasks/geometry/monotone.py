"""Monotone association of two tracks by dynamic programming (Viterbi)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

POSITION_M, HEADING_RAD, UNSEEN_COST = 3.0, 0.3, 2.0
"""Where the robust costs of position and heading bend, and what a place costs that no fix vouches for."""

STEP_M, STEP_SHARE = 0.5, 0.05
"""How far the advance along both tracks may differ before it costs: metres, and share of the step."""


def associate(
    points: Floats,
    heading: Floats,
    line: Floats,
    line_heading: Floats,
    seen: Bools,
    first: Ints | None = None,
    width: int | None = None,
) -> Ints:
    """(n,) for every point the sample of the line it belongs to, never going back.

    points : (n, 2) metres, nearly in the line's frame; heading : (n,) radians, direction of travel
    line : (m, 2) samples spaced evenly along the way; line_heading : (m,); seen : (m,) False on chords over gaps
    first, width : for every point, the first of `width` samples it may belong to, never going back; all when None
    Costs are logarithmic in the squared misfit (Cauchy), so that no outlier decides the path.
    """
    step = np.concatenate([[0.0], np.hypot(*np.diff(points, axis=0).T)])
    spacing = float(np.median(np.hypot(*np.diff(line, axis=0).T)))
    reach = int(np.ceil(3.0 * float(np.quantile(step, 0.99)) / spacing)) + 4
    if first is None or width is None:
        first, width = np.zeros(len(points), np.int64), len(line)
    place: Ints = _associate(points, heading, step, line, line_heading, seen, spacing, reach, first, width)
    return place


@njit(cache=True, nogil=True)
def _associate(points, heading, step, line, line_heading, seen, spacing, reach, first, width):  # type: ignore[no-untyped-def]  # pragma: no cover
    n, m = len(points), len(line)
    back = np.zeros((n, width), np.int16)
    cost = np.full(width, np.inf)
    new = np.empty(width)
    advance = np.empty(reach + 1)
    for i in range(n):
        for a in range(reach + 1):
            off = (a * spacing - step[i]) / (STEP_M + STEP_SHARE * step[i])
            advance[a] = np.log1p(off * off)
        shift = first[i] - first[i - 1] if i > 0 else 0
        for k in range(width):
            j = first[i] + k
            best, which = np.inf, 0
            if i == 0:
                best = 0.0
            else:
                for a in range(max(0, k + shift - width + 1), min(reach, k + shift) + 1):
                    c = cost[k + shift - a] + advance[a]
                    if c < best:
                        best, which = c, a
            here = UNSEEN_COST
            if j >= m:
                here = np.inf
            elif seen[j]:
                dx, dy = points[i, 0] - line[j, 0], points[i, 1] - line[j, 1]
                turn = np.sin((heading[i] - line_heading[j]) / 2) * 2 / HEADING_RAD
                here = np.log1p((dx * dx + dy * dy) / (POSITION_M * POSITION_M)) + np.log1p(turn * turn)
            new[k] = best + here
            back[i, k] = which
        for k in range(width):
            cost[k] = new[k]
    out = np.empty(n, np.int64)
    out[n - 1] = first[n - 1] + np.argmin(cost)
    for i in range(n - 1, 0, -1):
        out[i - 1] = out[i] - back[i, out[i] - first[i]]
    return out
