"""Recordings into columns: fixes and poses, and scans, beside rosbags, mcap_ros2 and the mcap library."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from flexmap_tasks.config import GnssParams, SlamParams
from flexmap_tasks.formats.artifacts import encode
from flexmap_tasks.formats.mcap_scans import ScanSource
from flexmap_tasks.formats.mcap_writer import Stamped, nav_sat_fixes, odometries, point_cloud2, write_mcap
from flexmap_tasks.formats.ros_definitions import DEFINITIONS
from flexmap_tasks.ingest.gnss import ingest_gnss
from flexmap_tasks.ingest.slam import ingest_slam
from flexmap_tasks.model.source import Source
from tests.bench.measure import best_cpu_s, show

STORE = get_typestore(Stores.ROS2_HUMBLE)
MESSAGES, EACH = 60_000, 30_000
SCANS, POINTS = 150, 120_000
POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("t", "<u4")]
)
T0, STEP = 1_763_800_000_000_000_000, 33_000_000
COLUMNS_PER_S, COLUMNS_ROSBAGS, COLUMNS_MCAP_ROS2 = 240_000, 6, 10
SCANS_GB_S = 2.0


def run() -> None:
    """CPU seconds of each reader on the same file, all in this run."""
    with tempfile.TemporaryDirectory() as name:
        _columns(Path(name) / "tracks.mcap")
        _scans(Path(name) / "scans.mcap")


def _columns(file: Path) -> None:
    write_mcap(file, _tracks())
    source = Source(file.name, file)

    def ours() -> None:
        list(encode(ingest_gnss(source, GnssParams()), "fixes"))
        list(encode(ingest_slam(source, SlamParams()), "poses"))

    def rosbags() -> None:
        with Reader(file) as reader:
            rows = [
                (message.header.stamp.sec, _place(message))
                for connection, _, raw in reader.messages()
                for message in (STORE.deserialize_cdr(raw, connection.msgtype),)
            ]
        assert len(rows) == MESSAGES

    def mcap_ros2() -> None:
        with file.open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            rows = [(m.header.stamp.sec, _place(m)) for *_, m in reader.iter_decoded_messages()]
        assert len(rows) == MESSAGES

    mine, theirs, other = best_cpu_s(ours), best_cpu_s(rosbags, 1), best_cpu_s(mcap_ros2, 1)
    show(
        f"MCAP with {MESSAGES:,} NavSatFix and Odometry messages into Parquet columns",
        [
            ("FlexMap", f"{MESSAGES / mine:,.0f} messages/s", f"at least {COLUMNS_PER_S:,} messages/s"),
            ("rosbags, into a list", f"{MESSAGES / theirs:,.0f} messages/s", ""),
            ("mcap_ros2, into a list", f"{MESSAGES / other:,.0f} messages/s", ""),
            ("FlexMap beside rosbags", f"{theirs / mine:.1f} times", f"at least {COLUMNS_ROSBAGS} times"),
            ("FlexMap beside mcap_ros2", f"{other / mine:.1f} times", f"at least {COLUMNS_MCAP_ROS2} times"),
        ],
    )


def _place(message: Any) -> tuple[float, float, float]:
    """What a reader of tracks would keep."""
    if hasattr(message, "latitude"):
        return message.latitude, message.longitude, message.altitude
    at = message.pose.pose.position
    return at.x, at.y, at.z


def _tracks() -> dict[str, tuple[str, Iterator[Stamped]]]:
    rng, stamp = np.random.default_rng(1), T0 + np.arange(EACH) * STEP
    places = rng.normal(size=(EACH, 3)) * 0.01 + [11.669, 48.264, 480.0]
    turn = rng.normal(size=(EACH, 4))
    turn /= np.linalg.norm(turn, axis=1)[:, None]
    fixes = nav_sat_fixes(stamp, stamp, places, np.full((EACH, 3), 0.02), np.full(EACH, 2), "gnss")
    poses = odometries(stamp, stamp, rng.normal(size=(EACH, 3)) * 100, turn, "map", "base_link")
    return {"/fix": ("sensor_msgs/msg/NavSatFix", fixes), "/odom": ("nav_msgs/msg/Odometry", poses)}


def _scans(file: Path) -> None:
    _write_scans(file)
    size_gb = file.stat().st_size / 1e9

    def ours() -> int:
        return sum(len(scan.records) for _, scan in ScanSource(Source(file.name, file), None).scans())

    def rosbags() -> int:
        with Reader(file) as reader:
            return sum(
                len(STORE.deserialize_cdr(raw, connection.msgtype).data.view(POINT))  # type: ignore[attr-defined]
                for connection, _, raw in reader.messages()
            )

    def mcap() -> int:
        with file.open("rb") as stream:
            return sum(len(m.data) // POINT.itemsize for _, _, m in make_reader(stream).iter_messages())

    assert ours() == rosbags() == SCANS * POINTS
    mine, theirs, bare = best_cpu_s(ours), best_cpu_s(rosbags), best_cpu_s(mcap)
    show(
        f"MCAP with {SCANS} PointCloud2 of {POINTS:,} points ({size_gb:.2f} GB, not packed), from page cache",
        [
            (
                "FlexMap, points as arrays",
                f"{size_gb / mine:.2f} GB/s",
                f"at least {SCANS_GB_S:g} GB/s, above rosbags",
            ),
            ("rosbags, points as arrays", f"{size_gb / theirs:.2f} GB/s", ""),
            ("mcap, bytes of the messages alone", f"{size_gb / bare:.2f} GB/s", ""),
        ],
    )


def _write_scans(file: Path) -> None:
    """Chunks without compression, with checksums, as a lidar's recorder writes them."""
    kind, points = "sensor_msgs/msg/PointCloud2", np.zeros(POINTS, POINT)
    points["x"] = np.random.default_rng(1).normal(size=POINTS)
    with file.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE, chunk_size=8 << 20)
        writer.start(profile="ros2")
        schema = writer.register_schema(kind, "ros2msg", DEFINITIONS[kind].encode())
        channel = writer.register_channel("/points", "cdr", schema)
        for k in range(SCANS):
            stamp = T0 + k * STEP
            writer.add_message(channel, stamp, point_cloud2(stamp, "lidar", points), stamp, k)
        writer.finish()  # type: ignore[no-untyped-call]
