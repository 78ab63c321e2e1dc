"""ROS 2 messages with fixes and poses, decoded into columns (message definitions: common_interfaces, geometry2)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flexmap_tasks.formats.cdr import Bytes, CdrError, Cursor, byte_orders, require_rows
from flexmap_tasks.formats.nmea import APPROXIMATED, STATUS_OF_QUALITY, TYPICAL_SIGMA_M, UP_PER_HORIZONTAL
from flexmap_tasks.formats.track_rows import FIX_COLUMNS, POSE_COLUMNS
from flexmap_tasks.model.arrays import Floats, Ints

NS_PER_S = 1_000_000_000

QUALITY_OF_GPS = {-1: 0, 0: 1, 1: 2, 2: 4, 18: 2, 19: 4, 20: 5, 33: 2}
"""GGA quality by gps_msgs/GPSStatus: none, fix, SBAS, GBAS, DGPS, RTK fixed, RTK float, WAAS."""

RADIUS_95, LENGTH_95 = 2.448, 1.96
"""Standard deviations in the radius that holds 95 % of a plane's errors, and in that length of a line's."""

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


def gps_fix(cursor: Cursor) -> Decoded:
    """gps_msgs/msg/GPSFix: its status tells a fixed RTK solution from a float one (gpsd's names, gps_umd)."""
    stamp = _header(cursor)
    _header(cursor)
    cursor.skip("u2")
    cursor.skip_numbers("i4")
    cursor.skip("u2")
    for _ in range(4):  # numbers, elevations, azimuths and signals of the satellites
        cursor.skip_numbers("i4")
    status = cursor.numbers("i2")[:, 0].astype(np.int64)
    cursor.skip("u2", 3)
    place = cursor.numbers("f8", 25)
    covariance, kind = cursor.numbers("f8", 9), cursor.numbers("u1")[:, 0]
    out = np.empty((len(cursor), len(FIX_COLUMNS)))
    out[:, 0:3] = place[:, 0:3]
    across, up = place[:, 16] / RADIUS_95, place[:, 17] / LENGTH_95
    stated = np.column_stack([across, across, up]) ** 2
    typical = np.array([TYPICAL_SIGMA_M.get(QUALITY_OF_GPS.get(s, 1), np.nan) for s in status.tolist()])[
        :, None
    ]
    guess = (typical * [1.0, 1.0, UP_PER_HORIZONTAL]) ** 2
    known = (kind != 0) & (covariance[:, [0, 4, 8]] > 0).all(axis=1)
    out[:, 3:6] = np.where(known[:, None], covariance[:, [0, 4, 8]], np.where(stated > 0, stated, guess))
    out[:, 6] = np.where(known, kind, APPROXIMATED)
    out[:, 7] = [STATUS_OF_QUALITY[QUALITY_OF_GPS.get(s, 0 if s < 0 else 1)] for s in status.tolist()]
    return Decoded(out, stamp, cursor.rows)


def sentences(cursor: Cursor) -> tuple[Ints, list[bytes], Ints]:
    """nmea_msgs/msg/Sentence: stamps, texts and the number of each message."""
    stamp = _header(cursor)
    return stamp, cursor.texts(), cursor.rows


def odometry(cursor: Cursor) -> Decoded:
    """nav_msgs/msg/Odometry: the pose, not the twist."""
    stamp = _header(cursor)
    cursor.skip_text()
    return Decoded(_pose(cursor), stamp, cursor.rows)


def pose_stamped(cursor: Cursor) -> Decoded:
    """geometry_msgs/msg/PoseStamped and PoseWithCovarianceStamped, whose covariance comes last."""
    stamp = _header(cursor)
    return Decoded(_pose(cursor), stamp, cursor.rows)


def transforms(data: Bytes, begin: Ints, end: Ints) -> dict[tuple[str, str], Decoded]:
    """All transforms of tf2_msgs/msg/TFMessages by (parent, child) frame, in the order they came.

    The same pair twice in a message keeps its order. Raises CdrError with the number of a bad message.
    """
    rows: dict[tuple[str, str], list[tuple[int, int, int]]] = {}
    names: dict[bytes, str] = {}
    tables: list[tuple[Ints, Ints, Floats]] = []
    for cursor in byte_orders(data, begin, end):
        for depth, (part, stamp, pairs, pose) in enumerate(_each_transform(cursor)):
            for row, (parent, child) in enumerate(pairs):
                pair = (_named(parent, names), _named(child, names))
                rows.setdefault(pair, []).append((int(part.rows[row]), depth, len(tables)))
            tables.append((part.rows, stamp, pose))
    return {pair: _picked(sorted(places), tables) for pair, places in rows.items()}


def _named(raw: bytes, names: dict[bytes, str]) -> str:
    """The frame's name, decoded once."""
    if raw not in names:
        names[raw] = frame_name(raw)
    return names[raw]


def _picked(places: list[tuple[int, int, int]], tables: list[tuple[Ints, Ints, Floats]]) -> Decoded:
    """Rows of the tables by (message, depth, table)."""
    message, _, table = np.array(places, dtype=np.int64).T
    stamp, values = np.empty(len(message), np.int64), np.empty((len(message), len(POSE_COLUMNS)))
    for number in np.unique(table).tolist():
        here = np.flatnonzero(table == number)
        rows = np.searchsorted(tables[number][0], message[here])
        stamp[here], values[here] = tables[number][1][rows], tables[number][2][rows]
    return Decoded(values, stamp, message)


def child_frame(message: bytes) -> str:
    """child_frame_id of one nav_msgs/msg/Odometry."""
    (cursor,) = byte_orders(
        np.frombuffer(message, np.uint8), np.zeros(1, np.int64), np.array([len(message)], np.int64)
    )
    _header(cursor)
    return frame_name(cursor.texts()[0])


def frame_name(name: bytes | str) -> str:
    """A frame's name: tf2 knows no leading slash, old nodes still write one."""
    text = name.decode(errors="replace") if isinstance(name, bytes) else name
    return text.removeprefix("/")


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


def _each_transform(cursor: Cursor) -> list[tuple[Cursor, Ints, list[tuple[bytes, bytes]], Floats]]:
    """First transform of every message, then the second of those that have one, and so on."""
    left = _count(cursor, _LEAST_TRANSFORM)
    out = []
    while (more := left > 0).any():
        cursor, left = cursor.select(more), left[more] - 1
        stamp = _stamp(cursor)
        parents = cursor.texts()
        children = cursor.texts()
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


def _aligned(at: int, size: int) -> int:
    return at + -at % size
