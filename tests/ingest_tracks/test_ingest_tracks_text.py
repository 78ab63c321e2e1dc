"""Text tracks: what is written is read, and a bad line is named with its rule and a good sample."""

from __future__ import annotations

import numpy as np
import pytest
from evo.tools import file_interface
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from flexmap_tasks.config import GnssParams, SlamParams
from flexmap_tasks.errors import InputError
from flexmap_tasks.ingest.gnss import ingest_gnss
from flexmap_tasks.ingest.slam import ingest_slam
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import STATUS_UNKNOWN

KITTI = "1 0 0 {} 0 1 0 2 0 0 1 3\n"
TUM = "{} {} 2 3 0 0 0 1\n"
SETTINGS = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def saved(tmp_path, text):
    file = tmp_path / "track.txt"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return Source("track.txt", file)


def test_the_garching_fixes(shared_data):
    fixes = ingest_gnss(Source("gps", shared_data / "garching" / "route_1_GPS.txt"), GnssParams())
    assert len(fixes) == 13646
    assert fixes.stamp_ns is None
    assert (fixes.status == STATUS_UNKNOWN).all()
    assert np.isnan(fixes.alt_m).all()
    assert np.isnan(fixes.sigma_east_m).all()
    assert (fixes.lat_deg[0], fixes.lon_deg[0]) == (48.264367644601826, 11.669079695833185)


def test_the_garching_poses_agree_with_evo(shared_data):
    file = shared_data / "garching" / "route1_pose_kitti.txt"
    poses = ingest_slam(Source("slam", file), SlamParams())
    judge = file_interface.read_kitti_poses_file(file)
    assert len(poses) == 1208
    np.testing.assert_array_equal(poses.xyz_m, judge.positions_xyz)
    turn = (
        Rotation.from_quat(poses.quaternion)
        * Rotation.from_quat(judge.orientations_quat_wxyz[:, [1, 2, 3, 0]]).inv()
    )
    assert turn.magnitude().max() < 1e-7


@SETTINGS
@given(st.lists(st.tuples(st.floats(-90, 90), st.floats(-180, 180)), min_size=1, max_size=30))
def test_fixes_as_written_are_read(tmp_path, places):
    text = "".join(f"{lat!r}\t{lon!r}\r\n" for lat, lon in places)
    fixes = ingest_gnss(saved(tmp_path, "# lat lon\n\n" + text), GnssParams())
    np.testing.assert_array_equal(fixes.lat_deg, [lat for lat, _ in places])
    np.testing.assert_array_equal(fixes.lon_deg, [lon for _, lon in places])


@SETTINGS
@given(st.lists(st.tuples(*[st.floats(-1e5, 1e5)] * 3, *[st.floats(-3, 3)] * 3), min_size=1, max_size=20))
def test_kitti_as_written_is_read(tmp_path, poses):
    poses = [*poses, *((float(i), 0.5, 0.25, 0.1, 0.2, 0.3) for i in range(3))]
    turns = Rotation.from_euler("xyz", [p[3:] for p in poses])
    rows = [np.column_stack([m, p[:3]]).ravel() for m, p in zip(turns.as_matrix(), poses, strict=True)]
    text = "".join(" ".join(map(repr, row.tolist())) + "\n" for row in rows)
    read = ingest_slam(saved(tmp_path, text), SlamParams())
    np.testing.assert_array_equal(read.xyz_m, [p[:3] for p in poses])
    assert (Rotation.from_quat(read.quaternion) * turns.inv()).magnitude().max() < 1e-7
    assert read.stamp_ns is None


@SETTINGS
@given(st.lists(st.integers(0, 2 * 10**18), min_size=3, max_size=20, unique=True))
def test_tum_stamps_are_exact_to_the_nanosecond_and_sorted(tmp_path, stamps):
    text = "# stamp tx ty tz qx qy qz qw\n"
    text += "".join(TUM.format(f"{s // 10**9}.{s % 10**9:09d}", i) for i, s in enumerate(stamps))
    read = ingest_slam(saved(tmp_path, text), SlamParams())
    np.testing.assert_array_equal(read.stamp_ns, sorted(stamps))
    np.testing.assert_array_equal(read.xyz_m[:, 0], np.argsort(stamps))


def test_tum_with_exponents_comments_and_double_stamps(tmp_path):
    text = "1.5e0 1 0 0 0 0 0 1 # one\n1.5 9 0 0 0 0 0 1\n\n2 2 0 0 0 0 0 0.999\n3 3 0 0 0 0 0 -1\n"
    read = ingest_slam(saved(tmp_path, text), SlamParams(format="tum"))
    np.testing.assert_array_equal(read.stamp_ns, [1_500_000_000, 2 * 10**9, 3 * 10**9])
    np.testing.assert_array_equal(read.xyz_m[:, 0], [1, 2, 3])
    np.testing.assert_array_equal(read.quaternion[:, 3], [1, 1, -1])


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("lat lon\n48 11\n", r'line 1: expected numbers, got "lat lon" \(a header line\? remove it\); a line is "lat lon"'),
        ("48 11\n48,5 11,5\n", 'line 2: expected numbers, got "48,5 11,5"; .*decimal points'),
        ("48,11\n", 'line 1: expected 2 numbers, got "48,11"; .*such as "48.264367 11.669079"'),
        ("48 11\n\n# x\n48 11 500\n", 'line 4: expected 2 numbers, got "48 11 500"'),
        ("48 11\n48 nan\n", 'line 2: the number must be finite, got "48 nan"'),
        ("48 11\n-inf 11\n", "line 2: the number must be finite"),
        ("48 11\n1e999 11\n", "line 2: the number must be finite"),
        ("48 1_1\n", "line 1: expected numbers"),
        ("48 11\n111.5 48.1\n", r"line 2: latitude 111.5 is outside -90..90 \(latitude and longitude look swapped\)"),
        ("48 11\n48 181\n", r"line 2: longitude 181 is outside -180..180; a line is"),
        ("48 11\n95 200\n", r"line 2: latitude 95 is outside -90..90; a line is"),
        ("\n# only a comment\n", "the file holds no line with data"),
        (b"48 11\n\xff\xfe 3\n", "byte 6: the file is neither MCAP nor UTF-8 text"),
        ("48 " * 500, r"line 1: expected 2 numbers, got \"48 .*\.\.\.\""),
    ],
)  # fmt: skip
def test_bad_fixes(tmp_path, text, match):
    with pytest.raises(InputError, match=match) as caught:
        ingest_gnss(saved(tmp_path, text), GnssParams())
    assert str(caught.value).startswith("track.txt")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("48 11\n", r"line 1: expected poses in 12 columns \(KITTI\) or 8 \(TUM\)"),
        (KITTI.format(0) + "1 0 0 0 0 1 0 0 0 0 1\n", "line 2: expected 12 numbers"),
        (KITTI.format(0) + "1 0 0 0 0 1 0 0 0 0 1.1 0\n", r"line 2: .*must be a rotation matrix, this one misses orthonormality by 0.21"),
        (KITTI.format(0) + "1 0 0 0 0 1 0 0 0 0 -1 0\n", r"line 2: .*this one mirrors; a line is the 3x4 pose matrix"),
        (KITTI.format(0) + "0 0 0 0 0 0 0 0 0 0 0 0\n", "line 2: .*rotation"),
        (KITTI.format(0) + "1e300 0 0 0 0 1 0 0 0 0 1 0\n", "line 2: .*rotation"),
        (KITTI.format(0) + KITTI.format("nan"), "line 2: the number must be finite"),
        (KITTI.format(0) * 9 + KITTI.format(1), "at least 3 distinct positions, got 10"),
        (TUM.format(1, 0) + "2 0 0 0 0 0 0 0\n", r"line 2: the quaternion x y z w must have length 1, this one has 0; a line is"),
        (TUM.format(1, 0) + "2 0 0 0 0.1 -0.1 2 0\n", "line 2: the quaternion"),
        (TUM.format(-1, 0), "line 1: the time must be seconds since the epoch, got -1"),
        (TUM.format(1e18, 0), "line 1: the time must be seconds"),
        (TUM.format(5, 0) + TUM.format(5, 1) + TUM.format(5, 2), "got 3 poses and 1 distinct stamps"),
        ("timestamp x y z qx qy qz qw\n" + TUM.format(1, 2), r"line 1: .*a header line\?"),
    ],
)  # fmt: skip
def test_bad_poses(tmp_path, text, match):
    with pytest.raises(InputError, match=match):
        ingest_slam(saved(tmp_path, text), SlamParams())


def test_a_format_that_the_user_names_is_kept_to(tmp_path):
    tum = saved(tmp_path, "".join(TUM.format(i, i) for i in range(4)))
    assert len(ingest_slam(tum, SlamParams(format="tum"))) == 4
    with pytest.raises(InputError, match="expected 12 numbers"):
        ingest_slam(tum, SlamParams(format="kitti"))
    with pytest.raises(InputError, match="does not start like MCAP"):
        ingest_slam(tum, SlamParams(format="mcap"))
    with pytest.raises(InputError, match="does not start like MCAP"):
        ingest_gnss(tum, GnssParams(format="mcap"))
    mcap = saved(tmp_path, b"\x89MCAP0\r\n")
    with pytest.raises(InputError, match="the file is MCAP: use auto"):
        ingest_slam(mcap, SlamParams(format="tum"))
    with pytest.raises(InputError, match="the file is MCAP: use auto"):
        ingest_gnss(mcap, GnssParams(format="text"))


@SETTINGS
@given(st.binary(max_size=300))
def test_any_bytes_end_in_a_table_or_one_line(tmp_path, data):
    for read in (lambda s: ingest_gnss(s, GnssParams()), lambda s: ingest_slam(s, SlamParams())):
        try:
            assert len(read(saved(tmp_path, data))) > 0
        except InputError as error:
            assert str(error).startswith("track.txt")  # noqa: PT017 - either outcome is right
