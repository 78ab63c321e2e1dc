"""Small tables of plain values as Parquet or CSV."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq


def write_table(rows: Sequence[Mapping[str, Any]], file: Path) -> None:
    """One line per row. A column whose values are of several kinds, or no plain values, is written as JSON."""
    columns = {name: [row.get(name) for row in rows] for name in (rows[0] if rows else ())}
    table = pa.table({name: _array(values) for name, values in columns.items()})
    if file.suffix == ".csv":
        pa_csv.write_csv(table, file)
    else:
        pq.write_table(table, file)


def first_row(file: Path) -> dict[str, Any] | None:
    """The first line of a Parquet table; None when it has none."""
    table = pq.read_table(file).slice(0, 1)
    return table.to_pylist()[0] if len(table) else None


def _array(values: Sequence[Any]) -> pa.Array:
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float} or (len(kinds) == 1 and kinds <= {bool, str}):
        return pa.array(values, pa.float64() if float in kinds else None)
    return pa.array([None if value is None else json.dumps(value) for value in values], pa.string())
