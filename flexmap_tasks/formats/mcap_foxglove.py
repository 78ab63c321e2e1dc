"""Foxglove's LocationFix, PoseInFrame and PosesInFrame, as protobuf or JSON (https://docs.foxglove.dev schemas)."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from flexmap_tasks.formats.cdr import CdrError
from flexmap_tasks.formats.mcap_records import Schema
from flexmap_tasks.formats.mcap_ros import NS_PER_S, Decoded
from flexmap_tasks.formats.track_rows import FIX_COLUMNS, POSE_COLUMNS, printable
from flexmap_tasks.model.tracks import STATUS_UNKNOWN

Fields = Callable[[bytes], dict[str, Any]]
"""One message as nested dicts of its fields, as in JSON."""

T = TypeVar("T")

_COVARIANCE_TYPES = {"UNKNOWN": 0, "APPROXIMATED": 1, "DIAGONAL_KNOWN": 2, "KNOWN": 3}


class SchemaError(Exception):
    """The schema in the file cannot be used; the text says why."""


def fields_reader(schema: Schema, encoding: str) -> Fields:
    """How to read messages of this schema; `encoding` is "json" or "protobuf".

    Raises SchemaError for a protobuf schema that describes no such message.
    """
    return _json_fields if encoding == "json" else _protobuf_fields(schema)


def location_fixes(messages: Iterable[bytes], fields: Fields) -> Decoded:
    """foxglove.LocationFix; it has no fix status. Raises CdrError with the number of a bad message."""
    return _each(messages, fields, _location_fix, len(FIX_COLUMNS))


def poses_in_frame(messages: Iterable[bytes], fields: Fields) -> Decoded:
    """foxglove.PoseInFrame. Raises CdrError with the number of a bad message."""
    return _each(messages, fields, lambda message: _pose(message["pose"]), len(POSE_COLUMNS))


def longest_poses(messages: Iterable[bytes], fields: Fields) -> Decoded:
    """The longest foxglove.PosesInFrame, the last of equal ones; its poses have no time of their own."""
    best: list[tuple[float, ...]] = []
    for number, raw in enumerate(messages):
        poses = guarded(number, raw, fields, lambda message: [_pose(p) for p in message["poses"]])
        best = poses if len(poses) >= len(best) else best
    values = np.asarray(best, dtype=np.float64).reshape(-1, len(POSE_COLUMNS))
    none = np.zeros(len(values), dtype=np.int64)
    return Decoded(values, none, none)


def _each(
    messages: Iterable[bytes], fields: Fields, row: Callable[[dict[str, Any]], tuple[float, ...]], width: int
) -> Decoded:
    stamps: list[int] = []
    values: list[tuple[float, ...]] = []
    for number, raw in enumerate(messages):
        stamp, value = guarded(number, raw, fields, lambda message: (stamp_of(message), row(message)))
        stamps.append(stamp)
        values.append(value)
    table = np.asarray(values, dtype=np.float64).reshape(-1, width)
    return Decoded(table, np.asarray(stamps, dtype=np.int64), np.arange(len(table)))


def guarded(number: int, raw: bytes, fields: Fields, use: Callable[[dict[str, Any]], T]) -> T:
    """What `use` makes of a message; CdrError with its number where it does not fit its schema."""
    try:
        return use(fields(raw))
    except KeyError as error:
        raise CdrError(number, f"the field {error} is missing") from error
    except (DecodeError, ValueError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise CdrError(number, f"the message does not fit its schema ({_one_line(error)})") from error


def _location_fix(message: dict[str, Any]) -> tuple[float, ...]:
    covariance = [float(value) for value in message.get("position_covariance") or ()]
    kind = message.get("position_covariance_type", 0)
    kind = _COVARIANCE_TYPES.get(kind, 0) if isinstance(kind, str) else kind
    if len(covariance) != 9:
        covariance, kind = [0.0] * 9, 0
    place = (float(message[name]) for name in ("latitude", "longitude", "altitude"))
    return (*place, covariance[0], covariance[4], covariance[8], float(kind), float(STATUS_UNKNOWN))


def _pose(pose: dict[str, Any]) -> tuple[float, ...]:
    position, turn = pose["position"], pose["orientation"]
    return (*(float(position[axis]) for axis in "xyz"), *(float(turn[axis]) for axis in "xyzw"))


def stamp_of(message: Mapping[str, Any]) -> int:
    """Nanoseconds since the epoch, 0 where the message gives no time."""
    stamp = message.get("timestamp") or {}
    total = int(stamp.get("sec", 0)) * NS_PER_S + int(stamp.get("nsec", 0))
    return total if 0 < total <= np.iinfo(np.int64).max else 0


def _json_fields(raw: bytes) -> dict[str, Any]:
    message = json.loads(raw)
    if not isinstance(message, dict):
        raise TypeError("no JSON object")
    return message


def _protobuf_fields(schema: Schema) -> Fields:
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(schema.data)
        pool = descriptor_pool.DescriptorPool()
        waiting = {file.name: file for file in files.file}
        while waiting:
            ready = [
                f for f in waiting.values() if not any(d in waiting for d in f.dependency if d != f.name)
            ]
            if not ready:
                raise SchemaError("its files depend on each other in a circle")
            for file in ready:
                pool.Add(file)
                del waiting[file.name]
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    except (DecodeError, TypeError, KeyError, ValueError) as error:
        raise SchemaError(f"its protobuf description cannot be used ({_one_line(error)})") from error

    def fields(raw: bytes) -> dict[str, Any]:
        return _as_dict(kind.FromString(raw))

    return fields


def _as_dict(message: Any) -> dict[str, Any]:
    """A protobuf message with the names that JSON has; what was not set has the value protobuf gives it."""
    out: dict[str, Any] = {}
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.message_type is None:
            out[field.name] = value
        elif field.message_type.full_name == "google.protobuf.Timestamp":
            out[field.name] = {"sec": value.seconds, "nsec": value.nanos}
        elif field.message_type.GetOptions().map_entry:
            continue
        elif field.is_repeated:
            out[field.name] = [_as_dict(item) for item in value]
        elif message.HasField(field.name):
            out[field.name] = _as_dict(value)
        else:  # one level only: a type may hold itself
            plain = (inner for inner in field.message_type.fields if inner.message_type is None)
            out[field.name] = {inner.name: inner.default_value for inner in plain}
    return out


def _one_line(error: Exception) -> str:
    return printable(" ".join(f"{type(error).__name__}: {error}".split()), 200)
