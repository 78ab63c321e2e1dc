"""The truth of the recording and of places: frame, poses, fixes, map nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.simulate.drive import Drive
from flexmap_tasks.simulate.frame import TownFrame
from flexmap_tasks.simulate.gnss import GnssMessages
from flexmap_tasks.simulate.hd_map import HdMap
from flexmap_tasks.simulate.slam import SlamTrack
from flexmap_tasks.simulate.world import World

Table = dict[str, NDArray[Any]]
NS_PER_S = 1_000_000_000


def stamps_ns(world: World, time_s: Floats) -> NDArray[np.int64]:
    """Nanoseconds since the epoch of times since the start."""
    return np.asarray(world.drive.start_ns + np.rint(time_s * NS_PER_S).astype(np.int64))


def frame_table(world: World, frame: TownFrame, slam: SlamTrack) -> Table:
    """One row: the town's frame on Earth, the rigid part of town to SLAM, and the lever arm."""
    row: dict[str, float | int] = {
        "epsg": frame.epsg, "origin_easting_m": frame.easting_m, "origin_northing_m": frame.northing_m,
        "origin_height_m": frame.height_m, "grid_scale": frame.scale,
    }  # fmt: skip
    row |= {f"rotation_{i}{j}": float(slam.rotation[i, j]) for i in range(3) for j in range(3)}
    for name, vector in (
        ("pivot", slam.origin_m),
        ("start", slam.start_m),
        ("lever", world.gnss.lever_arm_m),
    ):
        row |= {f"{name}_{axis}_m": float(v) for axis, v in zip("xyz", vector, strict=True)}
    row["clock_offset_s"] = world.gnss.clock_offset_s
    return {k: np.array([v]) for k, v in row.items()}


def pose_table(world: World, frame: TownFrame, drive: Drive, slam: SlamTrack, gnss: GnssMessages) -> Table:
    """Every SLAM pose: where the body truly was, what SLAM says, and what GNSS was doing."""
    geo = frame.geodetic(slam.true_xyz_m)
    flags = {
        name: _nearest_flag(slam.time_s, gnss.time_s, getattr(gnss, name), 1.5 / world.gnss.rate_hz)
        for name in ("multipath", "jump")
    }
    gap = (
        np.abs(gnss.time_s[_nearest(slam.time_s, gnss.time_s)] - slam.time_s) if len(gnss.time_s) else np.inf
    )
    return {
        "row": np.arange(len(slam.time_s)), "stamp_ns": stamps_ns(world, slam.time_s), "s_m": slam.s_m,
        "lon_deg": geo[:, 0], "lat_deg": geo[:, 1], "ele_m": geo[:, 2],
        "true_x_m": slam.true_xyz_m[:, 0], "true_y_m": slam.true_xyz_m[:, 1], "true_z_m": slam.true_xyz_m[:, 2],
        "true_yaw_rad": slam.true_yaw_rad, "true_pitch_rad": slam.true_pitch_rad,
        "slam_x_m": slam.xyz_m[:, 0], "slam_y_m": slam.xyz_m[:, 1], "slam_z_m": slam.xyz_m[:, 2],
        "slam_qx": slam.quaternion[:, 0], "slam_qy": slam.quaternion[:, 1], "slam_qz": slam.quaternion[:, 2],
        "slam_qw": slam.quaternion[:, 3],
        "outage": np.broadcast_to(gap > 1.5 / world.gnss.rate_hz, (len(slam.time_s),)).copy(),
        "standstill": drive.stands(slam.time_s), **flags,
    }  # fmt: skip


def _nearest(time: Floats, others: Floats) -> NDArray[np.int64]:
    order = np.argsort(others, kind="stable")
    right = np.clip(np.searchsorted(others[order], time), 1, max(len(others) - 1, 1))
    left = right - 1
    right = np.minimum(right, len(others) - 1)
    nearer = np.abs(others[order[left]] - time) <= np.abs(others[order[right]] - time)
    return np.asarray(order[np.where(nearer, left, right)])


def _nearest_flag(
    time: Floats, others: Floats, flag: NDArray[np.bool_], within_s: float
) -> NDArray[np.bool_]:
    if not len(others):
        return np.zeros(len(time), dtype=bool)
    row = _nearest(time, others)
    return np.asarray(flag[row] & (np.abs(others[row] - time) <= within_s))


def gnss_table(world: World, frame: TownFrame, gnss: GnssMessages) -> Table:
    """Every message: where the antenna truly was, and the error of the fix (grid east, north, up)."""
    geo = frame.geodetic(gnss.antenna_m)
    return {
        "row": np.arange(len(gnss.time_s)), "true_stamp_ns": stamps_ns(world, gnss.time_s),
        "stamp_ns": stamps_ns(world, gnss.stamp_s), "lon_deg": geo[:, 0], "lat_deg": geo[:, 1],
        "ele_m": geo[:, 2], "error_east_m": gnss.error_m[:, 0], "error_north_m": gnss.error_m[:, 1],
        "error_up_m": gnss.error_m[:, 2], "mode": gnss.mode, "status": gnss.status,
        "multipath": gnss.multipath, "outage": gnss.outage, "jump": gnss.jump, "standstill": gnss.stand,
    }  # fmt: skip


def node_table(frame: TownFrame, hd_map: HdMap) -> Table:
    """Every node of the HD map: where it belongs on Earth."""
    geo = frame.geodetic(hd_map.town_xyz_m)
    return {
        "node_id": hd_map.node_id, "lon_deg": geo[:, 0], "lat_deg": geo[:, 1], "ele_m": geo[:, 2],
        "x_m": hd_map.town_xyz_m[:, 0], "y_m": hd_map.town_xyz_m[:, 1], "z_m": hd_map.town_xyz_m[:, 2],
    }  # fmt: skip
