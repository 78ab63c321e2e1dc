"""Values as files and back, driven by their type: what the store holds and a person can open.

Table-like dataclasses become `<name>.parquet`, scalar ones `<name>.json`, composites a folder `<name>/` with
one entry per field. A dict of values becomes a folder with one entry per key, a dict of bytes plain files.
A `Source` reads back as the file itself.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import types
import typing
from collections.abc import Hashable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from flexmap_tasks.formats.columns import Columns, column_group, decode_table, encode_table
from flexmap_tasks.model.arrays import freeze
from flexmap_tasks.model.osm import Tags
from flexmap_tasks.model.source import Source


class Files(Protocol):
    """The files of one artifact, by path inside of it."""

    def names(self) -> list[str]:
        """All paths, sorted."""

    def read(self, name: str) -> bytes:
        """Content of a file, verified."""

    def local(self, name: str) -> Path:
        """A path where the verified content can be read."""

    def sub(self, prefix: str) -> Files:
        """The files whose path begins with `prefix`, by the rest of their path."""


def encode(value: Any, name: str) -> Iterator[tuple[str, bytes]]:
    """Files of a value as (path, content), lazily, in a fixed order."""
    if isinstance(value, bytes):
        yield name, value
    elif isinstance(value, Mapping):
        raw = all(isinstance(v, bytes) for v in value.values()) if isinstance(value, dict) else False
        for key, item in value.items() if not isinstance(value, dict) else sorted(value.items()):
            yield from encode(item, key if raw else f"{name}/{key}")
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        yield from _encode_dataclass(value, name)
    else:
        raise TypeError(f"{type(value).__name__} is no value that can be stored")


def decode(kind: Any, files: Files, name: str) -> Any:
    """The value of type `kind` that `encode(value, name)` wrote; None for an optional one without files."""
    kind = _without_none(kind)
    if kind is Source:
        only = files.names()
        return Source(only[0], files.local(only[0]))
    origin = typing.get_origin(kind)
    if origin is dict or origin is Mapping or (isinstance(origin, type) and issubclass(origin, Mapping)):
        item = typing.get_args(kind)[1]
        if item is bytes:
            return {n: files.read(n) for n in files.names()}
        inner = files.sub(f"{name}/")
        return LazyItems(item, inner)
    return _decode_dataclass(kind, files, name)


class LazyItems(Mapping[str, Any]):
    """A folder of values, read one at a time so that large collections never sit in memory together."""

    def __init__(self, kind: Any, files: Files) -> None:
        self._kind, self._files = kind, files
        self._keys = sorted({n.split("/")[0].split(".")[0] for n in files.names()})

    def __getitem__(self, key: str) -> Any:
        if key not in self._keys:
            raise KeyError(key)
        return decode(self._kind, self._files, key)

    def __iter__(self) -> Iterator[str]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)


def _without_none(kind: Any) -> Any:
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        return next(a for a in typing.get_args(kind) if a is not type(None))
    return kind


def _is_array(kind: Any) -> bool:
    return typing.get_origin(_without_none(kind)) is np.ndarray


def _is_field_dict(kind: Any) -> bool:
    """A dict of named columns, such as the extra fields of a point cloud."""
    return typing.get_origin(kind) is dict and _is_array(typing.get_args(kind)[1])


def _is_nested(kind: Any) -> bool:
    kind = _without_none(kind)
    if typing.get_origin(kind) is tuple or kind is Tags or _is_field_dict(kind):
        return False
    origin = typing.get_origin(kind)
    mapping = isinstance(origin, type) and issubclass(origin, Mapping) and typing.get_args(kind)[1] is not str
    return dataclasses.is_dataclass(kind) or mapping


@dataclasses.dataclass(frozen=True, slots=True)
class _Shape:
    """How the fields of a dataclass are stored."""

    columns: dict[str, Any]
    field_dict: str | None
    nested: dict[str, Any]
    scalars: dict[str, Any]
    lists: tuple[str, ...]

    @property
    def plain(self) -> bool:
        """One file holds it all."""
        return not self.nested and not ((self.columns or self.field_dict) and self.scalars)


@functools.cache
def _shape(kind: Hashable) -> _Shape:
    hints = {
        f.name: typing.get_type_hints(kind)[f.name] for f in dataclasses.fields(typing.cast("Any", kind))
    }
    if getattr(kind, "as_json", False):
        return _Shape({}, None, {}, hints, ())
    nested = {n: k for n, k in hints.items() if _is_nested(k)}
    arrays = {n: _without_none(k) for n, k in hints.items() if _is_array(k) or _without_none(k) is Tags}
    columns = {n: k is Tags for n, k in arrays.items()}
    field_dict = next((n for n, k in hints.items() if _is_field_dict(k)), None)
    rest = {n: k for n, k in hints.items() if n not in nested and n not in columns and n != field_dict}
    return _Shape(columns, field_dict, nested, rest, getattr(kind, "lists", ()))


def _encode_dataclass(value: Any, name: str) -> Iterator[tuple[str, bytes]]:
    shape = _shape(typing.cast("Hashable", type(value)))
    table = f"{name}.parquet" if shape.plain else f"{name}/rows.parquet"
    scalars = f"{name}.json" if shape.plain else f"{name}/values.json"
    if shape.columns or shape.field_dict:
        present: Columns = {n: getattr(value, n) for n in shape.columns if getattr(value, n) is not None}
        if shape.field_dict:
            present |= {f"{shape.field_dict}.{k}": v for k, v in getattr(value, shape.field_dict).items()}
        yield table, encode_table(present, shape.lists, geometry=shape.field_dict is None)
    if shape.scalars:
        yield scalars, _json({n: getattr(value, n) for n in shape.scalars})
    for field in shape.nested:
        inner = getattr(value, field)
        if inner is not None:
            yield from encode(inner, f"{name}/{field}")


def _decode_dataclass(kind: Any, files: Files, name: str) -> Any:
    shape = _shape(kind)
    values: dict[str, Any] = dict.fromkeys(shape.columns)
    if shape.columns or shape.field_dict:
        content = files.read(f"{name}.parquet" if shape.plain else f"{name}/rows.parquet")
        fields = dict(shape.columns)
        if shape.field_dict:
            fields |= dict.fromkeys(column_group(content, shape.field_dict), False)
        for column, array in decode_table(content, fields, shape.lists).items():
            values[column] = array if isinstance(array, Tags) else freeze(array)
        if shape.field_dict:
            prefix = f"{shape.field_dict}."
            extra = {n[len(prefix) :]: values.pop(n) for n in list(values) if n.startswith(prefix)}
            values[shape.field_dict] = extra
    if shape.scalars:
        content = files.read(f"{name}.json" if shape.plain else f"{name}/values.json")
        loaded = json.loads(content)
        values |= {n: _from_json(k, loaded[n]) for n, k in shape.scalars.items()}
    inner = files.sub(f"{name}/")
    for field, field_kind in shape.nested.items():
        present = any(n.split("/")[0].split(".")[0] == field for n in inner.names())
        values[field] = decode(field_kind, inner, field) if present else None
    return kind(**values)


def _json(values: dict[str, Any]) -> bytes:
    return (json.dumps(values, default=_plain, indent=1, sort_keys=True, allow_nan=False) + "\n").encode()


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    raise TypeError(f"{type(value).__name__} has no JSON form")


def _from_json(kind: Any, value: Any) -> Any:
    if value is None:
        return None
    kind = _without_none(kind)
    if _is_array(kind):
        dtype = typing.get_args(typing.get_args(kind)[1])[0]
        return freeze(np.array(value, dtype=dtype))
    if typing.get_origin(kind) is tuple:
        return tuple(_from_json(typing.get_args(kind)[0], v) for v in value)
    if dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        return typing.cast("Any", kind)(**{n: _from_json(hints[n], v) for n, v in value.items()})
    return value
