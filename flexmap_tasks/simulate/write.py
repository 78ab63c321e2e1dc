"""A world as the files a user would have, and the truth beside them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.columns import encode_table
from flexmap_tasks.formats.mcap_writer import Stamped, nav_sat_fixes, odometries, point_cloud2, write_mcap
from flexmap_tasks.formats.osm_xml_write import write_osm_xml
from flexmap_tasks.formats.pcd_stream import POINT, write_pcd_stream
from flexmap_tasks.formats.track_text_write import csv_text, kitti_text, tum_text
from flexmap_tasks.model.source import Source
from flexmap_tasks.simulate.cloud import CloudChunk, make_cloud
from flexmap_tasks.simulate.generate import Simulation, picked_rows, picked_targets, simulate
from flexmap_tasks.simulate.gnss import stated_altitudes
from flexmap_tasks.simulate.scans import make_scans
from flexmap_tasks.simulate.topology import read_topology
from flexmap_tasks.simulate.truth import Table, frame_table, gnss_table, node_table, pose_table, stamps_ns
from flexmap_tasks.simulate.truth_matches import match_tables
from flexmap_tasks.simulate.truth_roads import change_table, lane_table, way_table
from flexmap_tasks.simulate.world import World

GNSS_TOPIC, SLAM_TOPIC, LIDAR_TOPIC = "/gnss/fix", "/slam/odometry", "/lidar/points"
GNSS_FRAME, SLAM_FRAME, BODY_FRAME = "gnss", "map", "base_link"


def write_world(world: World, folder: Path) -> None:
    """Simulate `world` and write it into `folder`, which is made when it is not there.

    recording.mcap, lanelet2_map.osm, osm_extract.osm (and osm_extract_later.osm), pointcloud_map.pcd,
    poses_kitti.txt, poses_tum.txt, control_points.csv, and truth/*.parquet.
    Raises InputError when the folder cannot be written.
    """
    file = world.network.topology_file
    simulation = simulate(world, read_topology(world, Source(str(file), file)) if file else None)
    try:
        (folder / "truth").mkdir(parents=True, exist_ok=True)
        _write_maps(simulation, folder)
        _write_tracks(simulation, folder)
        tables = _tables(simulation) | {"cloud_points": _write_cloud(simulation, folder)}
        for name, table in tables.items():
            (folder / "truth" / f"{name}.parquet").write_bytes(encode_table(dict(table)))
    except OSError as error:
        raise InputError(str(folder), f"cannot be written: {error.strerror or error}") from error


def _write_maps(simulation: Simulation, folder: Path) -> None:
    (folder / "lanelet2_map.osm").write_bytes(write_osm_xml(simulation.hd_map.document))
    (folder / "osm_extract.osm").write_bytes(write_osm_xml(simulation.osm.document))
    if simulation.osm_later:
        (folder / "osm_extract_later.osm").write_bytes(write_osm_xml(simulation.osm_later.document))


def _write_tracks(simulation: Simulation, folder: Path) -> None:
    """The recording, the same poses as text, and the control points."""
    world, slam, gnss = simulation.world, simulation.slam, simulation.gnss
    stamp = stamps_ns(world, slam.time_s)
    fixes = simulation.frame.geodetic(gnss.antenna_m + gnss.error_m)
    fixes[:, 2] = stated_altitudes(world, fixes[:, 2])
    fixes[gnss.status < 0] = np.nan
    topics: dict[str, tuple[str, Iterator[Stamped]]] = {
        GNSS_TOPIC: (
            "sensor_msgs/msg/NavSatFix",
            nav_sat_fixes(stamps_ns(world, gnss.stamp_s), stamps_ns(world, gnss.log_s), fixes, gnss.sigma_m,
                          gnss.status, GNSS_FRAME),
        ),
        SLAM_TOPIC: (
            "nav_msgs/msg/Odometry",
            odometries(stamp, stamp, slam.xyz_m, slam.quaternion, SLAM_FRAME, BODY_FRAME),
        ),
    }  # fmt: skip
    if world.cloud.scans:
        topics[LIDAR_TOPIC] = ("sensor_msgs/msg/PointCloud2", _scans(simulation))
    write_mcap(folder / "recording.mcap", topics)
    rotation = Rotation.from_quat(slam.quaternion).as_matrix()
    (folder / "poses_kitti.txt").write_text(kitti_text(slam.xyz_m, rotation), encoding="utf-8")
    (folder / "poses_tum.txt").write_text(tum_text(stamp, slam.xyz_m, slam.quaternion), encoding="utf-8")
    rows = picked_rows(simulation)
    lonlat = picked_targets(simulation, rows)
    columns: dict[str, list[object]] = {
        "source_row": rows.tolist(),
        "target_lat_deg": [f"{v:.10f}" for v in lonlat[:, 1]],
        "target_lon_deg": [f"{v:.10f}" for v in lonlat[:, 0]],
        "name": [f"pick {k + 1}" for k in range(len(rows))],
        "sigma_m": [max(world.control_points.sigma_m, 0.01)] * len(rows),
    }
    (folder / "control_points.csv").write_text(csv_text(columns), encoding="utf-8")


def _scans(simulation: Simulation) -> Iterator[Stamped]:
    roads = sorted(simulation.hd_map.roads)
    for begin, points in make_scans(simulation.world, simulation.network, roads, simulation.drive):
        stamp = int(stamps_ns(simulation.world, np.array([begin]))[0])
        yield stamp, point_cloud2(stamp, BODY_FRAME, points)


def _write_cloud(simulation: Simulation, folder: Path) -> Table:
    """The point cloud map, streamed; returns the truth of every k-th point."""
    world = simulation.world
    every = max(1, -(-world.cloud.points // max(1, world.cloud.truth_points)))
    index, town = [np.empty(0, dtype=np.int64)], [np.empty((0, 3))]

    def points(chunks: Iterator[CloudChunk]) -> Iterator[NDArray[Any]]:
        for chunk in chunks:
            rows = np.arange(-chunk.first % every, len(chunk.intensity), every)
            index.append(chunk.first + rows)
            town.append(chunk.town_xyz_m[rows])
            out = np.empty(len(chunk.intensity), POINT)
            for k, axis in enumerate("xyz"):
                out[axis] = chunk.slam_xyz_m[:, k]
            out["intensity"] = chunk.intensity
            yield out

    chunks = make_cloud(world, simulation.network, sorted(simulation.hd_map.roads), simulation.slam)
    write_pcd_stream(folder / "pointcloud_map.pcd", world.cloud.points, points(chunks))
    xyz = np.vstack(town)
    geo = simulation.frame.geodetic(xyz)
    return {
        "point": np.concatenate(index), "lon_deg": geo[:, 0], "lat_deg": geo[:, 1], "ele_m": geo[:, 2],
        "x_m": xyz[:, 0], "y_m": xyz[:, 1], "z_m": xyz[:, 2],
    }  # fmt: skip


def _tables(simulation: Simulation) -> dict[str, Table]:
    s = simulation
    matches, tags = match_tables(s.lanes, s.hd_map, s.osm)
    tables = {
        "frame": frame_table(s.world, s.frame, s.slam),
        "poses": pose_table(s.world, s.frame, s.drive, s.slam, s.gnss),
        "gnss": gnss_table(s.world, s.frame, s.gnss),
        "map_nodes": node_table(s.frame, s.hd_map),
        "matches": matches,
        "tags": tags,
        "lanes": lane_table(s.lanes, s.hd_map, s.osm),
        "ways": way_table(s.lanes, s.hd_map, s.osm),
    }
    if s.osm_later:
        later, later_tags = match_tables(s.lanes, s.hd_map, s.osm_later)
        tables |= {"matches_later": later, "tags_later": later_tags, "changes": change_table(s.osm_later)}
    return tables
