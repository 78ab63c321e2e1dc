"""Lidar scans in the log: the same surfaces as the map, seen from the moving vehicle."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from flexmap_tasks.simulate.chance import stream
from flexmap_tasks.simulate.cloud import INTENSITY, Surfaces
from flexmap_tasks.simulate.drive import Drive
from flexmap_tasks.simulate.roads import Network
from flexmap_tasks.simulate.world import World

SCAN_POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")]
)
LIDAR_HEIGHT_M = 1.8
LOWEST_DEG, HIGHEST_DEG = -25.0, 15.0
POINTS_PER_M, MOST_POINTS = 500, 4_000_000
NEAREST_M = 1.5


def make_scans(
    world: World, network: Network, roads: list[int], drive: Drive
) -> Iterator[tuple[float, NDArray[Any]]]:
    """(time of the sweep's begin in s, points (n,) of SCAN_POINT in the body frame), one after the other.

    Every point is given in the body frame of its own moment (`time` seconds after the begin), as a turning
    lidar does it: the sweep is distorted by the motion.
    """
    plan, rng = world.cloud, stream(world.seed, "scans")
    surfaces = Surfaces.of(network, roads)
    count = int(min(MOST_POINTS, POINTS_PER_M * surfaces.edge[-1]))
    points, surface = surfaces.sample(rng, count, world.cloud.corridor_m)
    tree = cKDTree(points[:, :2])
    for begin in np.arange(0.0, drive.duration_s - 1.0 / plan.scan_rate_hz, 1.0 / plan.scan_rate_hz).tolist():
        place = drive.at(np.array([begin]))[0][0]
        near = np.sort(np.array(tree.query_ball_point(place[:2], plan.scan_range_m), dtype=np.int64))
        if len(near) > plan.scan_points:
            near = np.sort(rng.choice(near, plan.scan_points, replace=False))
        yield begin, _seen(world, drive, begin, points[near], INTENSITY[surface[near]], rng)


def _seen(
    world: World, drive: Drive, begin: float, points: NDArray[np.float64], glow: NDArray[np.float64],
    rng: np.random.Generator,
) -> NDArray[Any]:  # fmt: skip
    """What one turn of the lidar measures of these points."""
    plan = world.cloud
    place, yaw, _, _ = drive.at(np.array([begin]))
    bearing = np.arctan2(*(points[:, :2] - place[0, :2]).T[::-1]) - yaw[0]
    time = (bearing / (2 * np.pi) % 1.0) / plan.scan_rate_hz
    at, yaws, pitches, _ = drive.at(begin + time)
    body = Rotation.from_euler("ZYX", np.column_stack([yaws, pitches, np.zeros(len(yaws))]))
    seen = body.inv().apply(points - at)
    ray = seen - [0.0, 0.0, LIDAR_HEIGHT_M]
    distance = np.linalg.norm(ray, axis=1)
    ray *= (1.0 + rng.normal(0.0, plan.noise_m, len(ray)) / np.maximum(distance, NEAREST_M))[:, None]
    elevation = np.degrees(np.arctan2(ray[:, 2], np.hypot(ray[:, 0], ray[:, 1])))
    inside = (distance > NEAREST_M) & (elevation > LOWEST_DEG) & (elevation < HIGHEST_DEG)
    rows = np.flatnonzero(inside)[np.argsort(time[inside], kind="stable")]
    out = np.empty(len(rows), SCAN_POINT)
    for k, axis in enumerate("xyz"):
        out[axis] = ray[rows, k] + (LIDAR_HEIGHT_M if axis == "z" else 0.0)
    out["intensity"], out["time"] = glow[rows], time[rows]
    out["ring"] = np.rint((elevation[rows] - LOWEST_DEG) / (HIGHEST_DEG - LOWEST_DEG) * (plan.rings - 1))
    return out
