"""MCAP for Foxglove and Lichtblick: tracks and the map as JSON messages of Foxglove's schemas."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from flexmap_tasks.formats.json_text import SLOT, json_rows, json_texts
from flexmap_tasks.formats.mcap_file import McapFile
from flexmap_tasks.model.arrays import Floats, Ints

NS_PER_S = 1_000_000_000
Messages = tuple[Ints, list[str]]
"""(n,) log times in ns, ascending, and as many messages as JSON."""

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


def foxglove_mcap(topics: Mapping[str, tuple[str, Messages]]) -> bytes:
    """Topics {name: (schema, messages)}; same messages, same bytes."""
    stream = io.BytesIO()
    file = McapFile(stream, "")
    for name, (kind, (log_ns, texts)) in topics.items():
        schema = {"type": "object", "title": kind, "properties": SCHEMAS[kind]}
        number = file.schema(kind, "jsonschema", json.dumps(schema, sort_keys=True).encode())
        channel = file.channel(name, "json", number, {})
        count = len(texts)
        file.messages(np.full(count, channel), log_ns, np.arange(count), [text.encode() for text in texts])
    file.finish()
    return stream.getvalue()


def location_fixes(
    stamp_ns: Ints, lonlat_deg: Floats, alt_m: Floats, sigma_m: Floats, frame_id: str
) -> Messages:
    """foxglove.LocationFix; the altitude is left out where it is NaN."""
    known, high = np.asarray(np.isfinite(sigma_m).all(axis=1)), np.isfinite(alt_m)
    variance = np.where(known[:, None], sigma_m, 0.0) ** 2
    kind = np.where(known, COVARIANCE_DIAGONAL, COVARIANCE_UNKNOWN)
    up = json_texts(np.where(high, alt_m, 0.0))
    altitude = [f',"altitude":{text}' if h else "" for text, h in zip(up, high.tolist(), strict=True)]
    columns = [lonlat_deg[:, 1], lonlat_deg[:, 0], *variance.T, kind]
    template = (
        f'{{{_stamp(frame_id)},"latitude":{SLOT},"longitude":{SLOT},"position_covariance":'
        f'[{SLOT},0,0,0,{SLOT},0,0,0,{SLOT}],"position_covariance_type":{SLOT}{SLOT}}}'
    )
    return stamp_ns, json_rows(template, *_stamps(stamp_ns), *map(json_texts, columns), altitude)


def poses_in_frame(stamp_ns: Ints, xyz_m: Floats, quaternion: Floats, frame_id: str) -> Messages:
    """foxglove.PoseInFrame; quaternion (n, 4) x y z w."""
    x, y, z, w = (f'"{axis}":{SLOT}' for axis in "xyzw")
    template = (
        f'{{{_stamp(frame_id)},"pose":{{"position":{{{x},{y},{z}}},"orientation":{{{x},{y},{z},{w}}}}}}}'
    )
    return stamp_ns, json_rows(template, *_stamps(stamp_ns), *map(json_texts, [*xyz_m.T, *quaternion.T]))


def _stamp(frame_id: str) -> str:
    return f'"timestamp":{{"sec":{SLOT},"nsec":{SLOT}}},"frame_id":{json.dumps(frame_id)}'


def _stamps(stamp_ns: Ints) -> tuple[list[str], list[str]]:
    return json_texts(stamp_ns // NS_PER_S), json_texts(stamp_ns % NS_PER_S)


def alone(log_ns: int, message: Mapping[str, Any]) -> Messages:
    """A message that stands alone."""
    return np.array([log_ns]), [json.dumps(message, separators=(",", ":"), allow_nan=False)]


def scene_lines(
    log_ns: int, frame_id: str, entities: Mapping[str, tuple[Floats, tuple[float, float, float, float]]]
) -> Messages:
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
    return alone(log_ns, {"entities": out})


def _time(ns: int) -> dict[str, int]:
    return {"sec": ns // NS_PER_S, "nsec": ns % NS_PER_S}
