"""The files are what other programs read, and the same world gives the same bytes."""

from __future__ import annotations

import csv

import numpy as np
import osmium
import pyarrow.parquet as pq
import pytest
from rosbags.highlevel import AnyReader

from flexmap_tasks.errors import CoverageError, InputError
from flexmap_tasks.formats.pcd import read_pcd
from flexmap_tasks.model.source import Source
from flexmap_tasks.simulate.generate import simulate
from flexmap_tasks.simulate.write import write_world


def content(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture(scope="module")
def quick(small_town):
    return small_town.changed(
        cloud={"points": 30_000, "scans": True, "scan_rate_hz": 0.2, "truth_points": 500},
        osm={"later_date": True},
    )


@pytest.fixture(scope="module")
def written(quick, tmp_path_factory):
    folder = tmp_path_factory.mktemp("world")
    write_world(quick, folder)
    return folder


def test_the_same_world_gives_the_same_bytes_and_another_seed_others(quick, written, tmp_path):
    write_world(quick, tmp_path / "again")
    again = content(tmp_path / "again")
    assert again == content(written)
    assert {"recording.mcap", "lanelet2_map.osm", "osm_extract.osm", "pointcloud_map.pcd"} <= again.keys()
    write_world(quick.changed(seed=99), tmp_path / "other")
    other = content(tmp_path / "other")
    assert again.keys() == other.keys()
    assert [k for k in again if again[k] == other[k]] == []


def test_rosbags_reads_the_recording(quick, written):
    town = simulate(quick)
    with AnyReader([written / "recording.mcap"]) as reader:
        counts = {c.topic: (c.msgtype, c.msgcount) for c in reader.connections}
        assert counts["/gnss/fix"] == ("sensor_msgs/msg/NavSatFix", len(town.gnss.time_s))
        assert counts["/slam/odometry"] == ("nav_msgs/msg/Odometry", len(town.slam.time_s))
        read = {topic: [] for topic in counts}
        last = 0
        for connection, log_ns, raw in reader.messages():
            assert log_ns >= last
            last = log_ns
            read[connection.topic].append(reader.deserialize(raw, connection.msgtype))
    pose = [m.pose.pose.position for m in read["/slam/odometry"]]
    assert np.array_equal([(p.x, p.y, p.z) for p in pose], town.slam.xyz_m)
    fixes = town.frame.geodetic(town.gnss.antenna_m + town.gnss.error_m)
    assert np.array_equal([(m.longitude, m.latitude, m.altitude) for m in read["/gnss/fix"]], fixes)
    sigma = np.sqrt([m.position_covariance[[0, 4, 8]] for m in read["/gnss/fix"]])
    assert np.allclose(sigma, town.gnss.sigma_m)
    stamp = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in read["/gnss/fix"]]
    assert np.array_equal(stamp, pq.read_table(written / "truth" / "gnss.parquet")["stamp_ns"])
    check_scans(read["/lidar/points"], town)


def check_scans(scans, town):
    assert len(scans) > 10
    for scan in scans[::5]:
        names = [f.name for f in scan.fields]
        assert names == ["x", "y", "z", "intensity", "ring", "time"]
        dtype = np.dtype({
            "names": names, "formats": ["<f4"] * 4 + ["<u2", "<f4"], "offsets": [f.offset for f in scan.fields],
            "itemsize": scan.point_step,
        })  # fmt: skip
        points = scan.data.view(dtype)
        assert len(points) == scan.width > 500
        assert (np.diff(points["time"]) >= 0).all()
        assert points["ring"].max() < town.world.cloud.rings
        below = points[np.abs(points["y"]) < 1.0]["z"]
        assert np.median(np.abs(below)) < 0.5, "the road lies at the body's feet"


def test_poses_as_text_are_those_of_the_recording(quick, written):
    town = simulate(quick)
    kitti = np.loadtxt(written / "poses_kitti.txt").reshape(-1, 3, 4)
    assert np.allclose(kitti[:, :, 3], town.slam.xyz_m, atol=1e-6)
    assert np.allclose(np.linalg.det(kitti[:, :, :3]), 1.0, atol=1e-6)
    tum = np.loadtxt(written / "poses_tum.txt")
    assert np.allclose(tum[:, 1:4], town.slam.xyz_m, atol=1e-8)
    assert np.allclose(np.abs((tum[:, 4:] * town.slam.quaternion).sum(axis=1)), 1.0, atol=1e-8)


def test_osmium_reads_the_extracts(written):
    for name in ("osm_extract.osm", "osm_extract_later.osm"):
        nodes, refs, tagged = set(), set(), 0
        for item in osmium.FileProcessor(str(written / name)):
            if item.is_node():
                nodes.add(item.id)
                assert item.location.valid()
            elif item.is_way():
                assert len(item.nodes) >= 2
                refs |= {n.ref for n in item.nodes}
                tagged += "highway" in item.tags
        assert refs <= nodes
        assert tagged > 30


def test_the_cloud_is_what_its_truth_says(quick, written):
    cloud = read_pcd(Source("pointcloud_map.pcd", written / "pointcloud_map.pcd"))
    assert len(cloud) == quick.cloud.points
    truth = pq.read_table(written / "truth" / "cloud_points.parquet").to_pydict()
    town = simulate(quick)
    xyz = np.column_stack([truth["x_m"], truth["y_m"], truth["z_m"]])
    assert len(xyz) == 500
    assert np.abs(town.slam.to_slam(xyz) - cloud.xyz_m[truth["point"]]).max() < 1e-3


def test_control_points_are_pairs_of_one_place(quick, written):
    town = simulate(quick)
    with (written / "control_points.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) >= 6
    assert list(rows[0]) == ["source_row", "target_lat_deg", "target_lon_deg", "name", "sigma_m"]
    xy = town.frame.local(np.array([[float(r["target_lon_deg"]), float(r["target_lat_deg"])] for r in rows]))
    off = xy - town.slam.true_xyz_m[[int(r["source_row"]) for r in rows], :2]
    assert np.hypot(*off.T).max() < 0.1


def test_truth_tables_are_complete(quick, written):
    tables = {p.stem: pq.read_table(p) for p in (written / "truth").iterdir()}
    names = [
        "frame",
        "poses",
        "gnss",
        "map_nodes",
        "cloud_points",
        "matches",
        "tags",
        "lanes",
        "ways",
        "matches_later",
        "tags_later",
        "changes",
    ]
    assert set(tables) == set(names)
    town = simulate(quick)
    assert tables["map_nodes"].num_rows == len(town.hd_map.node_id)
    assert tables["poses"].num_rows == len(town.slam.time_s)
    for name, table in tables.items():
        for column in table.schema:
            if column.name.startswith("way_s") or name in ("tags", "tags_later"):
                continue
            assert table[column.name].null_count == 0, (name, column.name)


def test_a_folder_that_cannot_be_written_is_one_clear_line(quick, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    with pytest.raises(InputError, match="cannot be written"):
        write_world(quick, blocked)


def test_real_topology_becomes_a_world(quick, shared_data, tmp_path):
    place = {"lat_deg": 49.443, "lon_deg": 7.77, "height_m": 250.0}
    file = shared_data / "osm" / "kaiserslautern.osm.gz"
    network = {
        "layout": "osm", "topology_file": file, "topology_radius_m": 600.0, "roundabouts": 0, "islands": 0,
        "frontage_roads": 0, "cul_de_sacs": 0, "parking_aisles": 0, "living_streets": 0,
    }  # fmt: skip
    real = quick.changed(network=network, place=place, cloud={"scans": False, "points": 1000})
    write_world(real, tmp_path)
    matches = pq.read_table(tmp_path / "truth" / "matches.parquet").to_pydict()
    assert len(set(matches["lanelet_id"])) > 60
    nowhere = real.changed(place={"lat_deg": 10.0, "lon_deg": 7.77})
    with pytest.raises(CoverageError, match="inside the extract"):
        write_world(nowhere, tmp_path)
