"""Where a track of fixes is interrupted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import percentile_filter

from flexmap_tasks.geometry.polyline import steps_m

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

JUMP_M = 3.0
"""A step up to this length is never a jump: a car at 30 m/s covers it between two fixes at 10 Hz."""

JUMP_FACTOR = 4.0
"""A jump is longer than this many times the steps around it."""

SHORT_RUN_M = 15.0
"""What lies between two interruptions and gets no further than this is scatter around them, however long the way
that it jitters."""

GAP_FACTOR, GAP_S = 5.0, 1.5
"""An outage lasts longer than this many usual intervals, and longer than this."""

_WINDOW = 51
"""Fixes around a step that show how fast the car goes there."""


def observed_steps(xy_m: Floats, stamp_s: Floats | None) -> Bools:
    """(n,) whether the straight step to every fix was driven as drawn; the first fix counts as observed.

    xy_m : (n, 2), metres
    stamp_s : (n,) seconds, or None when the fixes have no time and are taken as evenly spaced
    """
    n = len(xy_m)
    if n < 2:
        return np.ones(n, bool)
    step = steps_m(xy_m)
    if stamp_s is None:
        lapse, gap = np.ones(n - 1), np.zeros(n - 1, bool)
    else:
        lapse = np.maximum(np.diff(stamp_s), 1e-3)
        gap = lapse > max(GAP_S, GAP_FACTOR * float(np.median(lapse)))
    speed = step / lapse
    local = percentile_filter(speed, 80, size=min(_WINDOW, n - 1), mode="nearest")
    broken = gap | (step > np.maximum(JUMP_M, JUMP_FACTOR * local * lapse))
    return np.concatenate([[True], ~_with_short_runs(xy_m, broken)])


def _with_short_runs(xy_m: Floats, broken: Bools) -> Bools:
    """Breaks, and the short runs between two of them."""
    first = np.concatenate([[0], np.flatnonzero(broken) + 1])
    extent = np.hypot(*(np.maximum.reduceat(xy_m, first) - np.minimum.reduceat(xy_m, first)).T)
    run = np.cumsum(broken)
    between = (run > 0) & (run < run[-1])
    out: Bools = broken | (between & (extent[run] < SHORT_RUN_M))
    return out
