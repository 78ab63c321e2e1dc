"""The truth of a simulated world: plain Parquet tables, one value per column and row."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from flexmap_tasks.errors import InputError
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.source import Source

TYPES = {"int": (pa.types.is_integer, np.int64), "float": (pa.types.is_floating, np.float64),
         "bool": (pa.types.is_boolean, np.bool_), "text": (pa.types.is_string, object)}  # fmt: skip


def read_columns(source: Source, columns: dict[str, str]) -> dict[str, NDArray[Any]]:
    """The named columns, each of the kind "int", "float", "bool" or "text".

    Raises InputError when the file is no Parquet table, or a column is missing, of another kind, or has gaps.
    """
    try:
        with source.path.open("rb") as file:
            table = pq.read_table(file)
    except OSError as error:
        raise InputError(source.name, f"the file cannot be read ({error.strerror or error})") from None
    except (pa.ArrowException, ValueError) as error:
        raise InputError(source.name, f"expected a Parquet table of a simulated world ({error})") from None
    out: dict[str, NDArray[Any]] = {}
    for name, kind in columns.items():
        fits, dtype = TYPES[kind]
        if name not in table.column_names or not fits(table.schema.field(name).type):
            raise InputError(
                source.name, f"expected a column {name} of {kind} values; simulate the world again"
            )
        column = table.column(name).combine_chunks()
        if column.null_count:
            raise InputError(source.name, f"column {name} has gaps; simulate the world again")
        values = column.to_numpy(zero_copy_only=False)
        out[name] = strings(values) if kind == "text" else np.array(values, dtype=dtype)
        if kind == "float" and not np.isfinite(out[name]).all():
            raise InputError(source.name, f"column {name} holds a value that is no number")
    return out
