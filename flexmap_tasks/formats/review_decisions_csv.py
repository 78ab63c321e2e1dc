"""Review decisions from a CSV file, as the report writes it.

Under a header line with `lanelet_id, way_id, key, old, new, decision, value, note` one line per decision, which is
`accept` or `reject`; `value` (what to write instead of `new`) and `note` may be empty or left out.
"""

from __future__ import annotations

import csv
import io

import numpy as np

from flexmap_tasks.errors import InputError
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.review import ReviewDecisions
from flexmap_tasks.model.source import Source

MAX_BYTES = 64 << 20
LONGEST_CELL = 20_000
NEEDED = ("lanelet_id", "way_id", "key", "old", "new", "decision")
OPTIONAL = ("value", "note")
DECISIONS = ("accept", "reject")
Row = dict[str, str]


def read_review_decisions(source: Source) -> ReviewDecisions:
    """All decisions of a file, in its order; InputError names the line and the rule."""
    rows = _rows(source)
    column = {name: strings(row.get(name, "") for row in rows) for name in (*NEEDED, *OPTIONAL)}
    numbers = {
        name: np.array([int(row[name]) for row in rows], dtype=np.int64) for name in ("lanelet_id", "way_id")
    }
    return ReviewDecisions(
        numbers["lanelet_id"],
        numbers["way_id"],
        column["key"],
        column["old"],
        column["new"],
        column["decision"],
        column["value"],
        column["note"],
    )


def _rows(source: Source) -> list[Row]:
    reader = csv.reader(io.StringIO(_text(source), newline=""), strict=True)
    try:
        header = [name.strip().lower() for name in next(reader, [])]
        missing = [name for name in NEEDED if name not in header]
        if missing or len(set(header)) != len(header):
            rule = f"needs a header line with each of {', '.join(NEEDED)} once"
            raise InputError(source.name, rule, "line 1")
        return [_row(source, header, cells, reader.line_num) for cells in reader if cells]
    except csv.Error as error:
        raise InputError(source.name, f"is not CSV ({error})", f"line {reader.line_num}") from None


def _row(source: Source, header: list[str], cells: list[str], line: int) -> Row:
    where = f"line {line}"
    if len(cells) != len(header):
        raise InputError(source.name, f"expected {len(header)} cells, found {len(cells)}", where)
    row = {name: _plain(cell) for name, cell in zip(header, cells, strict=True)}
    if any(len(cell) > LONGEST_CELL for cell in cells):
        raise InputError(source.name, f"has a cell of over {LONGEST_CELL} characters", where)
    if row["decision"] not in DECISIONS:
        raise InputError(
            source.name, f"decision is {row['decision'][:40]!r}; expected accept or reject", where
        )
    for name in ("lanelet_id", "way_id"):
        digits = row[name].removeprefix("-")
        if not (digits.isascii() and digits.isdigit() and len(digits) <= 18):
            raise InputError(source.name, f"{name} is {row[name][:40]!r}; expected a whole number", where)
    return row


def _plain(cell: str) -> str:
    """Without the apostrophe that keeps spreadsheets from taking text for a formula."""
    return cell[1:] if len(cell) > 1 and cell[0] == "'" and cell[1] in "=+@-\t\r" else cell


def _text(source: Source) -> str:
    try:
        with source.path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise InputError(source.name, f"cannot be read: {error.strerror or error}") from error
    if len(raw) > MAX_BYTES:
        raise InputError(source.name, f"is larger than {MAX_BYTES >> 20} MiB: no list of decisions")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(source.name, "is not UTF-8 text; save it as CSV in UTF-8") from None
