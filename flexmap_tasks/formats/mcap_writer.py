"""Recordings as ROS 2 tools read them: MCAP with CDR messages and their definitions (common_interfaces)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.formats.mcap_file import CHUNK_BYTES, McapFile
from flexmap_tasks.formats.ros_definitions import DEFINITIONS
from flexmap_tasks.model.arrays import Floats, Ints

NS_PER_S = 1_000_000_000
CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
COVARIANCE_UNKNOWN, COVARIANCE_DIAGONAL = 0, 2
SERVICE_GPS = 1
QOS = (
    "- history: 3\n  depth: 0\n  reliability: 1\n  durability: 2\n  deadline:\n    sec: 9223372036\n"
    "    nsec: 854775807\n  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n  liveliness: 1\n"
    "  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n"
    "  avoid_ros_namespace_conventions: false"
)
"""Offered quality of service of a topic, as rosbag2 notes it."""

Stamped = tuple[int, bytes]
"""(log time in ns, message)."""


def write_mcap(path: Path, topics: Mapping[str, tuple[str, Iterable[Stamped]]]) -> None:
    """Write topics {name: (ROS 2 type, messages in the order of their log time)}, merged by log time.

    Messages may be generators: only a chunk of them is held at a time. Same messages, same bytes.
    """
    with path.open("wb") as stream:
        file = McapFile(stream, "ros2")
        channels, schemas = {}, dict[str, int]()
        for name, (kind, _) in topics.items():
            if kind not in schemas:
                schemas[kind] = file.schema(kind, "ros2msg", DEFINITIONS[kind].encode())
            channels[name] = file.channel(name, "cdr", schemas[kind], {"offered_qos_profiles": QOS})
        sources = [(channels[name], iter(messages)) for name, (_, messages) in topics.items()]
        first = 0
        for some in _some(_merged(sources)):
            channel, log_ns = (np.array([row[i] for row in some], np.int64) for i in (0, 1))
            file.messages(channel, log_ns, np.arange(first, first + len(some)), [text for *_, text in some])
            first += len(some)
        file.finish()


def _some(messages: Iterable[tuple[int, int, bytes]]) -> Iterator[list[tuple[int, int, bytes]]]:
    """All messages, about as many at a time as a chunk holds."""
    waiting, size = list[tuple[int, int, bytes]](), 0
    for message in messages:
        waiting.append(message)
        size += len(message[2])
        if size > CHUNK_BYTES:
            yield waiting
            waiting, size = [], 0
    if waiting:
        yield waiting


def _merged(sources: list[tuple[int, Iterator[Stamped]]]) -> Iterator[tuple[int, int, bytes]]:
    """All messages by log time; equal times in the order of the topics."""
    heads = [(channel, source, next(source, None)) for channel, source in sources]
    while True:
        waiting = [(head[0], k) for k, (_, _, head) in enumerate(heads) if head is not None]
        if not waiting:
            return
        _, k = min(waiting)
        channel, source, head = heads[k]
        if head is not None:
            yield channel, head[0], head[1]
        heads[k] = (channel, source, next(source, None))


def nav_sat_fixes(
    stamp_ns: Ints, log_ns: Ints, lonlatalt: Floats, sigma_m: Floats, status: Ints, frame_id: str
) -> Iterator[Stamped]:
    """sensor_msgs/msg/NavSatFix; lonlatalt, sigma_m (n, 3); NaN sigma says that the covariance is unknown."""
    layout = _Layout().header(frame_id)
    layout.add("status", "<i1").add("service", "<u2").add("lla", "<f8", (3,)).add("cov", "<f8", (9,))
    rows = layout.add("cov_type", "<u1").rows(stamp_ns, frame_id)
    rows["status"], rows["service"] = status, SERVICE_GPS
    rows["lla"] = lonlatalt[:, [1, 0, 2]]
    known = np.asarray(np.isfinite(sigma_m).all(axis=1))
    rows["cov"][:, [0, 4, 8]] = np.where(known[:, None], sigma_m**2, 0.0)
    rows["cov_type"] = np.where(known, COVARIANCE_DIAGONAL, COVARIANCE_UNKNOWN)
    yield from _stamped(log_ns, rows)


def odometries(
    stamp_ns: Ints, log_ns: Ints, xyz_m: Floats, quaternion: Floats, frame_id: str, child_frame_id: str
) -> Iterator[Stamped]:
    """nav_msgs/msg/Odometry with poses (n, 3) and quaternions (n, 4) x y z w; twist and covariances zero."""
    layout = _Layout().header(frame_id).text("child", child_frame_id)
    layout.add("xyz", "<f8", (3,)).add("q", "<f8", (4,)).add("pose_cov", "<f8", (36,))
    rows = layout.add("twist", "<f8", (6,)).add("twist_cov", "<f8", (36,)).rows(stamp_ns, frame_id)
    rows["child"], rows["child_size"] = child_frame_id.encode(), len(child_frame_id.encode()) + 1
    rows["xyz"], rows["q"] = xyz_m, quaternion
    yield from _stamped(log_ns, rows)


POINT_KINDS = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
"""sensor_msgs/PointField datatypes."""


def point_cloud2(stamp_ns: int, frame_id: str, points: NDArray[Any]) -> bytes:
    """sensor_msgs/msg/PointCloud2 of one scan; `points` (n,) is a structured array of scalar fields."""
    out = bytearray(_Layout().header(frame_id).rows(np.array([stamp_ns]), frame_id).tobytes())
    fields: Mapping[str, Any] = points.dtype.fields or {}
    _integers(out, 1, len(points), len(fields))
    for name, (kind, offset, *_) in fields.items():
        _string(out, name)
        _integers(out, int(offset))
        out.append(POINT_KINDS[kind.str[1:]])
        _integers(out, 1)
    out.append(0)
    _integers(out, points.dtype.itemsize, points.dtype.itemsize * len(points), points.nbytes)
    out += points.tobytes()
    out.append(1)
    return bytes(out)


def _aligned(out: bytearray, size: int) -> None:
    out += bytes(-(len(out) - len(CDR_LITTLE_ENDIAN)) % size)


def _integers(out: bytearray, *values: int) -> None:
    _aligned(out, 4)
    for value in values:
        out += int(value).to_bytes(4, "little")


def _string(out: bytearray, text: str) -> None:
    _integers(out, len(text.encode()) + 1)
    out += text.encode() + b"\x00"


class _Layout:
    """A CDR message of fixed size as a structured type; alignment counts from behind the 4-byte header."""

    def __init__(self) -> None:
        self._names: list[str] = []
        self._kinds: list[Any] = []
        self._offsets: list[int] = []
        self._end = 0

    def add(self, name: str, kind: str, shape: tuple[int, ...] = ()) -> _Layout:
        size = np.dtype(kind).itemsize
        at = self._end + (-self._end % size if not kind.startswith("S") else 0)
        self._names.append(name)
        self._kinds.append((kind, shape) if shape else kind)
        self._offsets.append(at + len(CDR_LITTLE_ENDIAN))
        self._end = at + size * int(np.prod(shape, dtype=np.int64))
        return self

    def text(self, name: str, value: str) -> _Layout:
        return self.add(f"{name}_size", "<u4").add(name, f"S{len(value.encode()) + 1}")

    def header(self, frame_id: str) -> _Layout:
        self.add("cdr", "S4")
        self._offsets[-1], self._end = 0, 0
        return self.add("sec", "<i4").add("nanosec", "<u4").text("frame", frame_id)

    def rows(self, stamp_ns: Ints, frame_id: str) -> NDArray[Any]:
        kind = np.dtype({
            "names": self._names, "formats": self._kinds, "offsets": self._offsets,
            "itemsize": self._end + len(CDR_LITTLE_ENDIAN),
        })  # fmt: skip
        rows = np.zeros(len(stamp_ns), kind)
        rows["cdr"] = CDR_LITTLE_ENDIAN
        rows["sec"], rows["nanosec"] = stamp_ns // NS_PER_S, stamp_ns % NS_PER_S
        rows["frame"], rows["frame_size"] = frame_id.encode(), len(frame_id.encode()) + 1
        return rows


def _stamped(log_ns: Ints, rows: NDArray[Any]) -> Iterator[Stamped]:
    size = rows.dtype.itemsize
    every = rows.tobytes()
    for k, log in enumerate(log_ns.tolist()):
        yield log, every[k * size : (k + 1) * size]
