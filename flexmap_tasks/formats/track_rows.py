"""What a reader of tracks hands on: numbers, times, and where each row stood in the file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flexmap_tasks.model.arrays import Floats, Ints, require

FIX_COLUMNS = (
    "lat_deg", "lon_deg", "alt_m", "var_east_m2", "var_north_m2", "var_up_m2", "covariance_type", "status",
)  # fmt: skip
"""Columns of a table of fixes; variances count only where covariance_type (sensor_msgs/NavSatFix) is not 0."""

POSE_COLUMNS = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
"""Columns of a table of poses."""


CLOCKS_APART_NS = 60_000_000_000
"""Stamps this far from the log time come from another clock; less is the delay of logging."""


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Rows as they were recorded, in the order of the file; no rule about their meaning was applied yet.

    values : (n, k) float64, FIX_COLUMNS or POSE_COLUMNS
    stamp_ns : (n,) int64 since the epoch, or None when the rows carry no time of their own
    where : place of a row in the words of the user ("line 12", "topic /fix message 3")
    form : what a good row looks like, for the end of an error message
    """

    values: Floats
    stamp_ns: Ints | None
    where: Callable[[int], str]
    form: str

    def __len__(self) -> int:
        return len(self.values)

    def __post_init__(self) -> None:
        require(self.values.ndim == 2, "rows are a table")
        require(self.stamp_ns is None or len(self.stamp_ns) == len(self.values), "stamps differ in length")


def fill_stamps(stamp_ns: Ints, log_time_ns: Ints) -> Ints:
    """Stamps of the headers; where one is not set, the time the message was logged."""
    given = stamp_ns > 0
    lags = np.sort(log_time_ns[given] - stamp_ns[given])
    lag = lags[len(lags) // 2] if len(lags) else np.int64(0)
    # A node on simulated time stamps 0 until it hears the clock: its log time is put onto that clock.
    shift = lag if abs(lag) > CLOCKS_APART_NS else np.int64(0)
    return np.where(given, stamp_ns, log_time_ns - shift)


def printable(text: str, limit: int = 100) -> str:
    """Text of a file as it may stand in a message: one line, no control characters, not too long."""
    short = text if len(text) <= limit else f"{text[: limit - 3]}..."
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in short)
