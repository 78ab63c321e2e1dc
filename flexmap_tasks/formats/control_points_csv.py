"""Control points from a CSV file.

One line per pair, after a header line. A side may be given in several ways at once; while they agree the first
counts, in the order below. Where one of three or more was changed it is the one that counts; two that
contradict each other are an error:

source (on the SLAM side)  `source_x_m, source_y_m`          in the SLAM frame, as recorded
                           `source_row`                      row of the SLAM trajectory, from 0
                           `source_map_x_m, source_map_y_m`  in the map frame, after the rigid start
                           `source_lat_deg, source_lon_deg`  the same as WGS84
target (on the GNSS side)  `target_lat_deg, target_lon_deg`  WGS84
                           `target_x_m, target_y_m`          in the map frame
                           `target_row`                      row of the GNSS recording, from 0

and beside them `name`, `sigma_m` (one standard deviation), `use` (yes or no) and `note` (not read). A line whose
name is that of an automatic point may leave out what it does not change, both sides included. The
columns of the original's own lists are understood under their names (`gnss_x`, `slam_raw_x`, ...).
Lines that begin with # and blank lines are skipped; the delimiter is a comma, semicolon or tab.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass

from flexmap_tasks.errors import AlignmentError, InputError
from flexmap_tasks.model.source import Source

WRITTEN = (
    "name", "source_x_m", "source_y_m", "target_lat_deg", "target_lon_deg", "sigma_m", "use", "note",
)  # fmt: skip
"""The columns that the editor writes."""

MAX_BYTES = 16 << 20
"""A list of control points larger than this is some other file."""

_ALIASES = {
    "idx": "name",
    "slam_raw_x": "source_x_m",
    "slam_raw_y": "source_y_m",
    "slam_row": "source_row",
    "slam_al_x": "source_map_x_m",
    "slam_al_y": "source_map_y_m",
    "gnss_lat": "target_lat_deg",
    "gnss_lon": "target_lon_deg",
    "gnss_x": "target_x_m",
    "gnss_y": "target_y_m",
    "gnss_row": "target_row",
}

_SOURCES = (
    ("source_x_m", "source_y_m"),
    ("source_row",),
    ("source_map_x_m", "source_map_y_m"),
    ("source_lat_deg", "source_lon_deg"),
)
_TARGETS = (("target_lat_deg", "target_lon_deg"), ("target_x_m", "target_y_m"), ("target_row",))
_NUMBERS = {column for group in (*_SOURCES, *_TARGETS) for column in group} | {"sigma_m"}
_UNREAD = {"note", "turn_deg", "icp_rms_m", "icp_obs"}
_USE = {"": True, "yes": True, "true": True, "1": True, "no": False, "false": False, "0": False}


@dataclass(frozen=True, slots=True)
class Place:
    """One side of a pair.

    kind : the column it was read from, without the last word: "source_x_m" or "target_lat_deg", ...
    values : one number for a row, x and y, or latitude and longitude
    """

    kind: str
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class ControlPointLine:
    """One pair as the file gives it: each side in every way it is given, if any; `sigma_m` is None without one."""

    line: int
    name: str
    source: tuple[Place, ...]
    target: tuple[Place, ...]
    sigma_m: float | None
    use: bool

    @property
    def where(self) -> str:
        """The line and the name, for messages."""
        return f'line {self.line} ("{self.name}")'


def read_control_points(source: Source) -> list[ControlPointLine]:
    """All pairs of a file, in its order; AlignmentError names the line and the rule."""
    rows = _rows(source)
    try:
        first, header = next(rows)
    except StopIteration:
        raise AlignmentError(
            source.name, "is empty; expected a header line and one line per control point"
        ) from None
    columns = _columns(source, first, header)
    return [_point(source, line, columns, cells) for line, cells in rows]


def _rows(source: Source) -> Iterator[tuple[int, list[str]]]:
    try:
        with source.path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise InputError(source.name, f"cannot be read: {error.strerror or error}") from error
    if len(raw) > MAX_BYTES:
        raise AlignmentError(
            source.name, f"is larger than {MAX_BYTES >> 20} MiB: not a list of control points"
        )
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise AlignmentError(source.name, "is not UTF-8 text; save the list as CSV in UTF-8") from None
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    lines = [(n, line) for n, line in lines if not line.lstrip().startswith("#")]
    if not lines:
        return
    delimiter = max(",;\t", key=lines[0][1].count)
    for n, line in lines:
        try:
            (cells,) = csv.reader([line], delimiter=delimiter, strict=True)
        except (csv.Error, ValueError):
            raise AlignmentError(source.name, "is not a CSV line; check its quotes", f"line {n}") from None
        yield n, [cell.strip() for cell in cells]


def _columns(source: Source, line: int, header: list[str]) -> list[str]:
    columns = [_ALIASES.get(name.lower(), name.lower()) for name in header]
    known = _NUMBERS | _UNREAD | {"name", "use"}
    for name in columns:
        if name not in known:
            raise AlignmentError(
                source.name,
                f'unknown column "{name}"; known are {", ".join(sorted(known))}',
                f"line {line}",
            )
    doubled = {name for name in columns if columns.count(name) > 1}
    if doubled:
        raise AlignmentError(source.name, f"column {min(doubled)} appears twice", f"line {line}")
    for side, groups in (("source", _SOURCES), ("target", _TARGETS)):
        by_name = "name" in columns and not any(name.startswith(f"{side}_") for name in columns)
        if not by_name and not any(set(group) <= set(columns) for group in groups):
            ways = ", or ".join(" and ".join(group) for group in groups)
            raise AlignmentError(
                source.name, f"no column says where the {side} is; add {ways}", f"line {line}"
            )
    return columns


def _point(source: Source, line: int, columns: list[str], cells: list[str]) -> ControlPointLine:
    if len(cells) != len(columns):
        raise AlignmentError(
            source.name,
            f"expected {len(columns)} values as in the header, found {len(cells)}",
            f"line {line}",
        )
    cell = dict(zip(columns, cells, strict=True))
    name = cell.get("name") or f"line {line}"
    where = f'line {line} ("{name}")'
    numbers = {key: _number(source, where, key, cell[key]) for key in _NUMBERS & set(cell) if cell[key]}
    use = _USE.get(cell.get("use", "").lower())
    if use is None:
        raise AlignmentError(source.name, f'use: expected yes or no, found "{cell["use"]}"', where)
    sigma = numbers.get("sigma_m")
    if sigma is not None and not sigma > 0:
        raise AlignmentError(source.name, f"sigma_m: expected a number over 0, found {sigma:g}", where)
    places = []
    for side, groups in (("source", _SOURCES), ("target", _TARGETS)):
        given = [g for g in groups if set(g) <= numbers.keys()]
        if not given and any(key.startswith(f"{side}_") for key in numbers):
            raise incomplete(source, where, side)
        places.append(tuple(Place(g[0], tuple(numbers[key] for key in g)) for g in given))
    return ControlPointLine(line, name, places[0], places[1], sigma, use)


def incomplete(source: Source, where: str, side: str) -> AlignmentError:
    """A line that does not say where one of its sides is."""
    return AlignmentError(source.name, f"gives no complete {side}; fill one of its columns", where)


def _number(source: Source, where: str, key: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise AlignmentError(source.name, f'{key}: expected a number, found "{text[:40]}"', where)
    if key.endswith("_row") and (value < 0 or value != int(value)):
        raise AlignmentError(source.name, f'{key}: expected a row counted from 0, found "{text[:40]}"', where)
    if (key.endswith("lat_deg") and abs(value) > 90) or (key.endswith("lon_deg") and abs(value) > 180):
        raise AlignmentError(source.name, f"{key}: {value:g} degrees do not exist", where)
    return value
