"""The scans of a recording, one after the other, and where the sensor sits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from flexmap_tasks.config import SlamParams
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats import mcap_foxglove, mcap_ros
from flexmap_tasks.formats.mcap_columns import guard, pieces, slices
from flexmap_tasks.formats.mcap_records import open_recording
from flexmap_tasks.formats.mcap_ros import frame_name
from flexmap_tasks.formats.mcap_topics import Topic, choose_topic
from flexmap_tasks.formats.mcap_tracks import pose_topic
from flexmap_tasks.formats.mcap_transforms import transform_tree
from flexmap_tasks.formats.scan_message import Scan, foxglove_point_cloud, point_cloud2
from flexmap_tasks.formats.track_rows import printable
from flexmap_tasks.formats.track_text import is_mcap
from flexmap_tasks.formats.transform_tree import along
from flexmap_tasks.geometry.se3 import Poses
from flexmap_tasks.model.source import Source

SCAN_KINDS = {"sensor_msgs/PointCloud2": ("cdr",), "foxglove.PointCloud": ("protobuf", "json")}
LISTED_FRAMES = 30


class ScanSource:
    """The scans on one topic of a recording.

    Raises InputError for a damaged file, and where no or more than one topic fits.
    """

    def __init__(self, source: Source, topic: str | None) -> None:
        self.name = source.name
        if not is_mcap(source.name, source.path):
            raise InputError(
                source.name, "scans are read from MCAP; for a cloud set point_cloud.format to cloud"
            )
        self._recording = open_recording(source.name, source.path)
        self.topic: Topic = choose_topic(self._recording, SCAN_KINDS, topic, "scans", "point_cloud.topic")

    def scans(self) -> Iterator[tuple[int, Scan]]:
        """(time in ns, scan) in the order of the file; the time is the header's or, where not set, the log's."""
        read = self._decoder()
        number = 0
        for piece in pieces(self._recording, self.topic):
            for log_ns, raw in zip(piece.log_time_ns.tolist(), slices(piece), strict=True):
                scan = guard(self._recording, self.topic, partial(read, raw), number)
                yield scan.stamp_ns if scan.stamp_ns > 0 else log_ns, scan
                number += 1

    def _decoder(self) -> Callable[[memoryview], Scan]:
        if self.topic.encoding == "cdr":
            return point_cloud2
        try:
            fields = mcap_foxglove.fields_reader(self.topic.schema, self.topic.encoding)
        except mcap_foxglove.SchemaError as error:
            where = f"schema {printable(self.topic.schema.name)}"
            raise InputError(self.name, str(error), where) from error
        return lambda raw: foxglove_point_cloud(bytes(raw), fields)

    def sensor_in(self, body: str, sensor: str) -> Poses:
        """(1,) pose of the sensor's frame in the body's, from transforms that do not move.

        Raises InputError where the recording does not say it.
        """
        tree = transform_tree(self._recording)
        way_out = "give its place as point_cloud.sensor_pose"
        shown = printable(f"from {body} to {sensor}")
        steps = tree.chain(body, sensor)
        if steps is None:
            frames = ", ".join(printable(name, 40) for name in tree.names()[:LISTED_FRAMES]) or "none"
            rule = f"no transforms lead {shown}, the frame of the scans; frames are: {frames}; {way_out}"
            raise InputError(self.name, rule)
        if not all(link.static for link, _ in steps):
            raise InputError(self.name, f"the sensor moves on its body: transforms {shown} change; {way_out}")
        return along(steps, np.zeros(1, np.int64))


def body_frame(source: Source, params: SlamParams) -> str | None:
    """The frame whose poses SLAM gives, where the recording of the poses says it."""
    if params.child_frame is not None:
        return frame_name(params.child_frame)
    if not is_mcap(source.name, source.path):
        return None
    recording = open_recording(source.name, source.path)
    topic = pose_topic(recording, params.topic)
    if topic.kind != "nav_msgs/Odometry":
        return None
    first = next(bytes(raw) for piece in pieces(recording, topic) for raw in slices(piece))
    return guard(recording, topic, lambda: mcap_ros.child_frame(first)) or None
