"""MCAP for Foxglove and Lichtblick: tracks and the map as JSON messages of Foxglove's schemas."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from flexmap_tasks.model.arrays import Floats, Ints

NS_PER_S = 1_000_000_000
Message = tuple[int, dict[str, Any]]
"""(log time in ns, message)."""

_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}
_TIME = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
}
_VECTOR = {"type": "object", "properties": dict.fromkeys("xyz", _NUMBER)}
_POSE = {
    "type": "object",
    "properties": {
        "position": _VECTOR,
        "orientation": {"type": "object", "properties": dict.fromkeys("xyzw", _NUMBER)},
    },
}
_LINE = {
    "type": "object",
    "properties": {
        "type": {"type": "integer"},
        "pose": _POSE,
        "thickness": _NUMBER,
        "scale_invariant": {"type": "boolean"},
        "points": {"type": "array", "items": _VECTOR},
        "color": {"type": "object", "properties": dict.fromkeys("rgba", _NUMBER)},
    },
}
_ENTITY = {
    "type": "object",
    "properties": {
        "timestamp": _TIME, "frame_id": _TEXT, "id": _TEXT, "lifetime": _TIME,
        "frame_locked": {"type": "boolean"}, "lines": {"type": "array", "items": _LINE},
    },
}  # fmt: skip
SCHEMAS: dict[str, dict[str, Any]] = {
    "foxglove.LocationFix": {
        "timestamp": _TIME, "frame_id": _TEXT, "latitude": _NUMBER, "longitude": _NUMBER, "altitude": _NUMBER,
        "position_covariance": {"type": "array", "items": _NUMBER}, "position_covariance_type": {"type": "integer"},
    },
    "foxglove.PoseInFrame": {"timestamp": _TIME, "frame_id": _TEXT, "pose": _POSE},
    "foxglove.GeoJSON": {"geojson": _TEXT},
    "foxglove.SceneUpdate": {"entities": {"type": "array", "items": _ENTITY}},
}  # fmt: skip
COVARIANCE_UNKNOWN, COVARIANCE_DIAGONAL = 0, 2
LINE_LIST = 2


def foxglove_mcap(topics: Mapping[str, tuple[str, Iterable[Message]]]) -> bytes:
    """Topics {name: (schema, messages in the order of their log time)}; same messages, same bytes."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.ZSTD, chunk_size=1024 * 1024)
    writer.start(profile="", library="flexmap")
    for name, (kind, messages) in topics.items():
        schema = {"type": "object", "title": kind, "properties": SCHEMAS[kind]}
        number = writer.register_schema(kind, "jsonschema", json.dumps(schema, sort_keys=True).encode())
        channel = writer.register_channel(name, "json", number)
        for sequence, (log_ns, message) in enumerate(messages):
            text = json.dumps(message, separators=(",", ":"), allow_nan=False)
            writer.add_message(channel, log_ns, text.encode(), log_ns, sequence)
    writer.finish()  # type: ignore[no-untyped-call]
    return stream.getvalue()


def location_fixes(
    stamp_ns: Ints, lonlat_deg: Floats, alt_m: Floats, sigma_m: Floats, frame_id: str
) -> Iterator[Message]:
    """foxglove.LocationFix; the altitude is left out where it is NaN."""
    rows = zip(stamp_ns.tolist(), lonlat_deg.tolist(), alt_m.tolist(), sigma_m.tolist(), strict=True)
    for ns, (lon, lat), alt, sigma in rows:
        known = bool(np.isfinite(sigma).all())
        variance = [s * s for s in sigma] if known else [0.0] * 3
        message = {
            "timestamp": _time(ns), "frame_id": frame_id, "latitude": lat, "longitude": lon,
            "position_covariance": [variance[0], 0, 0, 0, variance[1], 0, 0, 0, variance[2]],
            "position_covariance_type": COVARIANCE_DIAGONAL if known else COVARIANCE_UNKNOWN,
        }  # fmt: skip
        yield ns, message | ({"altitude": alt} if np.isfinite(alt) else {})


def poses_in_frame(stamp_ns: Ints, xyz_m: Floats, quaternion: Floats, frame_id: str) -> Iterator[Message]:
    """foxglove.PoseInFrame; quaternion (n, 4) x y z w."""
    for ns, place, turn in zip(stamp_ns.tolist(), xyz_m.tolist(), quaternion.tolist(), strict=True):
        pose = {
            "position": dict(zip("xyz", place, strict=True)),
            "orientation": dict(zip("xyzw", turn, strict=True)),
        }
        yield ns, {"timestamp": _time(ns), "frame_id": frame_id, "pose": pose}


def scene_lines(
    log_ns: int, frame_id: str, entities: Mapping[str, tuple[Floats, tuple[float, float, float, float]]]
) -> Message:
    """foxglove.SceneUpdate: per entity segments (n, 2, 3) in metres and a colour r, g, b, a of 0..1."""
    still = {"position": dict.fromkeys("xyz", 0.0), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    out = []
    for name, (segments, colour) in entities.items():
        points = [dict(zip("xyz", p, strict=True)) for p in np.round(segments.reshape(-1, 3), 3).tolist()]
        line = {
            "type": LINE_LIST, "pose": still, "thickness": 1.5, "scale_invariant": True, "points": points,
            "color": dict(zip("rgba", colour, strict=True)),
        }  # fmt: skip
        entity = {
            "timestamp": _time(log_ns), "frame_id": frame_id, "id": name, "lifetime": _time(0),
            "frame_locked": False, "lines": [line],
        }  # fmt: skip
        out.append(entity)
    return log_ns, {"entities": out}


def _time(ns: int) -> dict[str, int]:
    return {"sec": ns // NS_PER_S, "nsec": ns % NS_PER_S}
