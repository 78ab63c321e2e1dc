"""Arrays as JSON that a page can hold: numbers as base64 of their bytes, text as rows of one table.

Nothing in the result can end the script element it stands in, whatever the text says.
"""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.model.arrays import Floats, Strings
from flexmap_tasks.model.osm import Tags

Json = dict[str, Any]

_ESCAPES = {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026", "\u2028": "\\u2028", "\u2029": "\\u2029"}
LONGEST_TEXT = 20_000
"""Characters of one value that the report shows; the map keeps all of it."""


def script_json(value: Any) -> str:
    """JSON that is safe between `<script>` tags; the same value always gives the same text."""
    text = json.dumps(value, ensure_ascii=False, sort_keys=True, separators=(",", ":"), allow_nan=False)
    for character, escape in _ESCAPES.items():
        text = text.replace(character, escape)
    # A lone half of a surrogate pair has no UTF-8 form.
    return text.encode("utf-8", "replace").decode()


def numbers(array: NDArray[Any], kind: str) -> Json:
    """An array as bytes, little-endian; `kind` is "f4", "f8", "i4", "i8" or "u1". Flattened row by row."""
    flat = np.ascontiguousarray(array, dtype=np.dtype("<" + kind)).reshape(-1)
    return {"t": kind, "b": base64.b64encode(flat.tobytes()).decode()}


def millimetres(xy_m: Floats) -> Json:
    """(n, 2) or (n, >2) places as whole millimetres x0, y0, x1, ...; what is not finite becomes the lowest number."""
    plane = xy_m[:, :2]
    limit = float(np.iinfo(np.int32).max)
    whole = np.clip(np.round(plane * 1000.0), -limit, limit)
    return numbers(np.where(np.isfinite(plane), whole, np.iinfo(np.int32).min), "i4")


@dataclass(slots=True)
class Texts:
    """All text of a page, each string once, in the order in which it is first met."""

    rows: dict[str, int] = field(default_factory=dict)

    def column(self, values: Strings) -> Json:
        """A column of text; None and "" are the same."""
        place = self.rows
        rows = [place.setdefault(str(v or "")[:LONGEST_TEXT], len(place)) for v in values.tolist()]
        return {**numbers(np.array(rows, dtype=np.int64), "i4"), "text": True}

    def tags(self, tags: Tags) -> Json:
        """Tags of n elements."""
        return {
            "offset": numbers(tags.offset, "i4"),
            "key": self.column(tags.key),
            "value": self.column(tags.value),
        }

    def table(self) -> list[str]:
        """The strings by row."""
        return list(self.rows)
