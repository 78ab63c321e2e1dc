"""Review decisions from and to a CSV file, as report and editor write it.

Under a header line one line per decision. `kind` is value, match, lanes, fragment or change, `decision` is accept or
reject; see `ReviewDecisions` for what they mean. `s_from_m, s_to_m` (of a match), `value` (what holds instead of
`new`), `note`, `who` and `when` may be empty or left out.
"""

from __future__ import annotations

import csv
import io
import math
import re

import numpy as np

from flexmap_tasks.errors import InputError
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.review import Decided, ReviewDecisions
from flexmap_tasks.model.source import Source

MAX_BYTES = 64 << 20
LONGEST_CELL = 20_000
NEEDED = ("kind", "lanelet_id", "way_id", "key", "old", "new", "decision")
OPTIONAL = ("s_from_m", "s_to_m", "value", "note", "who", "when")
HEADER = (
    "kind", "lanelet_id", "way_id", "s_from_m", "s_to_m", "key", "old", "new", "decision", "value", "note", "who",
    "when",
)  # fmt: skip
DECISIONS = ("accept", "reject")
FORMULA = re.compile(r"'*[=+@\t\r-]")
"""What makes spreadsheets take text for a formula unless one more apostrophe stands before it."""
Row = dict[str, str]


def read_review_decisions(source: Source) -> ReviewDecisions:
    """All decisions of a file, in its order; InputError names the line and the rule."""
    return decisions_of(_rows(source))


def decisions_of(rows: list[Row]) -> ReviewDecisions:
    """Checked rows, by the names of the columns, as one table."""
    column = {name: strings(row.get(name, "") for row in rows) for name in HEADER}
    ids = {
        name: np.array([int(row[name]) for row in rows], dtype=np.int64) for name in ("lanelet_id", "way_id")
    }
    along = {
        name: np.array([float(row.get(name) or "nan") for row in rows], dtype=np.float64)
        for name in ("s_from_m", "s_to_m")
    }
    return ReviewDecisions(
        column["kind"], ids["lanelet_id"], ids["way_id"], along["s_from_m"], along["s_to_m"], column["key"],
        column["old"], column["new"], column["decision"], column["value"], column["note"], column["who"],
        column["when"],
    )  # fmt: skip


def review_decisions_csv(decisions: ReviewDecisions) -> bytes:
    """The file that `read_review_decisions` reads back."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADER)
    names = tuple("accept" if name == "decision" else name for name in HEADER)
    columns = [getattr(decisions, name).tolist() for name in names]
    writer.writerows([_cell(value) for value in row] for row in zip(*columns, strict=True))
    return text.getvalue().encode()


def checked(row: Row, name: str, where: str) -> Row:
    """The row, if it is a decision; InputError names what it is not. `name` is the file's, `where` the line."""
    if any(len(cell) > LONGEST_CELL for cell in row.values()):
        raise InputError(name, f"has a cell of over {LONGEST_CELL} characters", where)
    for column, words in (("decision", DECISIONS), ("kind", Decided.KINDS)):
        if row[column] not in words:
            expected = f"{', '.join(words[:-1])} or {words[-1]}"
            raise InputError(name, f"{column} is {row[column][:40]!r}; expected {expected}", where)
    for column in ("lanelet_id", "way_id"):
        if not _whole(row[column]):
            raise InputError(name, f"{column} is {row[column][:40]!r}; expected a whole number", where)
    if row["kind"] == "match":
        _check_match(row, name, where)
    if (
        row["kind"] == "lanes"
        and row.get("value")
        and not (row["value"].isascii() and row["value"].isdigit())
    ):
        raise InputError(name, f"value is {row['value'][:40]!r}; expected a number of lanes", where)
    return row


def _check_match(row: Row, name: str, where: str) -> None:
    for column in ("s_from_m", "s_to_m"):
        if not _metres(row.get(column, "")):
            text = row.get(column, "")[:40]
            raise InputError(name, f"{column} is {text!r}; a match needs metres along the lanelet", where)
    if row.get("value") and not _whole(row["value"]):
        raise InputError(name, f"value is {row['value'][:40]!r}; expected the id of a way", where)


def _whole(text: str) -> bool:
    digits = text.removeprefix("-")
    return digits.isascii() and digits.isdigit() and len(digits) <= 18


def _metres(text: str) -> bool:
    try:
        return len(text) < 40 and math.isfinite(float(text)) and float(text) >= 0
    except ValueError:
        return False


def _cell(value: object) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.3f}"
    text = str(value)
    return f"'{text}" if isinstance(value, str) and FORMULA.match(text) else text


def _plain(cell: str) -> str:
    return cell[1:] if cell.startswith("'") and FORMULA.match(cell) else cell


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
    return checked({name: _plain(cell) for name, cell in zip(header, cells, strict=True)}, source.name, where)


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
