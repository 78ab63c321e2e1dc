"""Scans of every layout, placed by poses and transforms; what cannot be placed is refused in one line."""

from __future__ import annotations

import base64
from pathlib import Path

import ingest_track_recordings as rec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.spatial.transform import Rotation, Slerp

from flexmap_tasks.config import PointCloudParams, ScanParams, ScanTilesParams, SlamParams
from flexmap_tasks.errors import AlignmentError, FlexMapError, InputError
from flexmap_tasks.geometry.scan_time import NS_PER_S, point_clock
from flexmap_tasks.geometry.se3 import Poses, compose, interpolate, inverse, place_points
from flexmap_tasks.ingest.scans import ingest_scans
from flexmap_tasks.ingest.slam import ingest_slam
from flexmap_tasks.model.clouds import PointCloud, Tiles
from flexmap_tasks.model.source import Source

T0 = 1_700_000_000 * NS_PER_S
POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4"), ("ring", "<u2"), ("vec", "<f4", (2,))]
)
KINDS = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
STILL = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


def sweep(number: int, points: int = 40) -> np.ndarray:
    rng = np.random.default_rng(number)
    out = np.zeros(points, POINT)
    for axis in "xyz":
        out[axis] = rng.uniform(-20, 20, points)
    out["t"] = np.linspace(0, 90_000_000, points).astype("u4")
    out["ring"], out["vec"] = np.arange(points), rng.normal(size=(points, 2))
    return out


def scan(
    stamp_ns: int, points: np.ndarray, frame: str = "lidar", big: bool = False, height: int = 1, gap: int = 0
):
    """sensor_msgs/PointCloud2 by rosbags' types, with rows, gaps behind them, and either byte order."""
    T = rec.T
    order = ">" if big else "<"
    swapped = points.astype(np.dtype([(n, points.dtype[n].newbyteorder(order)) for n in points.dtype.names]))
    fields = [
        T["sensor_msgs/msg/PointField"](
            name=n, offset=int(swapped.dtype.fields[n][1]), datatype=KINDS[swapped.dtype[n].base.str[1:]],
            count=int(np.prod(swapped.dtype[n].shape, dtype=int)),
        )
        for n in swapped.dtype.names
    ]  # fmt: skip
    rows = swapped.reshape(height, -1)
    data = b"".join(row.tobytes() + b"\xff" * gap for row in rows)
    return T["sensor_msgs/msg/PointCloud2"](
        header=rec.header(stamp_ns, frame), height=height, width=rows.shape[1], fields=fields, is_bigendian=big,
        point_step=swapped.dtype.itemsize, row_step=swapped.dtype.itemsize * rows.shape[1] + gap,
        data=np.frombuffer(data, np.uint8), is_dense=True,
    )  # fmt: skip


def pose_at(t_s: float) -> list[float]:
    x, y, z, w = Rotation.from_euler("ZYX", [0.3 * t_s, 0.02, -0.01]).as_quat()
    return [5.0 * t_s, np.sin(t_s), 0.1 * t_s, x, y, z, w]


def odometry(seconds: float = 2.0, rate: float = 20.0, child: str = "base_link"):
    for k in range(int(seconds * rate) + 1):
        stamp = T0 + int(k / rate * NS_PER_S)
        yield rec.ros_record("/odom", stamp, rec.odometry(stamp, pose_at(k / rate), child=child))


MOUNT = [1.0, 0.2, 1.8, *Rotation.from_euler("ZYX", [0.5, 0.1, -0.2]).as_quat()]
HALF = [0.5, 0.1, 0.9, *Rotation.from_euler("ZYX", [0.2, 0.0, 0.1]).as_quat()]


def static(items) -> rec.Record:
    return rec.ros_record("/tf_static", T0, rec.transforms([rec.transform(T0, *item) for item in items]))


def scans(count: int = 10, **changes):
    for k in range(count):
        stamp = T0 + k * NS_PER_S // 10
        yield rec.ros_record("/points", stamp, scan(stamp, sweep(k), **changes))


def ingest(path: Path, poses: Path | None = None, slam: dict | None = None, **settings) -> Tiles:
    source, of = Source(path.name, path), Source((poses or path).name, poses or path)
    params = SlamParams(**(slam or {}))
    tiles = ScanTilesParams(tiles=PointCloudParams(), scans=ScanParams(**settings), poses=params)
    return ingest_scans(source, ingest_slam(of, params), of, tiles)


def in_order(tiles: Tiles) -> PointCloud:
    parts = list(tiles.tiles.values())
    fields = {n: np.concatenate([p.fields[n] for p in parts]) for n in parts[0].fields}
    cloud = PointCloud(np.concatenate([p.xyz_m for p in parts]), fields)
    return cloud.take(np.lexsort((cloud.fields["ring"], cloud.fields["stamp_s"])))


def expected(mount: list[float], count: int = 10) -> PointCloud:
    """The same by scipy, point by point."""
    times = np.arange(41) / 20.0
    path = np.array([pose_at(t) for t in times])
    turns = Slerp(times, Rotation.from_quat(path[:, 3:]))
    out, stamps, rings = [], [], []
    for k in range(count):
        points = sweep(k)
        body = Rotation.from_quat(mount[3:]).apply(np.column_stack([points[a] for a in "xyz"])) + mount[:3]
        at = k / 10 + points["t"] * 1e-9
        place = np.column_stack([np.interp(at, times, path[:, i]) for i in range(3)])
        out.append(turns(at).apply(body) + place)
        stamps.append(T0 * 1e-9 + at)
        rings.append(points["ring"])
    order = np.lexsort((np.concatenate(rings), np.concatenate(stamps)))
    return PointCloud(np.concatenate(out)[order], {"stamp_s": np.concatenate(stamps)[order]})


LAYOUTS = {
    "plain": {},
    "big endian": {"big": True},
    "rows": {"height": 4},
    "rows with gaps": {"height": 4, "gap": 7},
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_points_lie_where_poses_and_transforms_put_them(tmp_path: Path, layout: str) -> None:
    chain = [(HALF, "base_link", "roof"), (STILL, "roof", "lidar")]
    records = [static(chain), *odometry(), *scans(**LAYOUTS[layout])]
    cloud = in_order(ingest(rec.write(tmp_path / "a.mcap", records), min_range_m=0))
    truth = expected(HALF)
    np.testing.assert_allclose(cloud.xyz_m, truth.xyz_m, atol=1e-6)
    np.testing.assert_allclose(cloud.fields["stamp_s"], truth.fields["stamp_s"], atol=5e-7)
    assert set(cloud.fields) == {"t", "ring", "vec", "stamp_s"}
    assert cloud.fields["vec"].shape == (400, 2)
    np.testing.assert_array_equal(np.sort(cloud.fields["ring"]), np.sort(np.tile(np.arange(40), 10)))


def test_the_sensor_s_place_may_be_given(tmp_path: Path) -> None:
    file = rec.write(tmp_path / "a.mcap", [*odometry(), *scans()])
    yaw, pitch, roll = np.degrees([0.5, 0.1, -0.2])
    pose = {"x_m": 1.0, "y_m": 0.2, "z_m": 1.8, "yaw_deg": yaw, "pitch_deg": pitch, "roll_deg": roll}
    cloud = in_order(ingest(file, sensor_pose=pose, min_range_m=0))
    np.testing.assert_allclose(cloud.xyz_m, expected(MOUNT).xyz_m, atol=1e-6)


def test_scans_in_the_body_s_own_frame_need_no_transform(tmp_path: Path) -> None:
    file = rec.write(tmp_path / "a.mcap", [*odometry(child="/lidar"), *scans()])
    np.testing.assert_allclose(in_order(ingest(file, min_range_m=0)).xyz_m, expected(STILL).xyz_m, atol=1e-6)


def test_poses_and_sensor_from_transforms_alone(tmp_path: Path) -> None:
    moving = [
        rec.ros_record(
            "/tf",
            T0,
            rec.transforms([rec.transform(T0 + k * NS_PER_S // 20, pose_at(k / 20), "map", "base_link")]),
        )
        for k in range(41)
    ]
    file = rec.write(tmp_path / "a.mcap", [static([(MOUNT, "base_link", "lidar")]), *moving, *scans()])
    slam = {"parent_frame": "map", "child_frame": "base_link"}
    np.testing.assert_allclose(
        in_order(ingest(file, slam=slam, min_range_m=0)).xyz_m, expected(MOUNT).xyz_m, atol=1e-6
    )


def test_poses_of_another_file_need_a_word_on_their_frame(tmp_path: Path) -> None:
    file = rec.write(tmp_path / "a.mcap", scans())
    lines = [" ".join(map(repr, [T0 / 1e9 + k / 20, *map(float, pose_at(k / 20))])) for k in range(41)]
    (tmp_path / "poses.tum").write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"which frame the SLAM poses are of; set point_cloud\.body_frame"):
        ingest(file, tmp_path / "poses.tum")
    cloud = in_order(ingest(file, tmp_path / "poses.tum", body_frame="lidar", min_range_m=0))
    np.testing.assert_allclose(cloud.xyz_m, expected(STILL).xyz_m, atol=1e-5)
    kitti = tmp_path / "poses.kitti"
    kitti.write_text("".join(f"1 0 0 {k} 0 1 0 0 0 0 1 0\n" for k in range(9)))
    with pytest.raises(AlignmentError, match="carry none; give TUM poses"):
        ingest(file, kitti)


def foxglove(stamp_ns: int, points: np.ndarray, pose: list[float]) -> dict:
    kinds = {"f4": 7, "u4": 5, "u2": 3}
    flat = points[["x", "y", "z", "t", "ring"]]
    fields = [
        {"name": n, "offset": int(flat.dtype.fields[n][1]), "type": kinds[flat.dtype[n].str[1:]]}
        for n in flat.dtype.names
    ]
    return {
        "timestamp": {"sec": stamp_ns // NS_PER_S, "nsec": stamp_ns % NS_PER_S}, "frame_id": "base_link",
        "pose": {"position": dict(zip("xyz", pose[:3], strict=True)),
                 "orientation": dict(zip("xyzw", pose[3:], strict=True))},
        "point_stride": points.dtype.itemsize, "fields": fields,
        "data": base64.b64encode(points.tobytes()).decode(),
    }  # fmt: skip


def test_foxglove_s_point_clouds(tmp_path: Path) -> None:
    def records():
        for k in range(10):
            stamp = T0 + k * NS_PER_S // 10
            yield rec.foxglove_record(
                "/points", "PointCloud", stamp, foxglove(stamp, sweep(k), MOUNT), "json"
            )

    cloud = in_order(ingest(rec.write(tmp_path / "a.mcap", [*odometry(), *records()]), min_range_m=0))
    np.testing.assert_allclose(cloud.xyz_m, expected(MOUNT).xyz_m, atol=1e-6)
    assert set(cloud.fields) == {"t", "ring", "stamp_s"}


def test_several_sensors_make_one_cloud_of_the_fields_they_share(tmp_path: Path) -> None:
    other = [
        rec.ros_record(
            "/rear",
            T0 + k * NS_PER_S // 10,
            scan(T0 + k * NS_PER_S // 10, sweep(k)[["x", "y", "z", "ring", "t"]], "rear"),
        )
        for k in range(10)
    ]
    mounts = static([(HALF, "base_link", "lidar"), (MOUNT, "base_link", "rear")])
    file = rec.write(tmp_path / "a.mcap", [mounts, *odometry(), *scans(), *other])
    with pytest.raises(InputError, match=r"several topics hold scans: name one as `point_cloud\.topic`"):
        ingest(file)
    tiles = ingest(file, topic=("/points", "/rear"), min_range_m=0)
    assert tiles.index.count.sum() == 800
    cloud = in_order(tiles)
    assert set(cloud.fields) == {"t", "ring", "stamp_s"}
    found = dict(zip(tiles.findings.code, tiles.findings.message, strict=True))
    assert (
        found["cloud-field-left-out"]
        == "the fields vec are not the same on all topics of scans and were left out"
    )
    truth = np.vstack([expected(HALF).xyz_m, expected(MOUNT).xyz_m])
    np.testing.assert_allclose(cloud.xyz_m[np.lexsort(cloud.xyz_m.T)], truth[np.lexsort(truth.T)], atol=1e-6)
    with pytest.raises(ValidationError, match="the place of one sensor"):
        ingest(file, topic=("/points", "/rear"), sensor_pose={"x_m": 1})


def test_a_scan_may_be_empty(tmp_path: Path) -> None:
    empty = [rec.ros_record("/points", T0 + 7, scan(T0 + 7, sweep(0)[:0])) for _ in range(3)]
    tiles = ingest(
        rec.write(tmp_path / "a.mcap", [*odometry(child="lidar"), *empty, *scans(), *empty]), min_range_m=0
    )
    assert tiles.index.count.sum() == 400
    with pytest.raises(InputError, match="no point with finite x, y, z among 0"):
        ingest(rec.write(tmp_path / "b.mcap", [*odometry(child="lidar"), *empty]))


def test_only_the_range_that_is_wanted_stays(tmp_path: Path) -> None:
    file = rec.write(tmp_path / "a.mcap", [*odometry(child="lidar"), *scans()])
    far = np.concatenate([np.linalg.norm([sweep(k)[a] for a in "xyz"], axis=0) for k in range(10)])
    tiles = ingest(file, min_range_m=8, max_range_m=22)
    assert tiles.index.count.sum() == ((far >= 8) & (far <= 22)).sum()
    assert "cloud-point-out-of-range" in tiles.findings.code


def test_points_without_a_pose_near_in_time_are_counted(tmp_path: Path) -> None:
    gappy = [r for r in odometry() if not T0 + 3e8 < r.log_ns < T0 + 1.7e9]
    file = rec.write(tmp_path / "a.mcap", [*gappy, *scans()])
    tiles = ingest(file, body_frame="lidar", min_range_m=0)
    found = dict(zip(tiles.findings.code, tiles.findings.message, strict=True))
    assert found["cloud-point-without-pose"].startswith(f"{400 - tiles.index.count.sum()} points of 400")
    assert 100 < tiles.index.count.sum() < 200


CLOCKS = {
    "nanoseconds": (1e9, False, "u4"), "microseconds": (1e6, False, "u4"), "seconds": (1, False, "f4"),
    "absolute seconds": (1, True, "f8"), "absolute nanoseconds": (1e9, True, "f8"),
}  # fmt: skip


@pytest.mark.parametrize("clock", CLOCKS)
def test_every_driver_s_way_to_write_time_is_understood(clock: str) -> None:
    per_s, absolute, kind = CLOCKS[clock]
    stamps = [T0 + k * NS_PER_S // 10 for k in range(4)]
    offset = np.linspace(0, 0.0999, 50)
    values = [((s / NS_PER_S if absolute else 0) * per_s + offset * per_s).astype(kind) for s in stamps]
    found = point_clock([v.astype(float) for v in values], stamps)
    assert found is not None
    assert found.absolute is absolute
    at = found.at_ns(values[2], stamps[2])
    np.testing.assert_allclose((at - stamps[2]) / NS_PER_S, offset, atol=2e-6)


@settings(deadline=None)
@given(st.integers(0, 1000))
def test_points_are_placed_as_scipy_places_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    quaternion = Rotation.random(5, rng=seed).as_quat()
    poses, points = Poses(rng.normal(size=(5, 3)), quaternion), rng.normal(size=(9, 3))
    stamps = np.arange(5) * 100
    at = rng.integers(0, 401, 9)
    mount = Poses(rng.normal(size=(1, 3)), Rotation.random(1, rng=seed + 1).as_quat())
    anything = (np.ones(5, bool), mount, (0.0, np.inf))
    there, state = place_points(points, at, stamps, poses, *anything)
    assert (state == 0).all()
    body = Rotation.from_quat(mount.quaternion[0]).apply(points) + mount.xyz_m
    turns = Slerp(stamps, Rotation.from_quat(quaternion))(at)
    place = np.column_stack([np.interp(at, stamps, poses.xyz_m[:, i]) for i in range(3)])
    np.testing.assert_allclose(there, turns.apply(body) + place, atol=1e-9)
    moment = interpolate(at, stamps, poses)
    np.testing.assert_allclose(moment.xyz_m, place, atol=1e-12)
    assert (Rotation.from_quat(moment.quaternion).inv() * turns).magnitude().max() < 1e-7
    identity = compose(poses, inverse(poses))
    np.testing.assert_allclose(identity.xyz_m, 0, atol=1e-12)
    late, state = place_points(points, at + 401, stamps, poses, *anything)
    assert np.isnan(late).all()
    assert (state == 3).all()


def broken(change) -> rec.Record:
    message = scan(T0, sweep(0))
    change(message)
    return rec.ros_record("/points", T0, message)


HOSTILE = {
    "more points than bytes": (lambda m: setattr(m, "width", 1 << 31), "do not fit its"),
    "rows beyond the data": (lambda m: setattr(m, "height", 1 << 31), "do not fit its|rows overlap"),
    "no bytes per point": (lambda m: setattr(m, "point_step", 0), "a point of 0 bytes"),
    "huge points": (lambda m: setattr(m, "point_step", 1 << 30), "do not fit|a point of"),
    "field outside": (lambda m: setattr(m.fields[3], "offset", 1 << 20), "goes over"),
    "huge count": (lambda m: setattr(m.fields[3], "count", 1 << 30), "goes over"),
    "unknown type": (lambda m: setattr(m.fields[4], "datatype", 77), "unknown type 77"),
    "no coordinates": (lambda m: setattr(m.fields[0], "name", "a"), "no fields x, y and z"),
    "coordinates twice": (lambda m: setattr(m.fields[3], "name", "x"), "no fields x, y and z"),
    "whole numbers": (lambda m: setattr(m.fields[2], "datatype", 6), "z is no single floating"),
}  # fmt: skip


@pytest.mark.parametrize("harm", HOSTILE)
def test_hostile_scans_are_refused(tmp_path: Path, harm: str) -> None:
    change, rule = HOSTILE[harm]
    file = rec.write(tmp_path / "a.mcap", [*odometry(child="lidar"), broken(change)])
    with pytest.raises(InputError, match=rule) as caught:
        ingest(file)
    assert str(caught.value).startswith("a.mcap topic /points message 1: ")


def test_what_does_not_belong_together_is_told(tmp_path: Path) -> None:
    late = [rec.ros_record("/points", T0, scan(T0 + 900 * NS_PER_S, sweep(0)))]
    with pytest.raises(InputError, match="no scan falls between the poses: they reach from"):
        ingest(rec.write(tmp_path / "a.mcap", [*odometry(child="lidar"), *late]), point_time="none")
    other = rec.ros_record("/points", T0 + 5, scan(T0 + 5, sweep(0)[["x", "y", "z", "t"]]))
    with pytest.raises(InputError, match="message 11: its fields are not those of the first scan"):
        ingest(rec.write(tmp_path / "b.mcap", [*odometry(child="lidar"), *scans(), other]))
    turned = rec.ros_record("/points", T0 + 5, scan(T0 + 5, sweep(0), frame="rear"))
    with pytest.raises(InputError, match="in the frame 'rear' and not 'lidar'"):
        ingest(rec.write(tmp_path / "c.mcap", [*odometry(child="lidar"), *scans(), turned]))
    with pytest.raises(
        InputError, match=r"no transforms lead from base_link to lidar.*point_cloud\.sensor_pose"
    ):
        ingest(rec.write(tmp_path / "d.mcap", [*odometry(), *scans()]))
    moving = [
        rec.ros_record(
            "/tf", T0 + k, rec.transforms([rec.transform(T0 + k, pose_at(k), "base_link", "lidar")])
        )
        for k in range(3)
    ]
    with pytest.raises(InputError, match="the sensor moves on its body"):
        ingest(rec.write(tmp_path / "e.mcap", [*moving, *odometry(), *scans()]))
    with pytest.raises(InputError, match=r"no field when for point_cloud\.point_time; fields are x, y, z, t"):
        ingest(rec.write(tmp_path / "f.mcap", [*odometry(child="lidar"), *scans()]), point_time="when")


def test_flipped_bits_end_in_a_line_or_in_points(tmp_path: Path) -> None:
    layout = rec.Layout(rec.CompressionType.NONE, chunked=False)
    file = rec.write(
        tmp_path / "a.mcap", [static([(HALF, "base_link", "lidar")]), *odometry(1), *scans(3)], layout
    )
    whole, rng, refused = np.frombuffer(file.read_bytes(), np.uint8), np.random.default_rng(8), []
    at = len(whole) // 2
    for n in range(150):
        bad = whole[: rng.integers(1, len(whole))].copy() if n % 5 == 0 else whole.copy()
        if n % 5:
            rows = rng.integers(at if n % 2 else 0, len(bad), 2)
            bad[rows] ^= np.uint8(1 << rng.integers(8))
        (tmp_path / "bad.mcap").write_bytes(bad.tobytes())
        try:
            ingest(tmp_path / "bad.mcap")
        except FlexMapError as error:
            refused.append(str(error))
    assert len(refused) > 30
    assert not any("\n" in line for line in refused)
