"""Damaged, cut and malicious recordings end in one clear line, never in a traceback or a short table."""

from __future__ import annotations

import json
import struct
import tracemalloc
import zlib

import ingest_track_recordings as rec
import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ingest_track_recordings import Layout, Record
from mcap.writer import CompressionType

from flexmap_tasks.config import GnssParams, SlamParams
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.mcap_chunks import records
from flexmap_tasks.formats.mcap_records import MAGIC, open_recording
from flexmap_tasks.ingest.gnss import ingest_gnss
from flexmap_tasks.ingest.slam import ingest_slam
from flexmap_tasks.model.source import Source

T0 = 1_700_000_000_000_000_000
POSE = {"position": {"x": 1.0}, "orientation": {"w": 1.0}}
FUZZ = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def everything():
    """Every kind of message that can be read, a few of each."""
    for i in range(6):
        v = [float(i), 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        stamp = {"sec": 10 + i, "nsec": 0}
        yield rec.ros_record("/fix", T0 + i, rec.fix(T0 + i, (48.0, 11.0, 5.0)))
        yield rec.ros_record("/odom", T0 + i, rec.odometry(T0 + i, v))
        yield rec.ros_record(
            "/path", T0 + i, rec.path(T0, [rec.pose_stamped(T0 + k, [float(k), *v[1:]]) for k in range(4)])
        )
        yield rec.ros_record("/tf", T0 + i, rec.transforms([rec.transform(T0 + i, v, "map", "base")]))
        for encoding in ("json", "protobuf"):
            fix = {"timestamp": stamp, "latitude": 48.0, "longitude": 11.0, "altitude": 5.0}
            yield rec.foxglove_record(f"/{encoding}/fix", "LocationFix", T0 + i, fix, encoding)
            pose = {
                "position": dict(zip("xyz", v[:3], strict=True)),
                "orientation": dict(zip("xyzw", v[3:], strict=True)),
            }
            content = {"timestamp": stamp, "frame_id": "m", "pose": pose}
            yield rec.foxglove_record(f"/{encoding}/pose", "PoseInFrame", T0 + i, content, encoding)


def read_all(file):
    source = Source(file.name, file)
    for topic in ("/fix", "/json/fix", "/protobuf/fix"):
        yield lambda topic=topic: ingest_gnss(source, GnssParams(topic=topic))
    for topic in ("/odom", "/path", "/json/pose", "/protobuf/pose"):
        yield lambda topic=topic: ingest_slam(source, SlamParams(topic=topic))
    yield lambda: ingest_slam(source, SlamParams(parent_frame="map", child_frame="base"))


LAYOUTS = {
    "zstd": Layout(chunk_size=800),
    "lz4": Layout(CompressionType.LZ4, chunk_size=800),
    "plain": Layout(CompressionType.NONE, chunk_size=800, index=False, summary=False),
    "unchunked": Layout(chunked=False, data_crc=True),
    "unchunked_plain": Layout(chunked=False),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    return {
        name: rec.write(folder / f"{name}.mcap", everything(), layout).read_bytes()
        for name, layout in LAYOUTS.items()
    }


def test_the_whole_files_are_good(tmp_path, whole):
    for name, data in whole.items():
        file = tmp_path / name
        file.write_bytes(data)
        for read in read_all(file):
            assert len(read()) >= 3


@FUZZ
@given(st.sampled_from(sorted(LAYOUTS)), st.floats(0, 1, exclude_max=True))
def test_a_cut_file_is_an_error_at_every_length(tmp_path, whole, name, share):
    data = whole[name]
    file = tmp_path / "cut.mcap"
    file.write_bytes(data[: int(share * len(data))])
    for read in read_all(file):
        with pytest.raises(InputError) as caught:
            read()
        assert "cut" in str(caught.value) or "empty" in str(caught.value)


@FUZZ
@given(
    st.sampled_from(sorted(LAYOUTS)),
    st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=4),
)
def test_changed_bytes_never_end_in_a_traceback(tmp_path, whole, name, changes):
    data = bytearray(whole[name])
    for share, value in changes:
        data[int(share * len(data))] = value
    file = tmp_path / "changed.mcap"
    file.write_bytes(data)
    for read in read_all(file):
        try:
            table = read()
        except InputError as error:
            lines = str(error).splitlines()
            assert len(lines) == 1, lines
        else:
            assert len(table) > 0


def test_a_cut_file_says_how_much_stands_before_the_cut(tmp_path, whole):
    file = tmp_path / "cut.mcap"
    data = whole["unchunked"]
    file.write_bytes(data[: data.index(b"\x0f" + struct.pack("<Q", 4)) - 1])
    with pytest.raises(
        InputError, match=r"cut\.mcap byte [\d,]+ of [\d,]+: the MCAP file is cut off .*; 47 whole messages"
    ):
        ingest_gnss(Source("cut.mcap", file), GnssParams())


@pytest.mark.parametrize("name", ["zstd", "lz4"])
def test_a_flipped_bit_in_a_chunk_is_seen(tmp_path, whole, name):
    data = bytearray(whole[name])
    data[data.index(name.encode()) + 40] ^= 1
    file = tmp_path / "flip.mcap"
    file.write_bytes(data)
    with pytest.raises(InputError, match=r"chunk at byte \d+: the MCAP file is damaged"):
        ingest_gnss(Source("flip.mcap", file), GnssParams(topic="/fix"))


def test_a_flipped_bit_in_an_unchunked_file_is_seen_by_the_checksum_of_the_data(tmp_path, whole):
    data = bytearray(whole["unchunked"])
    at = data.index(struct.pack("<d", 48.0))
    data[at] ^= 1
    file = tmp_path / "flip.mcap"
    file.write_bytes(data)
    with pytest.raises(InputError, match=r"a checksum .* does not agree"):
        ingest_gnss(Source("flip.mcap", file), GnssParams(topic="/fix"))


def record(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


def with_chunk(tmp_path, size, name, packed, crc=0):
    chunk = struct.pack("<QQQII", 0, 0, size, crc, len(name)) + name + struct.pack("<Q", len(packed)) + packed
    footer = record(2, struct.pack("<QQI", 0, 0, 0))
    file = tmp_path / "bomb.mcap"
    file.write_bytes(MAGIC + record(1, struct.pack("<II", 0, 0)) + record(6, chunk) + footer + MAGIC)
    return file


def zeros(size):
    return zstandard.ZstdCompressor().compress(bytes(size))


@pytest.mark.parametrize(
    ("size", "name", "packed", "match"),
    [
        (1 << 60, b"", b"abc", "claims to unpack from 3 to"),
        (1 << 60, b"zstd", zeros(1000), "claims to unpack"),
        (900 << 20, b"zstd", zeros(900 << 20), "claims to unpack"),
        (100, b"zstd", zeros(300 << 20), r"unpacks to 314,572,800 bytes and not to 100"),
        (100, b"lz4", lz4.frame.compress(bytes(300 << 20)), "unpacks to 101 bytes and not to 100"),
        (1 << 20, b"lz4", lz4.frame.compress(bytes(100)), "unpacks to 100 bytes and not to 1,048,576"),
        (3, b"", b"abcd", "unpacks to 4 bytes and not to 3"),
        (3, b"", b"abc", "the last record of the chunk is cut off"),
        (3, b"brotli", b"abc", "compression b'brotli' is unknown; known are none, lz4 and zstd"),
        (3, b"zstd", b"abc", "does not unpack"),
        (3, b"lz4", b"abcdefgh", "does not unpack"),
    ],
)
def test_chunks_that_lie_about_their_size(tmp_path, size, name, packed, match):
    file = with_chunk(tmp_path, size, name, packed)
    tracemalloc.start()
    with pytest.raises(InputError, match=match):
        open_recording("bomb.mcap", file)
    assert tracemalloc.get_traced_memory()[1] < 80 << 20
    tracemalloc.stop()


def test_a_wrong_checksum_of_a_chunk_is_seen(tmp_path):
    content = record(5, bytes(22))
    file = with_chunk(tmp_path, len(content), b"", content, crc=zlib.crc32(content) ^ 1)
    with pytest.raises(InputError, match="checksum"):
        open_recording("bomb.mcap", file)


def test_messages_of_a_channel_that_is_nowhere_described(tmp_path):
    content = record(5, struct.pack("<H", 77) + bytes(20))
    file = with_chunk(tmp_path, len(content), b"", content)
    with pytest.raises(InputError, match="messages of unknown channel 77"):
        open_recording("bomb.mcap", file)


def big_counts():
    good = rec.cdr(rec.path(T0, []))
    yield "nav_msgs/msg/Path", good[:-4] + struct.pack("<I", 0xFFFFFFFF)
    frame = rec.cdr(rec.odometry(T0, [0.0] * 7))
    yield "nav_msgs/msg/Odometry", frame[:12] + struct.pack("<I", 0xFFFFFFFF) + frame[16:]
    yield "nav_msgs/msg/Odometry", frame[:90]
    yield "nav_msgs/msg/Odometry", b""
    yield "nav_msgs/msg/Odometry", b"\x00\x03" + frame[2:]


@pytest.mark.parametrize(("kind", "payload"), list(big_counts()))
def test_messages_that_claim_more_than_they_hold(tmp_path, kind, payload):
    file = rec.write(tmp_path / "a.mcap", [Record("/t", kind, T0, payload)])
    with pytest.raises(InputError, match=r"topic /t message 1: .* no valid nav_msgs/"):
        ingest_slam(Source("a.mcap", file), SlamParams())


def test_transforms_that_claim_more_than_they_hold(tmp_path):
    payload = b"\x00\x01\x00\x00" + struct.pack("<I", 0xFFFFFFFF) + bytes(200)
    file = rec.write(tmp_path / "a.mcap", [Record("/tf", "tf2_msgs/msg/TFMessage", T0, payload)])
    with pytest.raises(InputError, match="cut off"):
        ingest_slam(Source("a.mcap", file), SlamParams(parent_frame="a", child_frame="b"))
    with pytest.raises(InputError, match="unreadable"):
        ingest_slam(Source("a.mcap", file), SlamParams())


@pytest.mark.parametrize(
    "payload",
    [
        b"", b"[1]", b"{", b"\xff", b'{"pose": 3}', b'{"pose": {"position": {"x": "a"}, "orientation": {}}}', b"[" * 100_000,
        b'{"pose": {"position": {"x": 1' + b"0" * 5000 + b'}, "orientation": {}}}', json.dumps({"pose": None}).encode(),
        b'{"timestamp": {"sec": 1e999}, "pose": {}}',
    ],
)  # fmt: skip
def test_json_that_is_no_pose(tmp_path, payload):
    file = rec.write(
        tmp_path / "a.mcap", [Record("/p", "foxglove.PoseInFrame", T0, payload, "json", "jsonschema")]
    )
    with pytest.raises(InputError, match=r"topic /p message 1: .*does not fit its schema"):
        ingest_slam(Source("a.mcap", file), SlamParams())


@pytest.mark.parametrize(
    "content", [{}, {"pose": {}}, {"pose": {"position": {"x": 1, "y": 1}, "orientation": {}}}]
)
def test_json_with_fields_left_out(tmp_path, content):
    file = rec.write(tmp_path / "a.mcap", [rec.foxglove_record("/p", "PoseInFrame", T0, content, "json")])
    with pytest.raises(InputError, match=r"topic /p message 1: the field '\w+' is missing"):
        ingest_slam(Source("a.mcap", file), SlamParams())


def test_protobuf_zeros_need_not_be_written(tmp_path):
    turn = {"w": 1.0}
    poses = [
        {"orientation": turn},
        {"position": {"x": 1.0}, "orientation": turn},
        {"position": {"y": 2.0}, "orientation": turn},
    ]
    records = [
        rec.foxglove_record("/p", "PoseInFrame", T0 + i, {"pose": p}, "protobuf") for i, p in enumerate(poses)
    ]
    read = ingest_slam(Source("a.mcap", rec.write(tmp_path / "a.mcap", records)), SlamParams())
    np.testing.assert_array_equal(read.xyz_m, [[0, 0, 0], [1, 0, 0], [0, 2, 0]])


def test_an_index_that_points_astray_does_not_lose_messages(tmp_path):
    file = rec.write(tmp_path / "a.mcap", everything(), Layout(CompressionType.NONE))
    data = bytearray(file.read_bytes())
    found = 0
    for opcode, begin, end in records(bytes(data), len(MAGIC), len(data) - len(MAGIC)):
        if opcode == 7:
            found += 1
            data[begin + 6 + 8 : begin + 6 + 16] = struct.pack("<Q", (3, end, 2**63, 2**64 - 1)[found % 4])
    assert found >= 8
    before = [read() for read in read_all(file)]
    file.write_bytes(data)
    for read, table in zip(read_all(file), before, strict=True):
        np.testing.assert_array_equal(read().stamp_ns, table.stamp_ns)


@pytest.mark.parametrize("entries", [0, 1, 2, 5])
def test_an_index_and_a_chunk_that_disagree_are_an_error(tmp_path, entries):
    messages = [rec.ros_record("/fix", T0 + i, rec.fix(T0 + i, (48.0, 11.0, 5.0))) for i in range(3)]
    file = rec.write(tmp_path / "a.mcap", messages, Layout(summary=False))
    data = file.read_bytes()
    (place,) = (
        (begin, end) for opcode, begin, end in records(data, len(MAGIC), len(data) - 8) if opcode == 7
    )
    kept = data[place[0] + 6 : place[1]][: 16 * entries].ljust(16 * entries, b"\0")
    index = record(7, data[place[0] : place[0] + 2] + struct.pack("<I", len(kept)) + kept)
    file.write_bytes(data[: place[0] - 9] + index + record(2, struct.pack("<QQI", 0, 0, 0)) + MAGIC)
    with pytest.raises(
        InputError, match=r"the index promises \d messages and the chunk holds 3|no topic holds"
    ):
        ingest_gnss(Source("a.mcap", file), GnssParams())


@pytest.mark.parametrize("schema", [b"", b"\xff\xff", b"\x0a\x02\x0a\x00"])
def test_protobuf_schemas_that_describe_nothing(tmp_path, schema):
    file = rec.write(
        tmp_path / "a.mcap", [Record("/p", "foxglove.PoseInFrame", T0, b"", "protobuf", "protobuf", schema)]
    )
    with pytest.raises(
        InputError, match=r"schema foxglove.PoseInFrame: its protobuf description cannot be used"
    ):
        ingest_slam(Source("a.mcap", file), SlamParams())


def test_protobuf_fields_of_another_type(tmp_path):
    other = rec.foxglove_record("/p", "LocationFix", T0, {"latitude": 48.0}, "protobuf")
    good = rec.foxglove_record("/p", "PoseInFrame", T0, {"frame_id": "m", "pose": POSE}, "protobuf")
    good.payload = other.payload[:-1] + np.uint8(0xFF).tobytes()
    file = rec.write(tmp_path / "a.mcap", [good])
    with pytest.raises(InputError, match="topic /p message 1"):
        ingest_slam(Source("a.mcap", file), SlamParams())


def test_other_recordings_and_missing_files(tmp_path):
    for content, match in (
        (b"", "the file is empty"),
        (b"#ROSBAG V2.0\n", "ROS 1 bag"),
        (b"\x28\xb5\x2f\xfd more", "unpack it with `zstd -d`"),
        (b"SQLite format 3\0", "ROS 2 bag in SQLite"),
        (b"\x00\xff\xfe", "neither MCAP nor UTF-8 text"),
    ):
        file = tmp_path / "other"
        file.write_bytes(content)
        with pytest.raises(InputError, match=match):
            ingest_gnss(Source("other", file), GnssParams())
        with pytest.raises(InputError, match=match):
            ingest_slam(Source("other", file), SlamParams())
    with pytest.raises(InputError, match="no such file"):
        ingest_gnss(Source("none", tmp_path / "none"), GnssParams())
    with pytest.raises(InputError, match="a folder"):
        ingest_slam(Source("folder", tmp_path), SlamParams())
