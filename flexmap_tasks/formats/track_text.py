"""Tracks in text files: "lat lon" fixes, KITTI poses, TUM poses; and telling them from MCAP by content."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import date
from decimal import Decimal
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.mcap_records import MAGIC
from flexmap_tasks.formats.nmea import read_sentences
from flexmap_tasks.formats.track_rows import FIX_COLUMNS, POSE_COLUMNS, Rows, printable
from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.tracks import STATUS_UNKNOWN

ROTATION_TOLERANCE = 1e-2
"""A KITTI matrix may miss orthonormality by this much; files with four decimals do."""

NMEA_SNIFF_BYTES = 64 * 1024
MOST_DAMAGED = 0.05
"""Share of NMEA sentences with a wrong checksum up to which a log is believed."""
NMEA_FORM = 'a sentence is "$GNGGA,hhmmss.ss,ddmm.mmmm,N,dddmm.mmmm,E,quality,...*checksum"'

LATEST_S = 9_000_000_000
"""Times beyond the year 2255 do not fit into 64 bits of nanoseconds."""

_FOREIGN = (
    (b"#ROSBAG", "this is a ROS 1 bag: convert it to MCAP with `mcap convert`"),
    (b"\x28\xb5\x2f\xfd", "this file is packed with zstd: unpack it with `zstd -d`"),
    (b"\x1f\x8b", "this file is packed with gzip: unpack it with `gunzip`"),
    (b"SQLite format 3", "this is a ROS 2 bag in SQLite: convert it to MCAP with `ros2 bag convert`"),
)


@dataclass(frozen=True, slots=True)
class TextForm:
    """A text format: numbers per line, and what a good line looks like."""

    name: str
    columns: int
    form: str


LAT_LON = TextForm(
    "lat lon", 2, 'a line is "lat lon" in degrees, decimal points, such as "48.264367 11.669079"'
)
KITTI = TextForm(
    "KITTI",
    12,
    'a line is the 3x4 pose matrix row by row, 12 numbers, such as "1 0 0 3.06 0 1 0 -0.03 0 0 1 0.006"',
)
TUM = TextForm(
    "TUM", 8, 'a line is "stamp tx ty tz qx qy qz qw", such as "1700000000.25 3.06 -0.03 0.006 0 0 0 1"'
)


def is_mcap(name: str, path: Path) -> bool:
    """Whether the file starts like MCAP, or like the beginning of one that was cut off.

    Raises InputError for a file that is absent, empty, unreadable, or a recording of another kind.
    """
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except FileNotFoundError as error:
        raise InputError(name, "there is no such file") from error
    except IsADirectoryError as error:
        raise InputError(name, "this is a folder: name the file inside it") from error
    except (OSError, ValueError) as error:
        raise InputError(name, f"the file cannot be read ({error})") from error
    if not head:
        raise InputError(name, "the file is empty")
    for start, rule in _FOREIGN:
        if head.startswith(start):
            raise InputError(name, rule)
    return MAGIC.startswith(head[: len(MAGIC)])


def read_lat_lon(name: str, path: Path) -> Rows:
    """Columns FIX_COLUMNS from lines "lat lon" in degrees; altitude NaN, status unknown, no time."""
    lines = _Lines(name, path)
    table = lines.table(LAT_LON)
    values = np.zeros((len(table), len(FIX_COLUMNS)))
    values[:, 0:2] = table
    values[:, 2] = np.nan
    values[:, 7] = STATUS_UNKNOWN
    return Rows(values, None, lines.where, LAT_LON.form)


def read_poses_text(name: str, path: Path, form: TextForm | None) -> Rows:
    """Columns POSE_COLUMNS from KITTI or TUM lines; which of them the first line's width says when None."""
    lines = _Lines(name, path)
    form = form or lines.pose_form()
    table = lines.table(form)
    if form is TUM:
        return Rows(np.ascontiguousarray(table[:, 1:]), lines.stamps(table[:, 0]), lines.where, form.form)
    values = np.empty((len(table), len(POSE_COLUMNS)))
    matrix = table.reshape(-1, 3, 4)
    values[:, 0:3] = matrix[:, :, 3]
    values[:, 3:7] = _quaternions(lines, matrix[:, :, 0:3])
    return Rows(values, None, lines.where, form.form)


def is_nmea(path: Path) -> bool:
    """Whether the beginning of the file holds a GGA sentence."""
    with path.open("rb") as file:
        return re.search(rb"\$[A-Z]{2}GGA,", file.read(NMEA_SNIFF_BYTES)) is not None


def read_nmea(name: str, path: Path, first_day: date | None) -> Rows:
    """Columns FIX_COLUMNS from an NMEA log, with UTC times.

    Raises InputError where there is no GGA, where no date is known, and where many sentences are damaged.
    """
    try:
        text = path.read_bytes().decode("latin-1")
    except OSError as error:
        raise InputError(name, f"the file cannot be read ({error})") from error
    read = read_sentences(text.splitlines(), first_day)
    if not len(read):
        raise InputError(name, f"there is no GGA sentence with a right checksum; {NMEA_FORM}")
    if (
        read.damaged > MOST_DAMAGED * (len(read) + read.damaged) + 2
    ):  # a log often begins and ends amid a line
        rule = f"{read.damaged:,} sentences beside {len(read):,} good fixes are damaged (checksum); log again"
        raise InputError(name, rule)
    if read.day_ns is None:
        rule = "the log says no date (no RMC, no ZDA): give the UTC day of its first fix as gnss.nmea_date"
        raise InputError(name, rule)
    stamps = read.day_ns + read.tod_ns
    return Rows(read.values, stamps, lambda row: f"line {read.number[row] + 1}", NMEA_FORM)


class _Lines:
    """The lines of a text file that hold data: no blank lines, no comments behind #."""

    def __init__(self, name: str, path: Path) -> None:
        self.name = name
        try:
            text = path.read_bytes().decode("utf-8-sig")
        except OSError as error:
            raise InputError(name, f"the file cannot be read ({error})") from error
        except UnicodeDecodeError as error:
            rule = "the file is neither MCAP nor UTF-8 text: give an MCAP recording or a text file of numbers"
            raise InputError(name, rule, f"byte {error.start:,}") from error
        self._numbers: list[int] = []
        self._lines: list[str] = []
        for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), start=1):
            data = line.partition("#")[0].strip() if "#" in line else line.strip()
            if data:
                self._numbers.append(number)
                self._lines.append(data)
        if not self._lines:
            raise InputError(name, "the file holds no line with data")

    def where(self, row: int) -> str:
        """The line of a row."""
        return f"line {self._numbers[row]}"

    def pose_form(self) -> TextForm:
        """KITTI or TUM, by the number of columns."""
        width = len(self._lines[0].split())
        for form in (KITTI, TUM):
            if width == form.columns:
                return form
        rule = f"expected poses in 12 columns (KITTI) or 8 (TUM), got {_shown(self._lines[0])}"
        raise InputError(self.name, f"{rule}; {KITTI.form}; or {TUM.form}", self.where(0))

    def table(self, form: TextForm) -> Floats:
        """(n, columns) finite numbers. Raises InputError for the first line that is not such."""
        try:
            table: Floats = np.loadtxt(self._lines, dtype=np.float64, comments=None, ndmin=2)
        except ValueError:
            raise self._first_bad(form) from None
        if table.shape[1] != form.columns or not np.isfinite(table).all():
            raise self._first_bad(form)
        return table

    def stamps(self, seconds: Floats) -> Ints:
        """(n,) nanoseconds of the first column, exact to the last digit that is written."""
        bad = np.flatnonzero((seconds < 0) | (seconds > LATEST_S))
        if len(bad):
            rule = f"the time must be seconds since the epoch, got {seconds[bad[0]]:g}; {TUM.form}"
            raise InputError(self.name, rule, self.where(int(bad[0])))
        # A float64 of seconds since 1970 has steps of 238 ns, so the digits themselves are read.
        written = (Decimal(line.split(maxsplit=1)[0]) for line in self._lines)
        nanoseconds = (int((value * 1_000_000_000).to_integral_value()) for value in written)
        return np.fromiter(nanoseconds, dtype=np.int64, count=len(self._lines))

    def _first_bad(self, form: TextForm) -> InputError:
        for row, line in enumerate(self._lines):
            words = line.split()
            found = None
            if len(words) != form.columns:
                found = f"expected {form.columns} numbers, got {_shown(line)}"
            elif not all(map(_is_number, words)):
                found = f"expected numbers, got {_shown(line)}"
            elif not np.isfinite([float(word) for word in words]).all():
                found = f"the number must be finite, got {_shown(line)}"
            if found is not None:
                if row == 0 and any(word[0].isalpha() and not _is_number(word) for word in words):
                    found += " (a header line? remove it)"
                return InputError(self.name, f"{found}; {form.form}", self.where(row))
        return InputError(self.name, f"the lines are no table of numbers; {form.form}")


def _quaternions(lines: _Lines, matrix: Floats) -> Floats:
    """(n, 4) x y z w of (n, 3, 3) rotations, w >= 0."""
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(matrix @ matrix.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    good = error <= ROTATION_TOLERANCE
    if good.all():
        good = np.linalg.det(matrix) > 0
    if not good.all():
        row = int(np.argmin(good))
        found = (
            "mirrors" if error[row] <= ROTATION_TOLERANCE else f"misses orthonormality by {error[row]:.3g}"
        )
        rule = f"columns 1-3, 5-7 and 9-11 must be a rotation matrix, this one {found}; {KITTI.form}"
        raise InputError(lines.name, rule, lines.where(row))
    quaternion: Floats = Rotation.from_matrix(matrix).as_quat(canonical=True)
    return quaternion


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return word.isascii() and "_" not in word


def _shown(line: str) -> str:
    return f'"{printable(line, 60)}"'
