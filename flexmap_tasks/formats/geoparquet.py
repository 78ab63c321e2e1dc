"""GeoParquet 1.1: one file per layer, longitude and latitude (OGC:CRS84, its default), geometry as WKB."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pyarrow as pa
import shapely

from flexmap_tasks.formats.clean_text import clean
from flexmap_tasks.formats.columns import write_table
from flexmap_tasks.model.layers import VectorLayer


def geoparquet(layer: VectorLayer) -> bytes:
    """The layer's columns and its geometry; empty cells where a number is not known."""
    table = pa.table(
        {name: _column(column) for name, column in layer.columns.items()}
        | {"geometry": pa.array(list(shapely.to_wkb(layer.geometry)), pa.binary())}
    )
    column: dict[str, Any] = {"encoding": "WKB", "geometry_types": [layer.kind]}
    if len(layer) and np.isfinite(box := shapely.total_bounds(layer.geometry)).all():
        column["bbox"] = box.tolist()
    geo = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": column}}
    return write_table(table.replace_schema_metadata({"geo": json.dumps(geo, sort_keys=True)}))


def _column(values: np.ndarray) -> pa.Array:
    if values.dtype == object:
        return pa.array([None if v is None else clean(str(v)) for v in values.tolist()], pa.string())
    return pa.array(values, from_pandas=True)
