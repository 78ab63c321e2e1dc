"""When each point of a scan was seen: drivers write it in seconds, micro- or nanoseconds, absolute or not."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

UNITS_S = (1.0, 1e-3, 1e-6, 1e-9)
LONGEST_SWEEPS = 3.0
"""Times of one scan span at most this many intervals between scans."""
SHORTEST_SWEEPS = 1e-3
NEAR_S = 10.0
"""Absolute times lie this near to the header's."""
NS_PER_S = 1_000_000_000
LATEST_S = 4e9
"""Beyond any recording, and within 64 bits of nanoseconds twice over."""


class PointClock(NamedTuple):
    """What a number in the time field means.

    unit_s : seconds per step; absolute : counted from the epoch, not from the scan's stamp
    """

    unit_s: float
    absolute: bool

    def at_ns(self, values: NDArray[np.generic], stamp_ns: int) -> Ints:
        """(n,) nanoseconds since the epoch of the values of a scan; the scan's own where a value is not finite."""
        if values.dtype.kind in "iu" and self.unit_s == UNITS_S[-1]:
            whole: Ints = values.astype(np.int64)
            return whole if self.absolute else stamp_ns + whole
        per_step = np.rint(1.0 / self.unit_s)
        numbers = values.astype(np.float64)
        instead = stamp_ns / NS_PER_S * per_step if self.absolute else 0.0
        numbers = np.where(np.isfinite(numbers), numbers, instead).clip(
            -LATEST_S * per_step, LATEST_S * per_step
        )
        # whole seconds apart, since the 53 bits of a float do not hold nanoseconds since the epoch
        seconds = np.floor(numbers / per_step)
        rest: Ints = np.rint((numbers - seconds * per_step) * (NS_PER_S / per_step)).astype(np.int64)
        out: Ints = (0 if self.absolute else stamp_ns) + seconds.astype(np.int64) * NS_PER_S + rest
        return out


def point_clock(values: list[Floats], stamp_ns: list[int]) -> PointClock | None:
    """The meaning of a field of times, from the first scans; None where it makes none.

    values : times of the points of each scan, finite; stamp_ns : the scans' own times
    """
    spans = [float(np.ptp(v)) for v in values if len(v)]
    if not spans or max(spans) <= 0:
        return None
    gaps = np.diff(np.unique(np.array(stamp_ns, dtype=np.int64))) / NS_PER_S
    period_s = float(np.median(gaps)) if len(gaps) else 0.1
    span = float(np.median([s for s in spans if s > 0]))
    sweeps = {unit: span * unit / period_s for unit in UNITS_S}
    unit = min(sweeps, key=lambda u: abs(np.log(sweeps[u])))
    if not SHORTEST_SWEEPS < sweeps[unit] < LONGEST_SWEEPS:
        return None
    pairs = [
        (float(np.median(v)) * unit, s / NS_PER_S) for v, s in zip(values, stamp_ns, strict=True) if len(v)
    ]
    if all(abs(mid) <= LONGEST_SWEEPS * period_s for mid, _ in pairs):
        return PointClock(unit, absolute=False)
    if all(abs(mid - stamp) <= NEAR_S for mid, stamp in pairs):
        return PointClock(unit, absolute=True)
    return None
