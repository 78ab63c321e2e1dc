"""GNSS fixes and SLAM poses out of an MCAP recording, as rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats import mcap_foxglove, mcap_ros
from flexmap_tasks.formats.cdr import CdrError
from flexmap_tasks.formats.mcap_records import Messages, Recording, open_recording
from flexmap_tasks.formats.mcap_ros import Decoded, Decoder
from flexmap_tasks.formats.mcap_topics import Topic, choose_topic, topics_of
from flexmap_tasks.formats.track_rows import Rows, printable
from flexmap_tasks.model.arrays import Ints

_FOXGLOVE = ("protobuf", "json")
FIX_KINDS = {"sensor_msgs/NavSatFix": ("cdr",), "foxglove.LocationFix": _FOXGLOVE}
POSE_KINDS = {
    "nav_msgs/Odometry": ("cdr",),
    "geometry_msgs/PoseStamped": ("cdr",),
    "geometry_msgs/PoseWithCovarianceStamped": ("cdr",),
    "nav_msgs/Path": ("cdr",),
    "foxglove.PoseInFrame": _FOXGLOVE,
    "foxglove.PosesInFrame": _FOXGLOVE,
}
TRANSFORM_KINDS = {"tf2_msgs/TFMessage": ("cdr",)}

_DECODERS: dict[str, Decoder] = {
    "sensor_msgs/NavSatFix": mcap_ros.nav_sat_fix,
    "nav_msgs/Odometry": mcap_ros.odometry,
    "geometry_msgs/PoseStamped": mcap_ros.pose_stamped,
    "geometry_msgs/PoseWithCovarianceStamped": mcap_ros.pose_stamped,
}
T = TypeVar("T")

WHOLE_PIECE_SHARE = 0.1
"""A chunk is kept whole where the wanted messages fill at least this share of it."""

CLOCKS_APART_NS = 60_000_000_000
"""Stamps this far from the log time come from another clock; less is the delay of logging."""

LISTED_PAIRS = 30
"""An error lists at most this many frame pairs."""


def read_fixes(name: str, path: Path, topic: str | None) -> Rows:
    """Columns FIX_COLUMNS from the topic `topic`, or from the only one with fixes when None.

    Raises InputError for a damaged file, and where no or more than one topic fits.
    """
    recording = open_recording(name, path)
    chosen = choose_topic(recording, FIX_KINDS, topic, "GNSS fixes", "gnss.topic")
    return _read(recording, chosen)


def read_poses(name: str, path: Path, topic: str | None, parent: str | None, child: str | None) -> Rows:
    """Columns POSE_COLUMNS from a topic with poses or, where frames are given, from transforms parent -> child.

    Of paths (nav_msgs/Path, foxglove.PosesInFrame) the longest message is taken, of equal ones the last.
    Raises InputError for a damaged file, and where no or more than one topic fits.
    """
    recording = open_recording(name, path)
    if parent is not None and child is not None:
        return _read_transforms(recording, topic, parent, child)
    if parent is not None or child is not None:
        raise InputError(name, "slam.parent_frame and slam.child_frame belong together; give both or none")
    # Nearly every recording has transforms: without a frame pair they compete with no topic of poses.
    fitting = {topic.kind for topic in topics_of(recording) if topic.count}
    kinds = POSE_KINDS if topic is None and fitting & POSE_KINDS.keys() else POSE_KINDS | TRANSFORM_KINDS
    chosen = choose_topic(recording, kinds, topic, "SLAM poses", "slam.topic")
    if chosen.kind in TRANSFORM_KINDS:
        pairs = _pairs(recording, chosen)
        raise InputError(name, f"{chosen} needs slam.parent_frame and slam.child_frame; frames are: {pairs}")
    return _read(recording, chosen)


def _read(recording: Recording, topic: Topic) -> Rows:
    if topic.kind == "nav_msgs/Path":
        return _read_path(recording, topic)
    if topic.encoding != "cdr":
        return _read_foxglove(recording, topic)
    messages = _columns(recording, topic)
    decoder = _DECODERS[topic.kind]
    return _rows(recording, topic, messages.log_time_ns, partial(_decode, messages, decoder))


def _read_transforms(recording: Recording, topic: str | None, parent: str, child: str) -> Rows:
    """Transforms of the pair from the one topic that has it; /tf and /tf_static are looked through alike."""
    found: dict[str, Rows] = {}
    topics = _transform_topics(recording, topic)
    for candidate in topics:
        messages = _columns(recording, candidate)
        decoder = mcap_ros.transforms(parent, child)
        rows = _rows(recording, candidate, messages.log_time_ns, partial(_decode, messages, decoder))
        if len(rows):
            found[candidate.label] = rows
    if not found:
        pairs = "; ".join(f"{t.label} has {_pairs(recording, t)}" for t in topics)
        raise InputError(recording.name, f"no transform {parent} -> {child}; {pairs}")
    if len(found) > 1:
        rule = f"several topics hold {parent} -> {child}: name one of {', '.join(found)} as `slam.topic`"
        raise InputError(recording.name, rule)
    return next(iter(found.values()))


def _transform_topics(recording: Recording, topic: str | None) -> list[Topic]:
    if topic is not None:
        return [choose_topic(recording, TRANSFORM_KINDS, topic, "transforms", "slam.topic")]
    every = [t for t in topics_of(recording) if t.kind in TRANSFORM_KINDS and t.encoding == "cdr" and t.count]
    # With no topic at all the choice has the message that lists what there is.
    return every or [choose_topic(recording, TRANSFORM_KINDS, None, "transforms", "slam.topic")]


def _read_path(recording: Recording, topic: Topic) -> Rows:
    best, length, number = b"", -1, 0
    seen = 0
    for piece in _pieces(recording, topic):
        count = partial(mcap_ros.path_lengths, piece.data, piece.begin, piece.end)
        lengths = _guard(recording, topic, count, seen)
        last = len(lengths) - 1 - int(np.argmax(lengths[::-1]))
        if lengths[last] >= length:
            best, length = piece.data[piece.begin[last] : piece.end[last]].tobytes(), int(lengths[last])
            number = seen + last
        seen += len(lengths)
    poses = _guard(recording, topic, lambda: mcap_ros.path(best), number)
    stamps = poses.stamp_ns
    # Many nodes fill in one time, or none, for all poses: that is no time of a pose.
    timed = bool((stamps > 0).all()) and len(np.unique(stamps)) == len(stamps)
    place = f"topic {topic.label} message {number + 1} pose"
    return Rows(poses.values, stamps if timed else None, lambda row: f"{place} {row + 1}", topic.kind)


def _read_foxglove(recording: Recording, topic: Topic) -> Rows:
    try:
        fields = mcap_foxglove.fields_reader(topic.schema, topic.encoding)
    except mcap_foxglove.SchemaError as error:
        raise InputError(recording.name, str(error), f"schema {printable(topic.schema.name)}") from error
    if topic.kind == "foxglove.PosesInFrame":
        raw = (message for piece in _pieces(recording, topic) for message in _slices(piece))
        poses = _guard(recording, topic, lambda: mcap_foxglove.longest_poses(map(bytes, raw), fields))
        return Rows(poses.values, None, lambda row: f"topic {topic.label} pose {row + 1}", topic.kind)
    read = mcap_foxglove.location_fixes if topic.kind in FIX_KINDS else mcap_foxglove.poses_in_frame
    messages = _columns(recording, topic)
    return _rows(recording, topic, messages.log_time_ns, lambda: read(map(bytes, _slices(messages)), fields))


def _rows(recording: Recording, topic: Topic, log_time_ns: Ints, decode: Callable[[], Decoded]) -> Rows:
    """Rows with the header's time or, where it is not set, the time the message was logged."""
    decoded = _guard(recording, topic, decode)
    message = decoded.message
    stamps = _fill_stamps(decoded.stamp_ns, log_time_ns[message])
    return Rows(
        decoded.values, stamps, lambda row: f"topic {topic.label} message {message[row] + 1}", topic.kind
    )


def _fill_stamps(stamp_ns: Ints, log_time_ns: Ints) -> Ints:
    given = stamp_ns > 0
    lags = np.sort(log_time_ns[given] - stamp_ns[given])
    lag = lags[len(lags) // 2] if len(lags) else np.int64(0)
    # A node on simulated time stamps 0 until it hears the clock: its log time is put onto that clock.
    shift = lag if abs(lag) > CLOCKS_APART_NS else np.int64(0)
    return np.where(given, stamp_ns, log_time_ns - shift)


def _guard(recording: Recording, topic: Topic, read: Callable[[], T], first: int = 0) -> T:
    try:
        return read()
    except CdrError as error:
        where = f"topic {topic.label} message {first + error.row + 1}"
        rule = f"{error.rule}; it is no valid {topic.kind}: record again or name another topic"
        raise InputError(recording.name, rule, where) from error


def _decode(messages: Messages, decoder: Decoder) -> Decoded:
    return mcap_ros.decode(messages.data, messages.begin, messages.end, decoder)


def _pieces(recording: Recording, topic: Topic) -> Iterator[Messages]:
    return (piece for piece in recording.messages(topic.channels) if len(piece))


def _slices(piece: Messages) -> Iterator[memoryview]:
    whole = piece.data.data
    bounds = zip(piece.begin.tolist(), piece.end.tolist(), strict=True)
    return (whole[begin:end] for begin, end in bounds)


def _columns(recording: Recording, topic: Topic) -> Messages:
    """All messages of a topic in one buffer, which holds at most 1 / WHOLE_PIECE_SHARE times their bytes."""
    parts: list[bytes | memoryview] = []
    begins: list[Ints] = []
    lengths: list[Ints] = []
    log_times: list[Ints] = []
    size = 0
    for piece in _pieces(recording, topic):
        length = piece.end - piece.begin
        # One copy of a whole chunk is faster than one of each message, where most of it is wanted.
        whole = WHOLE_PIECE_SHARE * len(piece.data) <= length.sum()
        parts.append(piece.data.data if whole else b"".join(_slices(piece)))
        begins.append(size + (piece.begin if whole else np.cumsum(length) - length))
        lengths.append(length)
        log_times.append(piece.log_time_ns)
        size += len(parts[-1])
    begin = np.concatenate(begins)
    data = np.frombuffer(b"".join(parts), dtype=np.uint8)
    return Messages(data, begin, begin + np.concatenate(lengths), np.concatenate(log_times))


def _pairs(recording: Recording, topic: Topic) -> str:
    messages = _columns(recording, topic)
    try:
        pairs = sorted(mcap_ros.frame_pairs(messages.data, messages.begin, messages.end))
    except CdrError as error:
        return f"unreadable ({error.rule})"
    more = f" and {len(pairs) - LISTED_PAIRS} more" if len(pairs) > LISTED_PAIRS else ""
    return ", ".join(printable(f"{parent} -> {child}") for parent, child in pairs[:LISTED_PAIRS]) + more
