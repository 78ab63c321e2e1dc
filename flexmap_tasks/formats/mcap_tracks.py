"""GNSS fixes and SLAM poses out of an MCAP recording, as rows."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats import mcap_foxglove, mcap_ros
from flexmap_tasks.formats.cdr import byte_orders
from flexmap_tasks.formats.mcap_columns import columns, guard, pieces, slices
from flexmap_tasks.formats.mcap_records import Messages, Recording, open_recording
from flexmap_tasks.formats.mcap_ros import Decoded, Decoder
from flexmap_tasks.formats.mcap_topics import Topic, choose_topic, topics_of
from flexmap_tasks.formats.mcap_transforms import TRANSFORM_KINDS, listed_pairs, read_transforms
from flexmap_tasks.formats.nmea import DAY_NS, read_sentences, turns
from flexmap_tasks.formats.track_rows import Rows, fill_stamps, printable
from flexmap_tasks.model.arrays import Ints

_FOXGLOVE = ("protobuf", "json")
FIX_KINDS = {"sensor_msgs/NavSatFix": ("cdr",), "foxglove.LocationFix": _FOXGLOVE}
MORE_FIX_KINDS = {"gps_msgs/GPSFix": ("cdr",), "gps_common/GPSFix": ("cdr",), "nmea_msgs/Sentence": ("cdr",)}
"""Say the same with the receiver's own quality; drivers publish them beside NavSatFix, so they are taken when named
or alone."""
POSE_KINDS = {
    "nav_msgs/Odometry": ("cdr",),
    "geometry_msgs/PoseStamped": ("cdr",),
    "geometry_msgs/PoseWithCovarianceStamped": ("cdr",),
    "nav_msgs/Path": ("cdr",),
    "foxglove.PoseInFrame": _FOXGLOVE,
    "foxglove.PosesInFrame": _FOXGLOVE,
}

_DECODERS: dict[str, Decoder] = {
    "sensor_msgs/NavSatFix": mcap_ros.nav_sat_fix,
    "gps_msgs/GPSFix": mcap_ros.gps_fix,
    "gps_common/GPSFix": mcap_ros.gps_fix,
    "nav_msgs/Odometry": mcap_ros.odometry,
    "geometry_msgs/PoseStamped": mcap_ros.pose_stamped,
    "geometry_msgs/PoseWithCovarianceStamped": mcap_ros.pose_stamped,
}


def read_fixes(name: str, path: Path, topic: str | None) -> Rows:
    """Columns FIX_COLUMNS from the topic `topic`, or from the only one with fixes when None.

    Raises InputError for a damaged file, and where no or more than one topic fits.
    """
    recording = open_recording(name, path)
    every = FIX_KINDS | MORE_FIX_KINDS
    fitting = {t.kind for t in topics_of(recording) if t.count}
    alone = [{kind: every[kind]} for kind in MORE_FIX_KINDS if kind in fitting]
    kinds = every if topic is not None or not fitting & every.keys() else FIX_KINDS
    if topic is None and not fitting & FIX_KINDS.keys() and alone:
        kinds = alone[0]
    chosen = choose_topic(recording, kinds, topic, "GNSS fixes", "gnss.topic")
    return (
        _read_sentences(recording, chosen)
        if chosen.kind == "nmea_msgs/Sentence"
        else _read(recording, chosen)
    )


def read_poses(name: str, path: Path, topic: str | None, parent: str | None, child: str | None) -> Rows:
    """Columns POSE_COLUMNS from a topic with poses or, where frames are given, from transforms parent -> child.

    Of paths (nav_msgs/Path, foxglove.PosesInFrame) the longest message is taken, of equal ones the last.
    Raises InputError for a damaged file, and where no or more than one topic fits.
    """
    recording = open_recording(name, path)
    if parent is not None and child is not None:
        return read_transforms(recording, topic, parent, child)
    if parent is not None or child is not None:
        raise InputError(name, "slam.parent_frame and slam.child_frame belong together; give both or none")
    chosen = pose_topic(recording, topic)
    if chosen.kind in TRANSFORM_KINDS:
        pairs = listed_pairs(recording, chosen)
        raise InputError(name, f"{chosen} needs slam.parent_frame and slam.child_frame; frames are: {pairs}")
    return _read(recording, chosen)


def pose_topic(recording: Recording, topic: str | None) -> Topic:
    """The topic with poses that is meant; InputError where it is not clear."""
    # Nearly every recording has transforms: without a frame pair they compete with no topic of poses.
    fitting = {topic.kind for topic in topics_of(recording) if topic.count}
    kinds = POSE_KINDS if topic is None and fitting & POSE_KINDS.keys() else POSE_KINDS | TRANSFORM_KINDS
    return choose_topic(recording, kinds, topic, "SLAM poses", "slam.topic")


def _read(recording: Recording, topic: Topic) -> Rows:
    if topic.kind == "nav_msgs/Path":
        return _read_path(recording, topic)
    if topic.encoding != "cdr":
        return _read_foxglove(recording, topic)
    messages = columns(recording, topic)
    decoder = _DECODERS[topic.kind]
    return _rows(recording, topic, messages.log_time_ns, partial(_decode, messages, decoder))


def _read_sentences(recording: Recording, topic: Topic) -> Rows:
    """Fixes of NMEA sentences, on the clock of the recording: the receiver's times, shifted as a whole.

    The stamps of the messages are when a line came in, which jitters; the shift is the median of their lag.
    """
    messages = columns(recording, topic)
    parts = guard(
        recording,
        topic,
        lambda: [mcap_ros.sentences(c) for c in byte_orders(messages.data, messages.begin, messages.end)],
    )
    stamps, texts = np.empty(len(messages), np.int64), [b""] * len(messages)
    for stamp, some, rows in parts:
        stamps[rows] = stamp
        for row, text in zip(rows.tolist(), some, strict=True):
            texts[row] = text
    came_ns = fill_stamps(stamps, messages.log_time_ns)
    read = read_sentences(text.decode("latin-1") for text in texts)
    if not len(read):
        raise InputError(recording.name, f"{topic} holds no GGA sentence with a right checksum")
    day_ns = read.tod_ns + DAY_NS * turns(read.tod_ns)
    lag = int(np.median(came_ns[read.number] - day_ns))
    place = f"topic {topic.label} message"
    return Rows(read.values, day_ns + lag, lambda row: f"{place} {read.number[row] + 1}", topic.kind)


def _read_path(recording: Recording, topic: Topic) -> Rows:
    best, length, number = b"", -1, 0
    seen = 0
    for piece in pieces(recording, topic):
        count = partial(mcap_ros.path_lengths, piece.data, piece.begin, piece.end)
        lengths = guard(recording, topic, count, seen)
        last = len(lengths) - 1 - int(np.argmax(lengths[::-1]))
        if lengths[last] >= length:
            best, length = piece.data[piece.begin[last] : piece.end[last]].tobytes(), int(lengths[last])
            number = seen + last
        seen += len(lengths)
    poses = guard(recording, topic, lambda: mcap_ros.path(best), number)
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
        raw = (message for piece in pieces(recording, topic) for message in slices(piece))
        poses = guard(recording, topic, lambda: mcap_foxglove.longest_poses(map(bytes, raw), fields))
        return Rows(poses.values, None, lambda row: f"topic {topic.label} pose {row + 1}", topic.kind)
    read = mcap_foxglove.location_fixes if topic.kind in FIX_KINDS else mcap_foxglove.poses_in_frame
    messages = columns(recording, topic)
    return _rows(recording, topic, messages.log_time_ns, lambda: read(map(bytes, slices(messages)), fields))


def _rows(recording: Recording, topic: Topic, log_time_ns: Ints, decode: Callable[[], Decoded]) -> Rows:
    """Rows with the header's time or, where it is not set, the time the message was logged."""
    decoded = guard(recording, topic, decode)
    message = decoded.message
    stamps = fill_stamps(decoded.stamp_ns, log_time_ns[message])
    return Rows(
        decoded.values, stamps, lambda row: f"topic {topic.label} message {message[row] + 1}", topic.kind
    )


def _decode(messages: Messages, decoder: Decoder) -> Decoded:
    return mcap_ros.decode(messages.data, messages.begin, messages.end, decoder)
