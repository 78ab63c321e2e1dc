"""The SLAM drive as the graph sees it: nodes, and where the body was at any time between them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flexmap_tasks.geometry.polyline import arc_length_m, smooth_through, steps_m
from flexmap_tasks.geometry.se2 import between, rotated, wrapped
from flexmap_tasks.geometry.turns import track_heading, yaw_rad
from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.tracks import Trajectory

MAX_YAW_SPREAD_RAD = 0.2
"""A yaw that leaves the direction of travel by more than this, typically, is no yaw: travel is taken instead."""

PART_M = 25.0
"""SLAM's drift is taken as constant over parts of the way of this length."""

VELOCITY_S = 2.0
"""A car's velocity changes little within this."""

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

    @property
    def part(self) -> Ints:
        """(k,) the part of the way that begins at or before every node, for the last node that which ends there."""
        part = (arc_length_m(self.pose[self.node, :2]) // PART_M).astype(np.int64)
        part[-1] = part[-2]
        # a step longer than a part leaves parts empty: they are not counted
        return np.concatenate([[0], np.cumsum(np.diff(part) > 0)])

    def at(self, stamp_s: Floats) -> Floats:
        """Poses (m, 3) at times between the first and the last, smooth through the poses.

        Arcs between poses two metres apart lie a centimetre inside a tight corner's entry and outside of its exit:
        the same as a body that runs late.
        """
        through = np.column_stack([self.pose[:, :2], np.unwrap(self.pose[:, 2])])
        out = smooth_through(stamp_s, self.stamps, through)
        return np.column_stack([out[:, :2], wrapped(out[:, 2])])

    def velocity_at(self, stamp_s: Floats) -> Floats:
        """(m, 2) forward and left in the body, metres per second, over `VELOCITY_S` around times.

        The velocity of single steps is SLAM's noise as much as the car's: a clock offset that is found with it
        believes itself far too sure, and is drawn to where the noise of GNSS and SLAM happen to agree.
        """
        stamp = self.stamps
        step = between(self.pose[:-1], self.pose[1:])
        way = np.concatenate([[[0.0, 0.0]], np.cumsum(rotated(step[:, :2], -step[:, 2] / 2), axis=0)])
        start = np.clip(stamp_s - VELOCITY_S / 2, stamp[0], stamp[-1])
        stop = np.clip(stamp_s + VELOCITY_S / 2, stamp[0], stamp[-1])
        gone = [np.interp(stop, stamp, w) - np.interp(start, stamp, w) for w in way.T]
        out: Floats = np.column_stack(gone) / np.maximum(stop - start, 1e-9)[:, None]
        return out

    @property
    def stamps(self) -> Floats:
        """`stamp_s` of a drive that has time."""
        if self.stamp_s is None:
            raise ValueError("the drive has no time")
        return self.stamp_s


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
    nodes, since, steps = [0], 0.0, step.tolist()
    for k, (length, following) in enumerate(zip(steps, [*steps[1:], 0.0], strict=True), 1):
        since += length
        # the pose that is nearest to the spacing: what lies between two nodes is carried along without its noise
        if since + following / 2 >= spacing_m:
            nodes.append(k)
            since = 0.0
    if nodes[-1] != len(step):
        nodes.append(len(step))
    return np.array(nodes)
