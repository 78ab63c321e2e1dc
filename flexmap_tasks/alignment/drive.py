"""The SLAM drive as the graph sees it: nodes, and where the body was at any time between them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flexmap_tasks.geometry.polyline import steps_m
from flexmap_tasks.geometry.se2 import along_arc, wrapped
from flexmap_tasks.geometry.turns import track_heading, yaw_rad
from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.tracks import Trajectory

MAX_YAW_SPREAD_RAD = 0.2
"""A yaw that leaves the direction of travel by more than this, typically, is no yaw: travel is taken instead."""

_MOVING_M = 0.5
"""Direction of travel is only asked for where the neighbours lie this far apart."""


class Drive(NamedTuple):
    """pose : (n, 3) x, y, yaw of all SLAM poses, yaw along the direction of travel; z_m : (n,)

    stamp_s : (n,) seconds since the first pose, or None; node : (k,) rows of the nodes
    """

    pose: Floats
    z_m: Floats
    stamp_s: Floats | None
    node: Ints

    def at(self, stamp_s: Floats) -> tuple[Floats, Floats]:
        """Poses (m, 3) at times between the first and the last, on arcs of constant turn; velocities (m, 2)."""
        if self.stamp_s is None:
            raise ValueError("the drive has no time")
        k = np.clip(np.searchsorted(self.stamp_s, stamp_s) - 1, 0, len(self.stamp_s) - 2)
        lapse = np.maximum(self.stamp_s[k + 1] - self.stamp_s[k], 1e-9)
        share = (stamp_s - self.stamp_s[k]) / lapse
        pose, velocity = along_arc(self.pose[k], self.pose[k + 1], share)
        return pose, velocity / lapse[:, None]


def drive_of(slam: Trajectory, spacing_m: float) -> Drive:
    """Nodes every `spacing_m` metres, and one at the end; yaw turned into the direction of travel."""
    xy_m = slam.xyz_m[:, :2]
    stamp_s = None if slam.stamp_ns is None else (slam.stamp_ns - slam.stamp_ns[0]) * 1e-9
    pose = np.column_stack([xy_m, _yaw(slam)])
    return Drive(pose, slam.xyz_m[:, 2], stamp_s, _nodes(steps_m(xy_m), spacing_m))


def _yaw(slam: Trajectory) -> Floats:
    """Yaw of the body's direction of travel: that of the quaternions, less how they are mounted."""
    yaw, xy_m = yaw_rad(slam.quaternion), slam.xyz_m[:, :2]
    travel = track_heading(xy_m)
    moving = np.hypot(*np.gradient(xy_m, axis=0).T) > _MOVING_M / 2
    if not moving.any():
        return yaw
    off = np.exp(1j * (travel - yaw))[moving]
    mount = float(np.angle(np.exp(1j * np.median(wrapped(np.angle(off * np.conj(off.mean()))))) * off.mean()))
    spread = float(np.median(np.abs(wrapped(travel - yaw - mount)[moving])))
    if spread > MAX_YAW_SPREAD_RAD:
        return travel
    # a body whose x axis points forward stays as it is: a mean slip of some mrad is no mounting
    return yaw if abs(mount) < 0.1 else wrapped(yaw + mount)


def _nodes(step: Floats, spacing_m: float) -> Ints:
    nodes, since = [0], 0.0
    for k, length in enumerate(step.tolist(), 1):
        since += length
        if since >= spacing_m:
            nodes.append(k)
            since = 0.0
    if nodes[-1] != len(step):
        nodes.append(len(step))
    return np.array(nodes)
