"""MCAP recordings against the values that were written by rosbags, protobuf and the mcap writer."""

from __future__ import annotations

import ingest_track_recordings as rec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ingest_track_recordings import Layout
from mcap.reader import make_reader
from mcap.writer import CompressionType

from flexmap_tasks.config import GnssParams, SlamParams
from flexmap_tasks.errors import InputError
from flexmap_tasks.ingest.gnss import ingest_gnss
from flexmap_tasks.ingest.slam import ingest_slam
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import STATUS_UNKNOWN

T0 = 1_700_000_000_123_456_789
STEP = 100_000_000
LAYOUTS = [
    Layout(compression=c, chunked=chunked, index=index, summary=summary, chunk_size=300)
    for c in (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD)
    for chunked in (True, False)
    for index in (True, False)
    for summary in (True, False)
]


def source(path):
    return Source(path.name, path)


def gnss(path, **params):
    return ingest_gnss(source(path), GnssParams(**params))


def slam(path, **params):
    return ingest_slam(source(path), SlamParams(**params))


def some_fixes(n=7):
    return [
        rec.fix(T0 + i * STEP, (48.0 + i * 1e-5, 11.0 - i * 1e-5, 500.0 + i), "g" * (i % 4)) for i in range(n)
    ]


def values(i):
    turn = np.array([0.1 * i, 0.2, -0.3, 1.0])
    return [float(i), i * 0.5, -i * 0.25, *(turn / np.linalg.norm(turn)).tolist()]


def some_odometry(n=7):
    return [rec.odometry(T0 + i * STEP, values(i), "odom"[: i % 5], "base"[: (i * 3) % 5]) for i in range(n)]


def interleaved():
    for i, (a, b) in enumerate(zip(some_fixes(), some_odometry(), strict=True)):
        yield rec.ros_record("/fix", T0 + i, a)
        yield rec.ros_record("/odom", T0 + i, b)


def expected_poses(n=7):
    return np.array([values(i) for i in range(n)])


@pytest.mark.parametrize("layout", LAYOUTS, ids=str)
def test_every_layout_gives_the_same_tables(tmp_path, layout):
    file = rec.write(tmp_path / "a.mcap", interleaved(), layout)
    fixes, poses = gnss(file), slam(file)
    stamps = T0 + STEP * np.arange(7)
    np.testing.assert_array_equal(fixes.stamp_ns, stamps)
    np.testing.assert_array_equal(fixes.lat_deg, [48.0 + i * 1e-5 for i in range(7)])
    np.testing.assert_array_equal(fixes.lon_deg, [11.0 - i * 1e-5 for i in range(7)])
    np.testing.assert_array_equal(fixes.alt_m, 500.0 + np.arange(7))
    np.testing.assert_array_equal(fixes.sigma_east_m, np.full(7, 1.0))
    np.testing.assert_array_equal(fixes.sigma_north_m, np.full(7, 2.0))
    np.testing.assert_array_equal(fixes.sigma_up_m, np.full(7, 3.0))
    np.testing.assert_array_equal(fixes.status, np.full(7, 2))
    np.testing.assert_array_equal(poses.stamp_ns, stamps)
    np.testing.assert_allclose(np.hstack([poses.xyz_m, poses.quaternion]), expected_poses(), rtol=1e-15)


def test_big_and_little_endian_mix(tmp_path):
    messages = [rec.ros_record("/odom", T0, m, little=i % 3 > 0) for i, m in enumerate(some_odometry())]
    poses = slam(rec.write(tmp_path / "a.mcap", messages))
    np.testing.assert_allclose(np.hstack([poses.xyz_m, poses.quaternion]), expected_poses(), rtol=1e-15)
    np.testing.assert_array_equal(poses.stamp_ns, T0 + STEP * np.arange(7))


@pytest.mark.parametrize("make", [rec.pose_stamped, rec.pose_cov_stamped])
@pytest.mark.parametrize("short_name", [True, False])
def test_other_pose_messages(tmp_path, make, short_name):
    records = [rec.ros_record("/pose", T0, make(T0 + i * STEP, values(i))) for i in range(5)]
    if short_name:
        for record in records:
            record.kind = record.kind.replace("/msg/", "/")
    poses = slam(rec.write(tmp_path / "a.mcap", records))
    np.testing.assert_allclose(np.hstack([poses.xyz_m, poses.quaternion]), expected_poses(5), rtol=1e-15)


def test_the_longest_path_is_taken_and_of_equal_ones_the_last(tmp_path):
    def made(n, shift):
        poses = [rec.pose_stamped(T0 + i * STEP, values(i + shift), "map"[: i % 4]) for i in range(n)]
        return rec.ros_record("/path", T0, rec.path(T0, poses), little=shift % 2 == 0)

    file = rec.write(tmp_path / "a.mcap", [made(3, 0), made(5, 1), made(5, 2), made(4, 0)])
    poses = slam(file)
    np.testing.assert_array_equal(poses.xyz_m[:, 0], np.arange(2, 7))
    np.testing.assert_array_equal(poses.stamp_ns, T0 + STEP * np.arange(5))


@pytest.mark.parametrize("stamps", [[0, 0, 0], [T0, T0, T0], [0, T0, T0 + 1]])
def test_a_path_without_a_time_for_each_pose_has_no_time(tmp_path, stamps):
    path = rec.path(T0, [rec.pose_stamped(s, values(i)) for i, s in enumerate(stamps)])
    poses = slam(rec.write(tmp_path / "a.mcap", [rec.ros_record("/path", T0, path)]))
    assert poses.stamp_ns is None
    assert len(poses) == 3


def test_a_frame_pair_of_transforms(tmp_path):
    def message(i):
        items = [
            rec.transform(T0 + i * STEP, values(i + 50), "base", "wheel"),
            rec.transform(T0 + i * STEP, values(i), "map" if i % 2 else "/map", "base"),
        ]
        return rec.ros_record("/tf", T0, rec.transforms(items[i % 3 == 0 :]), little=i != 2)

    static = rec.ros_record("/tf_static", T0, rec.transforms([rec.transform(T0, values(0), "base", "lidar")]))
    file = rec.write(tmp_path / "a.mcap", [static, *(message(i) for i in range(6))])
    poses = slam(file, parent_frame="map", child_frame="base")
    np.testing.assert_allclose(np.hstack([poses.xyz_m, poses.quaternion]), expected_poses(6), rtol=1e-15)
    with pytest.raises(
        InputError, match=r"no transform map -> moon; /tf has .*base -> wheel.*/tf_static has base -> lidar"
    ):
        slam(file, parent_frame="map", child_frame="moon")
    with pytest.raises(
        InputError, match=r"needs slam\.parent_frame and slam\.child_frame; frames are: .*map -> base"
    ):
        slam(file, topic="/tf")
    with pytest.raises(InputError, match="give both or none"):
        slam(file, parent_frame="map")


def test_one_pair_on_two_topics_needs_a_choice(tmp_path):
    records = [
        rec.ros_record(topic, T0, rec.transforms([rec.transform(T0 + i, values(i), "map", "base")]))
        for topic in ("/a/tf", "/b/tf") for i in range(3)
    ]  # fmt: skip
    file = rec.write(tmp_path / "a.mcap", records)
    with pytest.raises(InputError, match="name one of /a/tf, /b/tf"):
        slam(file, parent_frame="map", child_frame="base")
    assert len(slam(file, topic="/b/tf", parent_frame="map", child_frame="base")) == 3


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_foxglove_location_fix(tmp_path, encoding):
    def record(i):
        content = {
            "timestamp": {"sec": 1_700_000_000 + i, "nsec": 5}, "frame_id": "g" * i, "latitude": 48.5 + i,
            "longitude": 0.0, "altitude": 7.0, "position_covariance": [4.0, 0, 0, 0, 9.0, 0, 0, 0, 16.0],
            "position_covariance_type": 2 if i else 0,
        }  # fmt: skip
        return rec.foxglove_record("/fix", "LocationFix", T0, content, encoding)

    fixes = gnss(rec.write(tmp_path / "a.mcap", [record(i) for i in range(3)]))
    np.testing.assert_array_equal(fixes.lat_deg, [48.5, 49.5, 50.5])
    np.testing.assert_array_equal(fixes.lon_deg, 0.0)
    np.testing.assert_array_equal(fixes.sigma_north_m, [np.nan, 3.0, 3.0])
    np.testing.assert_array_equal(fixes.stamp_ns, [(1_700_000_000 + i) * 10**9 + 5 for i in range(3)])
    assert (fixes.status == STATUS_UNKNOWN).all()


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_foxglove_poses(tmp_path, encoding):
    def pose(i):
        v = values(i)
        return {
            "position": dict(zip("xyz", v[:3], strict=True)),
            "orientation": dict(zip("xyzw", v[3:], strict=True)),
        }

    single = [
        rec.foxglove_record(
            "/p", "PoseInFrame", T0 + i, {"timestamp": {"sec": 0, "nsec": 0}, "frame_id": "m", "pose": pose(i)}, encoding
        )
        for i in range(4)
    ]  # fmt: skip
    poses = slam(rec.write(tmp_path / "a.mcap", single))
    np.testing.assert_allclose(np.hstack([poses.xyz_m, poses.quaternion]), expected_poses(4), rtol=1e-15)
    np.testing.assert_array_equal(poses.stamp_ns, T0 + np.arange(4))  # log time, as no stamp is set
    many = [
        rec.foxglove_record(
            "/p", "PosesInFrame", T0, {"timestamp": {"sec": 9, "nsec": 0}, "frame_id": "m", "poses": list(map(pose, range(n)))}, encoding
        )
        for n in (3, 5, 4)
    ]  # fmt: skip
    poses = slam(rec.write(tmp_path / "b.mcap", many))
    np.testing.assert_allclose(np.hstack([poses.xyz_m, poses.quaternion]), expected_poses(5), rtol=1e-15)
    assert poses.stamp_ns is None


def test_log_time_stands_in_for_a_missing_stamp_and_rows_are_sorted(tmp_path):
    stamps = [T0 + 30, 0, T0 + 10, T0 + 10, T0]
    logs = [T0 + 31, T0 + 20, T0 + 11, T0 + 12, T0 + 1]
    places = [(48.0, 11.0, float(i)) for i in range(5)]
    records = [
        rec.ros_record("/fix", log, rec.fix(s, p)) for s, log, p in zip(stamps, logs, places, strict=True)
    ]
    fixes = gnss(rec.write(tmp_path / "a.mcap", records))
    np.testing.assert_array_equal(fixes.stamp_ns, [T0, T0 + 10, T0 + 20, T0 + 30])
    np.testing.assert_array_equal(fixes.alt_m, [4.0, 2.0, 1.0, 0.0])


def test_a_missing_stamp_is_put_onto_the_clock_of_the_others(tmp_path):
    ahead = 10**18
    stamps = [0, 10, 20, 30]
    records = [
        rec.ros_record("/fix", ahead + 10 * i, rec.fix(s, (48.0, 11.0, float(i))))
        for i, s in enumerate(stamps, start=1)
    ]
    fixes = gnss(rec.write(tmp_path / "a.mcap", records))
    np.testing.assert_array_equal(fixes.stamp_ns, [0, 10, 20, 30])
    np.testing.assert_array_equal(fixes.alt_m, [1.0, 2.0, 3.0, 4.0])


def test_control_characters_do_not_reach_the_terminal(tmp_path):
    records = [rec.ros_record(topic, T0, some_fixes(1)[0]) for topic in ("/a\n\x1b[31m", "/b")]
    with pytest.raises(InputError) as caught:
        gnss(rec.write(tmp_path / "a.mcap", records))
    assert str(caught.value).isprintable()


def test_fixes_without_position_stay_marked_and_unknown_covariance_is_nan(tmp_path):
    nan = float("nan")
    messages = [
        rec.fix(T0, (48.0, 11.0, 1.0), cov_type=0),
        rec.fix(T0 + 1, (nan, nan, nan), status=0),
        rec.fix(T0 + 2, (0.0, 500.0, 1.0), status=-1),
        rec.fix(T0 + 3, (48.0, 11.0, nan), status=-1),
        rec.fix(T0 + 4, (48.0, 11.0, 2.0), cov=np.diag([0.0, nan, -1.0]).ravel()),
    ]
    fixes = gnss(rec.write(tmp_path / "a.mcap", [rec.ros_record("/fix", T0, m) for m in messages]))
    np.testing.assert_array_equal(fixes.status, [2, -1, -1, -1, 2])
    np.testing.assert_array_equal(fixes.lat_deg, [48, nan, nan, 48, 48])
    np.testing.assert_array_equal(fixes.lon_deg, [11, nan, nan, 11, 11])
    np.testing.assert_array_equal(fixes.sigma_up_m, [nan, 3, 3, 3, nan])
    assert np.isnan(fixes.sigma_east_m[[0, 4]]).all()
    assert np.isnan(fixes.sigma_north_m[4])


@pytest.mark.parametrize(
    ("messages", "match"),
    [
        ([rec.fix(T0, (48.0, 11.0, 0.0)), rec.fix(T0, (111.5, 48.0, 0.0))], r"/fix message 2: latitude 111.5 .*look swapped"),
        ([rec.fix(T0, (48.0, 211.0, 0.0))], "/fix message 1: longitude 211 is outside"),
        ([rec.fix(T0, (48.0, 11.0, 0.0), status=-1)], "none of 1 rows has a fix"),
    ],
)  # fmt: skip
def test_bad_fixes(tmp_path, messages, match):
    file = rec.write(tmp_path / "a.mcap", [rec.ros_record("/fix", T0, m) for m in messages])
    with pytest.raises(InputError, match=match):
        gnss(file)


@pytest.mark.parametrize(
    ("poses", "match"),
    [
        ([values(0), values(1)], "at least 3 distinct positions, got 2"),
        ([values(0), values(1), values(0), values(1)], "at least 3 distinct positions, got 4"),
        ([values(0), [1.0, 0, 0, 0, 0, 0, 0], values(2)], "message 2: the quaternion .* has 0"),
        ([values(0), [1.0, 0, float("nan"), 0, 0, 0, 1]], "message 2: every number of a pose must be finite"),
        ([[0.0, 0, 0, 0.1, -0.2, 3.1, 0]], "message 1: the quaternion .* has 3.1"),
    ],
)
def test_bad_poses(tmp_path, poses, match):
    messages = [
        rec.ros_record("/p", T0, rec.pose_stamped(T0 + i, [*map(float, p)])) for i, p in enumerate(poses)
    ]
    with pytest.raises(InputError, match=match):
        slam(rec.write(tmp_path / "a.mcap", messages))


def test_topics_are_listed_when_none_or_several_fit(tmp_path):
    records = [rec.ros_record("/a", T0, f) for f in some_fixes(2)] + [
        rec.ros_record("/b", T0, f) for f in some_fixes(3)
    ]
    file = rec.write(tmp_path / "a.mcap", records)
    with pytest.raises(
        InputError,
        match=r"several topics .*`gnss.topic`.*/a \(sensor_msgs/NavSatFix, 2 messages\); /b .*3 messages",
    ):
        gnss(file)
    assert len(gnss(file, topic="/b")) == 3
    with pytest.raises(
        InputError, match=r"no topic holds SLAM poses.*nav_msgs/Odometry.*topics are: /a .*/b "
    ):
        slam(file)
    with pytest.raises(InputError, match=r"there is no topic /c; topics are: /a"):
        gnss(file, topic="/c")
    with pytest.raises(InputError, match=r"/a \(sensor_msgs/NavSatFix, 2 messages\) holds no SLAM poses"):
        slam(file, topic="/a")
    with pytest.raises(InputError, match="the file has no topics"):
        gnss(rec.write(tmp_path / "b.mcap", []))


def test_the_real_recording_agrees_with_rosbags(shared_data):
    file = shared_data / "mcap" / "nav2_turtlebot.mcap"
    for topic, count in (("/odom", 2639), ("/amcl_pose", 135)):
        poses = slam(file, topic=topic)
        with file.open("rb") as stream:
            read = [
                rec.ROS.deserialize_cdr(message.data, schema.name)
                for schema, _, message in make_reader(stream).iter_messages(topics=[topic])
            ]
        position = [(m.pose.pose.position.x, m.pose.pose.position.y, m.pose.pose.position.z) for m in read]
        stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in read]
        assert len(poses) == count == len(read)
        np.testing.assert_array_equal(poses.xyz_m, position)
        np.testing.assert_array_equal(poses.stamp_ns, stamps)
    poses = slam(file, parent_frame="odom", child_frame="base_link")
    with file.open("rb") as stream:
        messages = [
            rec.ROS.deserialize_cdr(message.data, schema.name)
            for schema, _, message in make_reader(stream).iter_messages(topics=["/tf"], log_time_order=False)
        ]
    pairs = [
        t
        for m in messages
        for t in m.transforms
        if (t.header.frame_id, t.child_frame_id) == ("odom", "base_link")
    ]
    read = {t.header.stamp.sec * 10**9 + t.header.stamp.nanosec: t.transform for t in reversed(pairs)}
    np.testing.assert_array_equal(poses.stamp_ns, sorted(read))
    moved = [read[stamp].translation for stamp in sorted(read)]
    np.testing.assert_array_equal(poses.xyz_m, [(t.x, t.y, t.z) for t in moved])
    assert len(poses) > 2000


def test_transforms_do_not_compete_with_a_topic_of_poses(tmp_path):
    transforms = [rec.ros_record("/tf", T0, rec.transforms([rec.transform(T0, values(1), "a", "b")]))]
    odometry = [rec.ros_record("/odom", T0, m) for m in some_odometry(4)]
    assert len(slam(rec.write(tmp_path / "a.mcap", transforms + odometry))) == 4
    with pytest.raises(
        InputError, match=r"/tf .* needs slam\.parent_frame and slam\.child_frame; frames are: a -> b"
    ):
        slam(rec.write(tmp_path / "b.mcap", transforms))


reals = st.floats(-1e6, 1e6)
names = st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=11)
a_fix = st.tuples(
    st.floats(-90, 90), st.floats(-180, 180), st.floats(-1e4, 1e4), st.integers(0, 2), names, st.booleans()
)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(a_fix, min_size=1, max_size=20),
    st.lists(st.tuples(reals, reals, reals, names, names), min_size=1, max_size=20),
    st.sampled_from(list(CompressionType)),
    st.integers(100, 3000),
)
def test_what_is_written_is_read(tmp_path, fixes, poses, compression, chunk_size):
    records = [
        rec.ros_record("/fix", T0, rec.fix(T0 + i, f[:3], f[4], status=f[3]), little=f[5])
        for i, f in enumerate(fixes)
    ]
    fixed = [values(0), values(1), values(2)]
    odometry = [rec.odometry(T0 + i, v) for i, v in enumerate(fixed)]
    odometry += [rec.odometry(T0 + 3 + i, [*p[:3], 0, 0, 0, 1.0], p[3], p[4]) for i, p in enumerate(poses)]
    records += [rec.ros_record("/odom", T0, m) for m in odometry]
    file = rec.write(tmp_path / "a.mcap", records, Layout(compression=compression, chunk_size=chunk_size))
    read = gnss(file)
    np.testing.assert_array_equal(read.lat_deg, [f[0] for f in fixes])
    np.testing.assert_array_equal(read.lon_deg, [f[1] for f in fixes])
    np.testing.assert_array_equal(read.alt_m, [f[2] for f in fixes])
    np.testing.assert_array_equal(read.status, [f[3] for f in fixes])
    np.testing.assert_array_equal(slam(file).xyz_m[3:], [p[:3] for p in poses])
