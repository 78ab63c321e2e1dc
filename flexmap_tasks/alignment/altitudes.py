"""Which altitudes can be believed: none that were never measured, none of a stretch that stands off as a whole."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings, strings

NEVER_MEASURED = "altitude is 0 throughout: never measured"
ZERO = "altitude is 0 among others that are not: not measured"
NO_ALTITUDE = "no altitude"
STANDS_OFF = "a stretch of altitudes that stands off as a whole"

WINDOW = 16
"""Fixes on either side of a step in the altitudes: their medians see through scatter."""

LASTING, LASTING_ROUNDS = 3, 8
"""A step is still there over so many windows on either side; without the cuts that fail this, others may."""

STEP_SIGMAS = 6.0
"""A step is one when it exceeds what is usual between altitudes so far apart by this factor."""

LAGS = 12
"""Ways over which the usual is asked for, each twice the last."""

MAX_WINDOWS_M = 60.0
"""Over a longer way the road itself may climb: a step there is not asked whose it is."""

MIN_STEP_M = 0.5
"""Smaller steps are left to the robust weights."""

SEA_M = 2.0
"""Zeros among altitudes that reach this near to zero may be true."""


class Seen(NamedTuple):
    """Altitudes in the order of the drive.

    along_m : (m,) way; altitude_m, slam_m : (m,) of one and the same place by GNSS and by SLAM
    """

    along_m: Floats
    altitude_m: Floats
    slam_m: Floats

    @property
    def misfit_m(self) -> Floats:
        """(m,) how much higher GNSS has it."""
        return self.altitude_m - self.slam_m

    def take(self, rows: Ints | Bools) -> Seen:
        """The given rows."""
        return Seen(self.along_m[rows], self.altitude_m[rows], self.slam_m[rows])


def measured(altitude_m: Floats) -> Strings:
    """(n,) why an altitude says nothing, "" where it may: NaN, and the zeros of loggers that have none."""
    reason = strings(np.where(np.isfinite(altitude_m), "", NO_ALTITUDE))
    zero = altitude_m == 0.0
    if not zero.any():
        return reason
    others = altitude_m[np.isfinite(altitude_m) & ~zero]
    if len(others) == 0:
        reason[zero] = NEVER_MEASURED
    elif np.abs(others).min() > SEA_M:
        reason[zero] = ZERO
    return reason


def resolution_m(altitude_m: Floats) -> float:
    """What altitudes are rounded to: the smallest step between different ones, when hardly any are different."""
    values = np.unique(np.round(altitude_m, 4))
    if len(values) < 2 or len(values) > len(altitude_m) / 4:
        return 0.0
    return float(np.diff(values).min())


def offset_stretches(seen: Seen, trust: Floats) -> Ints:
    """(m,) number of the stretch that stands off as a whole which an altitude belongs to, from 0 on; -1 for none.

    trust : (m,) weight of every altitude. SLAM has no steps, so a step of their difference is one of the altitudes,
    unless SLAM itself jumps there: the steps, added up, are the levels of the stretches between them. Which of two
    levels is right only their lengths can tell.
    """
    n = len(seen.along_m)
    none = np.full(n, -1)
    if n < 4 * WINDOW:
        return none
    step = _steps(seen)
    limit = np.maximum(_limits(seen, step), max(MIN_STEP_M, 1.6 * resolution_m(seen.altitude_m)))
    cuts = _peaks(np.abs(step), limit)
    cuts, step = _lasting(seen, cuts[~_of_slam(seen, cuts)], limit, step)
    if len(cuts) == 0:
        return none
    part = np.searchsorted(cuts, np.arange(n), side="right")
    level = np.concatenate([[0.0], np.cumsum(step)])
    weight = np.bincount(part, trust * _ways(seen.along_m))
    # what steps between two stretches may be wrong by adds up, above all over gaps
    unsure = np.concatenate([[0.0], np.cumsum(limit[cuts] ** 2)])
    support = [float(weight[_near(level, unsure, k)].sum()) for k in range(len(level))]
    off = ~_near(level, unsure, int(np.argmax(support)))
    return np.where(off, np.cumsum(off) - 1, -1)[part]


def _near(level: Floats, unsure: Floats, k: int) -> Bools:
    """Levels that may be the k-th."""
    out: Bools = np.abs(level - level[k]) < np.sqrt(np.maximum(np.abs(unsure - unsure[k]), MIN_STEP_M**2))
    return out


def _steps(seen: Seen) -> Floats:
    """(m,) median of the fixes from each on, less that of those before it; 0 near the ends.

    Over a gap, less what the difference drifts by on either side of it.
    """
    centre, median = _medians(seen)
    step, inside = np.zeros(len(seen.along_m)), slice(WINDOW, len(seen.along_m) - WINDOW + 1)
    step[inside] = median[WINDOW:] - median[:-WINDOW]
    before, after = centre[:-WINDOW], centre[WINDOW:]
    way = after - before
    drift = median[:-WINDOW] - np.interp(before - way, centre, median)
    drift += np.interp(after + way, centre, median) - median[WINDOW:]
    step[inside] -= np.where(way > MAX_WINDOWS_M, drift / 2, 0.0)
    return step


def _medians(seen: Seen) -> tuple[Floats, Floats]:
    """Middle and median difference of every window."""
    return (
        sliding_window_view(seen.along_m, WINDOW).mean(axis=1),
        np.median(sliding_window_view(seen.misfit_m, WINDOW), axis=1),
    )


def _limits(seen: Seen, step: Floats) -> Floats:
    """(m,) what a step must exceed: what is usual for steps over a way as long, a gap in it or not."""
    centre, median = _medians(seen)
    apart = np.full(len(step), 1.0)
    apart[WINDOW : len(step) - WINDOW + 1] = np.maximum(centre[WINDOW:] - centre[:-WINDOW], 1e-3)
    lag, usual = WINDOW, list[tuple[float, float]]()
    while 3 * lag < len(median) and len(usual) < LAGS:
        way, change = float(np.median(centre[lag:] - centre[:-lag])), median[lag:] - median[:-lag]
        if way > MAX_WINDOWS_M:
            change = change[lag:-lag] - (change[: -2 * lag] + change[2 * lag :]) / 2
        usual.append((way, float(np.median(np.abs(change)))))
        lag *= 2
    at, size = np.array(usual).T
    limits: Floats = STEP_SIGMAS * 1.4826 * np.interp(apart, at, np.maximum.accumulate(size))
    return limits


def _peaks(size: Floats, limit: Floats) -> Ints:
    """Rows over the limit, of neighbours within a window the one that exceeds it most."""
    share = np.where(size > limit, size / limit, 0.0)
    cuts = []
    order = np.flatnonzero(share)
    for row in order[np.argsort(-share[order], kind="stable")].tolist():
        if share[row] > 0.0:
            cuts.append(row)
            share[max(row - WINDOW, 0) : row + WINDOW + 1] = 0.0
    return np.sort(np.array(cuts, dtype=np.int64))


def _lasting(seen: Seen, cuts: Ints, limit: Floats, over_gaps: Floats) -> tuple[Ints, Floats]:
    """The cuts at which altitudes step for longer than a window, and by how much: scatter does not last."""
    misfit_m, step = seen.misfit_m, np.zeros(len(cuts))
    gap = seen.along_m[cuts] - seen.along_m[cuts - 1] > MAX_WINDOWS_M
    for _ in range(LASTING_ROUNDS):
        ends = np.concatenate([[0], cuts, [len(misfit_m)]])
        for k, cut in enumerate(cuts.tolist()):
            before = misfit_m[max(ends[k], cut - LASTING * WINDOW) : cut]
            after = misfit_m[cut : min(ends[k + 2], cut + LASTING * WINDOW)]
            step[k] = np.median(after) - np.median(before)
        step = np.where(gap, over_gaps[cuts], step)
        lasts = np.abs(step) > limit[cuts]
        if lasts.all():
            break
        cuts, step, gap = cuts[lasts], step[lasts], gap[lasts]
    return cuts, step


def _of_slam(seen: Seen, cuts: Ints) -> Bools:
    """(k,) whether SLAM's own height steps more around a cut than the altitudes do."""
    reach, shift = np.arange(3), np.arange(-(WINDOW // 2), WINDOW // 2 + 1)
    at = cuts[:, None, None] + shift[:, None]
    sizes = []
    for z in (seen.altitude_m, seen.slam_m):
        before, after = np.median(z[at - 1 - reach], axis=2), np.median(z[at + reach], axis=2)
        sizes.append(np.abs(after - before).max(axis=1))
    without_gap = np.ptp(seen.along_m[cuts[:, None] + [-WINDOW, WINDOW]], axis=1) < MAX_WINDOWS_M
    out: Bools = (sizes[1] > sizes[0]) & without_gap
    return out


def _ways(along_m: Floats) -> Floats:
    """(m,) way that each altitude stands for; not more than a few metres, so that gaps count nothing."""
    way: Floats = np.minimum(np.gradient(along_m), 5.0) if len(along_m) > 1 else np.ones(len(along_m))
    return way
