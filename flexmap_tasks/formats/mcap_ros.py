"""ROS 2 messages with fixes and poses, decoded into columns (message definitions: common_interfaces, geometry2)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flexmap_tasks.formats.cdr import Bytes, CdrError, Cursor, byte_orders, require_rows
from flexmap_tasks.formats.track_rows import FIX_COLUMNS, POSE_COLUMNS
from flexmap_tasks.model.arrays import Floats, Ints

NS_PER_S = 1_000_000_000

_POSE_BYTES = 7 * 8
_LEAST_TRANSFORM = 4 + 4 + 4 + 4 + _POSE_BYTES
_LEAST_POSE_STAMPED = 4 + 4 + 4 + _POSE_BYTES


@dataclass(frozen=True, slots=True, eq=False)
class Decoded:
    """Rows out of messages.

    values : (n, k) float64, FIX_COLUMNS or POSE_COLUMNS
    stamp_ns : (n,) int64, 0 or less where the message gives none
    message : (n,) number of the message a row comes from
    """

    values: Floats
    stamp_ns: Ints
    message: Ints


Decoder = Callable[[Cursor], Decoded]


def decode(data: Bytes, begin: Ints, end: Ints, decoder: Decoder) -> Decoded:
    """All messages, whatever their byte order, in the order they came.

    Raises CdrError with the number of the first message that is not what its type says.
    """
    parts = [decoder(cursor) for cursor in byte_orders(data, begin, end)]
    if len(parts) == 1:
        return parts[0]
    message = np.concatenate([part.message for part in parts])
    order = np.argsort(message, kind="stable")
    values = np.concatenate([part.values for part in parts])[order]
    return Decoded(values, np.concatenate([part.stamp_ns for part in parts])[order], message[order])


def nav_sat_fix(cursor: Cursor) -> Decoded:
    """sensor_msgs/msg/NavSatFix."""
    stamp = _header(cursor)
    out = np.empty((len(cursor), len(FIX_COLUMNS)))
    out[:, 7] = cursor.numbers("i1")[:, 0]
    cursor.skip("u2")
    place = cursor.numbers("f8", 3 + 9)
    out[:, 0:3] = place[:, 0:3]
    out[:, 3:6] = place[:, [3, 7, 11]]  # the diagonal of the covariance: east, north, up
    out[:, 6] = cursor.numbers("u1")[:, 0]
    return Decoded(out, stamp, cursor.rows)


def odometry(cursor: Cursor) -> Decoded:
    """nav_msgs/msg/Odometry: the pose, not the twist."""
    stamp = _header(cursor)
    cursor.skip_text()
    return Decoded(_pose(cursor), stamp, cursor.rows)


def pose_stamped(cursor: Cursor) -> Decoded:
    """geometry_msgs/msg/PoseStamped and PoseWithCovarianceStamped, whose covariance comes last."""
    stamp = _header(cursor)
    return Decoded(_pose(cursor), stamp, cursor.rows)


def transforms(parent: str, child: str) -> Decoder:
    """Decoder of tf2_msgs/msg/TFMessage that keeps the transforms from `parent` to `child`."""
    wanted = (_frame(parent.encode()), _frame(child.encode()))

    def decoder(cursor: Cursor) -> Decoded:
        pieces = [Decoded(np.empty((0, len(POSE_COLUMNS))), np.empty(0, np.int64), np.empty(0, np.int64))]
        for part, stamp, pairs, pose in _each_transform(cursor):
            keep = np.fromiter((pair == wanted for pair in pairs), dtype=bool, count=len(pairs))
            pieces.append(Decoded(pose[keep], stamp[keep], part.rows[keep]))
        message = np.concatenate([piece.message for piece in pieces])
        order = np.argsort(message, kind="stable")
        values = np.concatenate([piece.values for piece in pieces])[order]
        return Decoded(values, np.concatenate([piece.stamp_ns for piece in pieces])[order], message[order])

    return decoder


def frame_pairs(data: Bytes, begin: Ints, end: Ints) -> set[tuple[str, str]]:
    """All (parent, child) frames in TFMessages; for the choice a user must make."""
    found: set[tuple[bytes, bytes]] = set()
    for cursor in byte_orders(data, begin, end):
        for _, _, pairs, _ in _each_transform(cursor):
            found.update(pairs)
    return {(a.decode(errors="replace"), b.decode(errors="replace")) for a, b in found}


def path_lengths(data: Bytes, begin: Ints, end: Ints) -> Ints:
    """(n,) number of poses each nav_msgs/msg/Path claims."""
    out = np.zeros(len(begin), dtype=np.int64)
    for cursor in byte_orders(data, begin, end):
        _header(cursor)
        out[cursor.rows] = _count(cursor, _LEAST_POSE_STAMPED)
    return out


def path(message: bytes) -> Decoded:
    """Poses of one nav_msgs/msg/Path: each has a header, so each stands where the one before ends."""
    order = "<" if message[1] == 1 else ">"
    body = message[4:]
    stamp, head, pose = struct.Struct(order + "iI"), struct.Struct(order + "iII"), struct.Struct(order + "7d")
    try:
        at = stamp.size
        at += 4 + struct.unpack_from(order + "I", body, at)[0]
        at = _aligned(at, 4)
        (count,) = struct.unpack_from(order + "I", body, at)
        at += 4
        stamps, values = [], []
        for _ in range(count):
            at = _aligned(at, 4)
            seconds, nanoseconds, length = head.unpack_from(body, at)
            at = _aligned(at + head.size + length, 8)
            values.append(pose.unpack_from(body, at))
            stamps.append(seconds * NS_PER_S + nanoseconds)
            at += pose.size
    except struct.error as error:
        raise CdrError(0, "the message is cut off") from error
    table = np.asarray(values, dtype=np.float64).reshape(-1, len(POSE_COLUMNS))
    return Decoded(table, np.asarray(stamps, dtype=np.int64), np.zeros(len(table), dtype=np.int64))


def _each_transform(
    cursor: Cursor,
) -> list[tuple[Cursor, Ints, list[tuple[bytes, bytes]], Floats]]:
    """First transform of every message, then the second of those that have one, and so on."""
    left = _count(cursor, _LEAST_TRANSFORM)
    out = []
    while (more := left > 0).any():
        cursor, left = cursor.select(more), left[more] - 1
        stamp = _stamp(cursor)
        parents = [_frame(text) for text in cursor.texts()]
        children = [_frame(text) for text in cursor.texts()]
        out.append((cursor, stamp, list(zip(parents, children, strict=True)), _pose(cursor)))
    return out


def _count(cursor: Cursor, least: int) -> Ints:
    count = cursor.numbers("u4")[:, 0].astype(np.int64)
    require_rows(count * least <= cursor.remaining() + 8, "the message is cut off", cursor.rows)
    return count


def _header(cursor: Cursor) -> Ints:
    stamp = _stamp(cursor)
    cursor.skip_text()
    return stamp


def _stamp(cursor: Cursor) -> Ints:
    seconds = cursor.numbers("i4")[:, 0].astype(np.int64)
    return seconds * NS_PER_S + cursor.numbers("u4")[:, 0].astype(np.int64)


def _pose(cursor: Cursor) -> Floats:
    pose: Floats = cursor.numbers("f8", len(POSE_COLUMNS))
    return pose


def _frame(name: bytes) -> bytes:
    # tf2 knows no leading slash; old nodes still write one.
    return name.removeprefix(b"/")


def _aligned(at: int, size: int) -> int:
    return at + -at % size
