"""NMEA 0183 sentences as a GNSS receiver writes them: GGA with its fix quality, GST, and the date from RMC or ZDA.

GGA's quality is what tells a fixed RTK solution from a float one, which sensor_msgs/NavSatFix cannot.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, date, datetime
from typing import NamedTuple

import numpy as np

from flexmap_tasks.formats.track_rows import FIX_COLUMNS
from flexmap_tasks.model.arrays import Floats, Ints

NS_PER_S = 1_000_000_000
DAY_NS = 86_400 * NS_PER_S

SENTENCE = re.compile(r"\$([A-Z]{2})(GGA|RMC|ZDA|GST),([^*$]*)\*([0-9A-Fa-f]{2})")
"""Talker, type, fields and checksum of a sentence that says something here; a logger may write before it."""

STATUS_OF_QUALITY = {0: -1, 1: 0, 2: 1, 3: 0, 4: 2, 5: 1, 6: -1, 7: -1, 8: 0}
"""sensor_msgs/NavSatStatus by GGA quality; dead reckoning (6) and manual input (7) are no measurements."""

TYPICAL_SIGMA_M = {1: 2.5, 2: 1.0, 3: 2.5, 4: 0.015, 5: 0.4}
"""One standard deviation per horizontal axis at HDOP 1, where the receiver does not state its own in GST."""

UP_PER_HORIZONTAL = 2.0
APPROXIMATED, DIAGONAL_KNOWN = 1, 2
"""sensor_msgs/NavSatFix: covariance types."""


class _Fix(NamedTuple):
    """One GGA. tod_ns : time of day; number : of its line; row : FIX_COLUMNS and the geoid's height."""

    tod_ns: int
    number: int
    row: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Sentences:
    """What a stream of sentences says.

    values : (n, k) FIX_COLUMNS; heights over the ellipsoid where the sentences give the geoid's, else as they are
    tod_ns : (n,) time of day, UTC; number : (n,) which line it was
    day_ns : (n,) midnight before each fix since the epoch; None where no date is known
    damaged : sentences with a wrong checksum or fields that do not read
    """

    values: Floats
    tod_ns: Ints
    number: Ints
    day_ns: Ints | None
    damaged: int

    def __len__(self) -> int:
        return len(self.values)


def read_sentences(lines: Iterable[str], first_day: date | None = None) -> Sentences:
    """All fixes of the lines; `first_day` is the day (UTC) of the first one where no sentence says it."""
    fixes: list[_Fix] = []
    sigmas: dict[int, tuple[float, float, float]] = {}
    dated: list[tuple[int, int, date]] = []
    damaged = 0
    for number, line in enumerate(lines):
        found = SENTENCE.search(line)
        if found is None:
            damaged += "GGA," in line
            continue
        kind, fields = found[2], found[3].split(",")
        try:
            if _checksum(found[0][1:-3]) != int(found[4], 16):
                raise ValueError("checksum")
            if kind == "GGA":
                fixes.append(_gga(fields, number))
            elif kind == "GST":
                sigmas[len(fixes)] = _gst(fields)
            else:
                day = _rmc_day(fields) if kind == "RMC" else _zda_day(fields)
                if day is not None:
                    dated.append((len(fixes), _tod_ns(fields[0]), day))
        except (ValueError, IndexError, OverflowError):
            damaged += 1
    values = _values(fixes, sigmas)
    tod = np.array([f.tod_ns for f in fixes], dtype=np.int64)
    number_of = np.array([f.number for f in fixes], dtype=np.int64)
    return Sentences(values, tod, number_of, _days(tod, dated, first_day), damaged)


def _checksum(text: str) -> int:
    out = 0
    for byte in text.encode("latin-1", errors="replace"):
        out ^= byte
    return out


def _gga(f: list[str], number: int) -> _Fix:
    """time, lat, N/S, lon, E/W, quality, satellites, HDOP, height over the sea, M, geoid over the ellipsoid, M."""
    quality = int(f[5] or 0)
    status = STATUS_OF_QUALITY.get(quality, -1)
    if status < 0:
        lat = lon = float("nan")
    else:
        lat, lon = _degrees(f[1], f[2], 2, "NS"), _degrees(f[3], f[4], 3, "EW")
    hdop = max(float(f[7] or 1.0), 0.5)
    height, geoid = float(f[8] or "nan"), float(f[10] or "nan")
    sigma = TYPICAL_SIGMA_M.get(quality, 0.0) * hdop
    known = float(APPROXIMATED if sigma else 0)
    up = UP_PER_HORIZONTAL * sigma
    return _Fix(
        _tod_ns(f[0]), number, (lat, lon, height, sigma**2, sigma**2, up**2, known, float(status), geoid)
    )


def _gst(f: list[str]) -> tuple[float, float, float]:
    """Standard deviations east, north, up: time, rms, major, minor, orientation, latitude, longitude, height."""
    return float(f[6]), float(f[5]), float(f[7])


def _tod_ns(text: str) -> int:
    """Time of day of hhmmss.sss in nanoseconds."""
    whole, _, part = text.partition(".")
    if len(whole) != 6 or not whole.isdecimal() or (part and not part.isdecimal()):
        raise ValueError("time")
    hours, minutes, seconds = int(whole[:2]), int(whole[2:4]), int(whole[4:])
    if hours > 23 or minutes > 59 or seconds > 60:
        raise ValueError("time")
    return (hours * 3600 + minutes * 60 + seconds) * NS_PER_S + int(part.ljust(9, "0")[:9] or 0)


def _degrees(text: str, side: str, digits: int, sides: str) -> float:
    """Degrees of ddmm.mmm or dddmm.mmm."""
    if side not in tuple(sides) or not text.replace(".", "", 1).isdecimal():
        raise ValueError("coordinate")
    minutes = float(text[digits:])
    if minutes >= 60.0:
        raise ValueError("coordinate")
    degrees = int(text[:digits]) + minutes / 60.0
    return degrees if side == sides[0] else -degrees


def _rmc_day(f: list[str]) -> date | None:
    if len(f[8]) != 6 or f[1] != "A":
        return None
    return date(2000 + int(f[8][4:]), int(f[8][2:4]), int(f[8][:2]))


def _zda_day(f: list[str]) -> date | None:
    return date(int(f[3]), int(f[2]), int(f[1])) if f[3] else None


def _values(fixes: list[_Fix], sigmas: dict[int, tuple[float, float, float]]) -> Floats:
    """(n, FIX_COLUMNS): with the receiver's own deviations where a GST stands beside the fix."""
    table = np.array([f.row for f in fixes], dtype=np.float64).reshape(-1, len(FIX_COLUMNS) + 1)
    values, geoid = table[:, :-1], table[:, -1]
    if np.isfinite(geoid).any():
        values[:, 2] += geoid  # NaN where this sentence lacks it: two kinds of height must not be mixed
    for row, sigma in _beside(sigmas, len(fixes)):
        if all(0 < s < 1e4 for s in sigma) and values[row, 7] >= 0:
            values[row, 3:6], values[row, 6] = np.square(sigma), DIAGONAL_KNOWN
    return values


def _beside(
    sigmas: dict[int, tuple[float, float, float]], count: int
) -> Iterator[tuple[int, tuple[float, float, float]]]:
    """The fix that each GST belongs to: it follows its GGA, or precedes it in every epoch of the log."""
    follows = 0 not in sigmas  # the first sentence of the log decides
    for place, sigma in sigmas.items():
        row = place - 1 if follows else place
        if 0 <= row < count:
            yield row, sigma


def _days(tod_ns: Ints, dated: list[tuple[int, int, date]], first_day: date | None) -> Ints | None:
    """(n,) midnight before each fix, nanoseconds since the epoch."""
    if not len(tod_ns):
        return np.empty(0, np.int64)
    if dated:
        place = np.array([d[0] for d in dated])
        tod = np.array([d[1] for d in dated], dtype=np.int64)
        midnight = np.array([_midnight_ns(d[2]) for d in dated], dtype=np.int64)
        near = np.searchsorted(place, np.arange(len(tod_ns)), side="right").clip(1, len(place)) - 1
        apart = tod_ns - tod[near]  # a fix before midnight and a date after it, or the other way round
        over: Ints = (apart < -DAY_NS // 2).astype(np.int64) - (apart > DAY_NS // 2)
        days: Ints = midnight[near] + DAY_NS * over
        return days
    if first_day is None:
        return None
    return _midnight_ns(first_day) + DAY_NS * turns(tod_ns)


def turns(tod_ns: Ints) -> Ints:
    """(n,) midnights passed since the first of the times of day."""
    step = np.diff(tod_ns, prepend=tod_ns[:1])
    return np.cumsum((step < -DAY_NS // 2).astype(np.int64) - (step > DAY_NS // 2))


def _midnight_ns(day: date) -> int:
    return int(datetime(day.year, day.month, day.day, tzinfo=UTC).timestamp()) * NS_PER_S
