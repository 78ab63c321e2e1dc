"""One scan out of a message: sensor_msgs/PointCloud2 in CDR, foxglove.PointCloud in protobuf or JSON.

Nothing is copied out of a PointCloud2: its points are a view of the message's bytes.
"""

from __future__ import annotations

import base64
import binascii
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexmap_tasks.formats.cdr import ENCAPSULATION, CdrError
from flexmap_tasks.formats.mcap_foxglove import Fields, guarded, stamp_of
from flexmap_tasks.formats.mcap_ros import NS_PER_S, frame_name
from flexmap_tasks.formats.pcd import Records
from flexmap_tasks.formats.pcd_header import AXES, MAX_POINT_BYTES, usable_names
from flexmap_tasks.formats.transform_tree import UNIT_TOLERANCE
from flexmap_tasks.geometry.se3 import Poses

MAX_FIELDS = 256
_ROS_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_FOXGLOVE_KINDS = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8"}
_FOXGLOVE_NAMES = ("UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64")


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """What a sensor saw in one sweep.

    stamp_ns : time of the header, 0 or less where it gives none
    frame : of the points; origin : (1,) pose of the points' origin in that frame, or None
    records : (n,) the points with all their fields
    """

    stamp_ns: int
    frame: str
    origin: Poses | None
    records: Records


class _Walk:
    """Walks through the bytes of one CDR message. Raises CdrError where they end."""

    def __init__(self, message: memoryview) -> None:
        if len(message) < ENCAPSULATION or message[0] != 0 or message[1] > 1:
            raise CdrError(0, "the encapsulation is not plain CDR")
        self.order = "<" if message[1] == 1 else ">"
        self.body, self.at = message[ENCAPSULATION:], 0

    def integer(self, code: str = "I") -> int:
        form = struct.Struct(self.order + code)
        self.at += -self.at % form.size
        if self.at + form.size > len(self.body):
            raise CdrError(0, "the message is cut off")
        (value,) = form.unpack_from(self.body, self.at)
        self.at += form.size
        return int(value)

    def take(self, length: int) -> memoryview:
        if length > len(self.body) - self.at:
            raise CdrError(0, "the message is cut off")
        self.at += length
        return self.body[self.at - length : self.at]

    def text(self) -> str:
        return bytes(self.take(self.integer())).rstrip(b"\0").decode(errors="replace")


def point_cloud2(message: memoryview) -> Scan:
    """A sensor_msgs/msg/PointCloud2. Raises CdrError (message 0) for one that breaks its own rules."""
    walk = _Walk(message)
    stamp = walk.integer("i") * NS_PER_S + walk.integer()
    frame = frame_name(walk.text())
    height, width, count = walk.integer(), walk.integer(), walk.integer()
    if count > MAX_FIELDS:
        raise CdrError(0, f"it claims {count} fields, more than {MAX_FIELDS}")
    fields = [(walk.text(), walk.integer(), walk.integer("B"), walk.integer()) for _ in range(count)]
    order = ">" if walk.integer("B") else "<"
    step, row_step = walk.integer(), walk.integer()
    data = walk.take(walk.integer())
    if height and row_step * (height - 1) + step * width > len(data):
        raise CdrError(0, f"{height} rows of {width} points do not fit its {len(data):,} bytes of data")
    kinds = [(name, offset, order + _kind(_ROS_KINDS, kind), n) for name, offset, kind, n in fields]
    record = _record_type(kinds, step)
    if not height * width:
        return Scan(stamp, frame, None, np.empty(0, record))
    if height > 1 and row_step < step * width:
        raise CdrError(0, "its rows overlap")
    points: Records = np.ndarray((height, width), record, data, 0, (row_step if height > 1 else 0, step))
    return Scan(stamp, frame, None, points.reshape(-1))  # copied only where rows have gaps between them


def foxglove_point_cloud(raw: bytes, fields: Fields) -> Scan:
    """A foxglove.PointCloud. Raises CdrError (message 0) for one that breaks its own rules."""
    return guarded(0, raw, fields, _foxglove)


def _foxglove(message: Mapping[str, Any]) -> Scan:
    data = message["data"]
    if isinstance(data, str):
        try:
            data = base64.b64decode(data, validate=True)
        except binascii.Error as error:
            raise CdrError(0, "its data is no base64") from error
    step = int(message["point_stride"])
    listed = message["fields"]
    if len(listed) > MAX_FIELDS:
        raise CdrError(0, f"it claims {len(listed)} fields, more than {MAX_FIELDS}")
    kinds = [(str(f["name"]), int(f.get("offset", 0)), "<" + _foxglove_kind(f["type"]), 1) for f in listed]
    record = _record_type(kinds, step)
    pose = message.get("pose") or {}
    place, turn = pose.get("position") or {}, pose.get("orientation") or {}
    xyz = np.array([[float(place.get(axis, 0.0)) for axis in AXES]])
    quaternion = np.array([[float(turn.get(axis, 0.0)) for axis in "xyzw"]])
    if not quaternion.any():
        quaternion[0, 3] = 1.0
    norm = float(np.linalg.norm(quaternion))
    if not (np.isfinite(xyz).all() and abs(norm - 1.0) < UNIT_TOLERANCE):
        raise CdrError(0, "its pose is no finite place and unit quaternion")
    origin = Poses(xyz, quaternion / norm)
    count = len(data) // step
    return Scan(
        stamp_of(message),
        frame_name(str(message.get("frame_id", ""))),
        origin,
        np.ndarray((count,), record, data) if count else np.empty(0, record),
    )


def _foxglove_kind(kind: int | str) -> str:
    return _kind(_FOXGLOVE_KINDS, _FOXGLOVE_NAMES.index(kind) if isinstance(kind, str) else int(kind))


def _kind(kinds: Mapping[int, str], number: int) -> str:
    if number not in kinds:
        raise CdrError(0, f"a field is of unknown type {number}")
    return kinds[number]


def _record_type(fields: list[tuple[str, int, str, int]], step: int) -> np.dtype[Any]:
    """Type of a point; fields are (name, offset, type, how many)."""
    if not 0 < step <= MAX_POINT_BYTES:
        raise CdrError(0, f"a point of {step} bytes is none")
    for name, offset, kind, count in fields:
        if count < 0 or offset + np.dtype(kind).itemsize * count > step:
            raise CdrError(0, f"the field {name[:40]!r} goes over the {step} bytes of a point")
    given = [f for f in fields if f[3]]
    if {a for a in AXES if [f[0] for f in given].count(a) == 1} != set(AXES):
        raise CdrError(0, "it has no fields x, y and z")
    for name, _, kind, count in given:
        if name in AXES and (kind[1] != "f" or count != 1):
            raise CdrError(0, f"{name} is no single floating point number")
    others = iter(usable_names([f[0] for f in given if f[0] not in AXES], AXES))
    return np.dtype(
        {
            "names": [f[0] if f[0] in AXES else next(others) for f in given],
            "formats": [kind if count == 1 else (kind, (count,)) for _, _, kind, count in given],
            "offsets": [offset for _, offset, _, _ in given],
            "itemsize": step,
        }
    )
