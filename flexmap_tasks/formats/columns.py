"""Dataclasses of arrays as Parquet tables, and back; same arrays, same bytes.

One row per element. A field named in the class's `lists` is partitioned over the rows by `offset` and becomes
a list column; (n, k) arrays become k columns; tags become one map column. Tables with `lon_deg, lat_deg` or
`x_m, y_m` carry a derived `geometry` column (GeoParquet 1.1, WKB), which is not read back.
"""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import shapely
from numpy.typing import NDArray

from flexmap_tasks.model.osm import Tags

Columns = dict[str, NDArray[Any] | Tags]

AXES = {
    "xyz": ("x", "y", "z"),
    "xy": ("x", "y"),
    "lonlat": ("lon", "lat"),
    "quaternion": ("qx", "qy", "qz", "qw"),
    "sigma": ("sigma_east", "sigma_north", "sigma_up"),
}
"""How the columns of an (n, k) array are called, by the last word of its name before the unit."""


def axis_names(field: str, width: int) -> list[str]:
    """Names of the columns of a two-dimensional field: `source_xy_m` gives `source_x_m`, `source_y_m`."""
    words = field.split("_")
    for i in range(len(words) - 1, -1, -1):
        axes = AXES.get(words[i])
        if axes and len(axes) == width:
            return ["_".join([*words[:i], axis, *words[i + 1 :]]) for axis in axes]
    return [f"{field}_{i}" for i in range(width)]


def encode_table(columns: Columns, lists: tuple[str, ...] = (), *, geometry: bool = True) -> bytes:
    """One Parquet file; `columns` holds 1-D or 2-D arrays, or Tags, and `offset` when there are lists."""
    offset = columns.get("offset")
    table: dict[str, pa.Array] = {}
    shapes: dict[str, int] = {}
    for name, value in columns.items():
        if isinstance(value, Tags):
            table[name] = _map_array(value)
            continue
        if name == "offset" and lists:
            continue
        parts = [(name, value)]
        if value.ndim == 2:
            shapes[name] = value.shape[1]
            parts = list(zip(axis_names(name, value.shape[1]), value.T, strict=True))
        for column, flat in parts:
            array = _array(flat)
            if name in lists:
                array = pa.ListArray.from_arrays(pa.array(_small(offset), pa.int32()), array)
            table[column] = array
    arrow = pa.table(table)
    metadata = {"flexmap": json.dumps({"shapes": shapes, "fields": list(columns)}, sort_keys=True)}
    if geometry:
        arrow, metadata = _with_geometry(arrow, metadata, columns.get("offset") if lists else None)
    return write_table(arrow.replace_schema_metadata(metadata))


def decode_table(content: bytes, fields: dict[str, Any], lists: tuple[str, ...]) -> Columns:
    """The columns of `encode_table`; `fields` maps each field to True where it holds Tags."""
    table = pq.ParquetFile(pa.BufferReader(content)).read(
        use_threads=False
    )  # small files: 4 times read_table
    shapes: dict[str, int] = json.loads(table.schema.metadata[b"flexmap"])["shapes"]
    out: Columns = {}
    offset: NDArray[np.int64] | None = None
    for name, is_tags in fields.items():
        if name == "offset" and lists:
            continue
        if is_tags:
            out[name] = _tags(table.column(name))
            continue
        names = axis_names(name, shapes[name]) if name in shapes else [name]
        if names[0] not in table.column_names:
            continue
        flats = []
        for column in names:
            chunk = table.column(column).combine_chunks()
            if name in lists:
                offset = chunk.offsets.to_numpy(zero_copy_only=False).astype(np.int64)
                chunk = chunk.values
            flats.append(_numpy(chunk))
        out[name] = np.column_stack(flats) if name in shapes else flats[0]
    if lists:
        if offset is None:
            raise ValueError("a table of lists without a list column")
        out["offset"] = offset
    return out


def column_group(content: bytes, prefix: str) -> list[str]:
    """Names of the fields `<prefix>.<name>` in the order they were written."""
    metadata = json.loads(pq.read_schema(io.BytesIO(content)).metadata[b"flexmap"])
    return [name for name in metadata["fields"] if name.startswith(f"{prefix}.")]


def write_table(table: pa.Table) -> bytes:
    """Parquet for measurements: a dictionary only for text, bytes of floats side by side so that they compress."""
    text = [f.name for f in table.schema if pa.types.is_string(f.type)]
    floats = [f.name for f in table.schema if pa.types.is_floating(f.type)]
    sink = io.BytesIO()
    pq.write_table(
        table,
        sink,
        compression="zstd",
        compression_level=1,
        use_dictionary=text,
        use_byte_stream_split=floats,
    )
    return sink.getvalue()


def _small(offset: Any) -> NDArray[np.int32]:
    if len(offset) and offset[-1] > np.iinfo(np.int32).max:
        raise ValueError("more than 2^31 list entries in one table")
    return np.asarray(offset, dtype=np.int32)


def _array(flat: NDArray[Any]) -> pa.Array:
    if flat.dtype == object:
        return pa.array(flat, pa.string(), from_pandas=False)
    return pa.array(np.ascontiguousarray(flat))


def _numpy(chunk: pa.Array) -> NDArray[Any]:
    if pa.types.is_string(chunk.type):
        return np.asarray(chunk.to_numpy(zero_copy_only=False), dtype=object)
    return np.array(chunk.to_numpy(zero_copy_only=False))


def _map_array(tags: Tags) -> pa.Array:
    offsets = pa.array(_small(tags.offset), pa.int32())
    return pa.MapArray.from_arrays(offsets, _array(tags.key), _array(tags.value))


def _tags(column: pa.ChunkedArray) -> Tags:
    chunk = column.combine_chunks()
    offset = chunk.offsets.to_numpy(zero_copy_only=False).astype(np.int64)
    return Tags(offset, _numpy(chunk.keys), _numpy(chunk.items))


def _with_geometry(table: pa.Table, metadata: dict[str, str], offset: Any) -> tuple[pa.Table, dict[str, str]]:
    for x, y, crs in (("lon_deg", "lat_deg", True), ("x_m", "y_m", False)):
        if x in table.column_names and y in table.column_names:
            geometry, kind = _geometry(table.column(x), table.column(y), offset)
            column: dict[str, Any] = {"encoding": "WKB", "geometry_types": [kind]}
            if not crs:
                column["crs"] = None  # a local frame: metres, no EPSG code of its own
            geo = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": column}}
            metadata = {**metadata, "geo": json.dumps(geo, sort_keys=True)}
            return table.append_column("geometry", geometry), metadata
    return table, metadata


def _geometry(x: pa.ChunkedArray, y: pa.ChunkedArray, offset: Any) -> tuple[pa.Array, str]:
    """A column of WKB, null where there is nothing to draw, and what its geometries are called."""
    if pa.types.is_list(x.type):
        xy = np.column_stack([_numpy(c.combine_chunks().values) for c in (x, y)])
        size = np.diff(offset)
        keep = size >= 2
        rows = np.repeat(np.arange(len(size)), size)
        lines = np.full(len(size), None, dtype=object)
        use = keep[rows]
        new_row = (np.cumsum(keep) - 1)[rows[use]]
        if keep.any():
            lines[keep] = shapely.linestrings(xy[use], indices=new_row)
        return pa.array(list(shapely.to_wkb(lines)), pa.binary()), "LineString"
    xy = np.column_stack([_numpy(c.combine_chunks()) for c in (x, y)])
    return _points(xy), "Point"


def _points(xy: NDArray[np.float64]) -> pa.Array:
    """WKB of (n, 2) points, laid out at once: one call per point costs more than all the rest of a table."""
    known = np.isfinite(xy).all(axis=1)
    rows = np.zeros(int(known.sum()), [("order", "u1"), ("kind", "<u4"), ("xy", "<f8", (2,))])
    rows["order"] = rows["kind"] = 1  # little-endian, a point
    rows["xy"] = xy[known]
    offset = np.append(0, np.cumsum(known, dtype=np.int64) * rows.itemsize)
    buffers = [np.packbits(known, bitorder="little"), _small(offset), rows.view(np.uint8)]
    return pa.Array.from_buffers(pa.binary(), len(xy), [pa.py_buffer(b) for b in buffers])
