"""Columns as JSON, one text per value: rows are put together from them many times faster than object by object."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.formats.clean_text import clean


def json_texts(column: NDArray[Any], *, missing: bool = False) -> list[str]:
    """The (n,) numbers, bools or words of a column, as `json.dumps` writes them; words cleaned, None as null.

    missing : write NaN as null; otherwise a number that JSON does not know raises ValueError
    """
    values = column.tolist()
    if column.dtype.kind == "f":
        return _numbers(column, values, missing=missing)
    if column.dtype.kind == "b":
        return ["true" if v else "false" for v in values]
    if column.dtype.kind in "iu":
        return list(map(str, values))
    known = {v: _word(v) for v in set(values)}
    return [known[v] for v in values]


def _numbers(column: NDArray[Any], values: list[float], *, missing: bool) -> list[str]:
    texts = list(map(repr, values))
    for i in np.flatnonzero(~np.isfinite(column)).tolist():
        if not (missing and np.isnan(column[i])):
            raise ValueError(f"JSON has no number for {values[i]}")
        texts[i] = "null"
    return texts


def _word(value: Any) -> str:
    return json.dumps(clean(value) if isinstance(value, str) else value, ensure_ascii=False, allow_nan=False)
