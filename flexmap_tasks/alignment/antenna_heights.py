"""Altitudes of the fixes as heights seen at nodes, through the whole lever arm."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flexmap_tasks.alignment.altitudes import STANDS_OFF, Seen, measured, offset_stretches, resolution_m
from flexmap_tasks.alignment.drive import Drive
from flexmap_tasks.alignment.solve import Solved
from flexmap_tasks.alignment.vertical_graph import Heights
from flexmap_tasks.geometry.polyline import arc_length_m
from flexmap_tasks.geometry.se3 import turned
from flexmap_tasks.model.arrays import Floats, Ints, Strings
from flexmap_tasks.model.tracks import GnssTrack, Trajectory

UNKNOWN_SIGMA_M = 0.06
"""Of an altitude that states none: twice the horizontal one."""

MIN_SIGMA_M = 0.01

MAX_LEAN_RAD = 0.35
"""A body that leans over by more than 20 degrees, typically, does not have its z axis up."""

FLAT = 0.01
"""On a road with slopes below this it does not matter where the body's tilt is taken from."""

SLOPE_REACH_M = 2.0
"""Way before and behind over which the slope of the track is taken."""


class Body(NamedTuple):
    """Where the SLAM body was: pose (m, 3) x, y and yaw along the direction of travel, z_m (m,), and its upward
    axis up (m, 3), all in the SLAM frame.
    """

    pose: Floats
    z_m: Floats
    up: Floats


class Told(NamedTuple):
    """heights : what the altitudes say; fix : (m,) row in the GNSS track of each; reason : (f,) why the altitude of
    a fix in use is left out, "" where it is not, or the fix itself is not in use
    """

    heights: Heights
    fix: Ints
    reason: Strings


def told_heights(
    slam: Trajectory, gnss: GnssTrack, drive: Drive, solved: Solved, antenna_up_m: float, scale: float
) -> Told:
    """What the altitudes of the fixes in use say of nodes.

    scale : metres per SLAM metre
    """
    fix, node = solved.line.fix[solved.found.line_row], solved.found.fix.node
    order = np.lexsort((fix, node))
    fix, node = fix[order], node[order]
    altitude = gnss.xyz_m[fix, 2].copy()
    why = measured(altitude)
    reason = np.full(len(gnss), "", dtype=object)
    body = _bodies(slam, drive, _times(gnss, drive, solved, fix, slam), node)
    at = drive.pose[drive.node[node], :2]
    lever = _levers(body, (*solved.solution.state.shared[:2].tolist(), antenna_up_m))
    arm = scale * (body.pose[:, :2] - at) + lever[:, :2]
    base = drive.z_m[drive.node[node]]
    seen = Seen(
        arc_length_m(drive.pose[drive.node, :2])[node] + np.hypot(*(body.pose[:, :2] - at).T),
        altitude,
        base + scale * (body.z_m - base) + lever[:, 2],
    )
    sigma = gnss.sigma_m[fix, 2]
    sigma = np.where(np.isfinite(sigma) & (sigma > 0), np.maximum(sigma, MIN_SIGMA_M), UNKNOWN_SIGMA_M)
    known = np.flatnonzero(why == "")
    rounded, stretch = 0.0, np.full(len(fix), -1)
    if len(known):
        rounded = resolution_m(altitude[known])
        stretch[known] = offset_stretches(seen.take(known), 1.0 / np.hypot(sigma, rounded)[known] ** 2)
        why[stretch >= 0] = STANDS_OFF
    reason[fix] = why
    heights = Heights(node, arm, seen.misfit_m, sigma, stretch, rounded).take(known)
    rows = heights.unmixed(len(drive.node))
    return Told(heights.take(rows), fix[known[rows]], reason)


def _times(gnss: GnssTrack, drive: Drive, solved: Solved, fix: Ints, slam: Trajectory) -> Floats | None:
    """(m,) times of fixes in seconds of the drive; None when time does not tie them."""
    if not solved.timed or slam.stamp_ns is None or gnss.stamp_ns is None or drive.stamp_s is None:
        return None
    at: Floats = (gnss.stamp_ns[fix] - slam.stamp_ns[0]) * 1e-9 + solved.solution.state.shared[3]
    return at


def _bodies(slam: Trajectory, drive: Drive, at_s: Floats | None, node: Ints) -> Body:
    """The body at times, or at nodes where there is no time."""
    up = body_up(slam, drive)
    if at_s is None or drive.stamp_s is None:
        row = drive.node[node]
        return Body(drive.pose[row], drive.z_m[row], up[row])
    pose = drive.at(at_s)
    columns = [np.interp(at_s, drive.stamp_s, column) for column in (drive.z_m, *up.T)]
    return Body(pose, columns[0], np.column_stack(columns[1:]))


def body_up(slam: Trajectory, drive: Drive) -> Floats:
    """(n, 3) upward axis of the body in the SLAM frame at all poses: z of the quaternions, or at right angles to the
    track where the quaternions know nothing of slopes.
    """
    up = turned(slam.quaternion, np.tile([0.0, 0.0, 1.0], (len(slam), 1)))
    along = arc_length_m(drive.pose[:, :2])
    behind, ahead = (np.interp(along + d, along, drive.z_m) for d in (-SLOPE_REACH_M, SLOPE_REACH_M))
    way = np.interp(along + SLOPE_REACH_M, along, along) - np.interp(along - SLOPE_REACH_M, along, along)
    slope = (ahead - behind) / np.maximum(way, 1e-3)
    cos, sin = np.cos(drive.pose[:, 2]), np.sin(drive.pose[:, 2])
    # leaning back is up against the direction of travel
    leans = np.arctan2(-(up[:, 0] * cos + up[:, 1] * sin), up[:, 2])
    apart, usual = _spread(leans - slope), _spread(slope)
    if np.median(up[:, 2]) > np.cos(MAX_LEAN_RAD) and apart < max(usual / 2, FLAT):
        return up
    normal = np.column_stack([-slope * cos, -slope * sin, np.ones(len(slope))])
    out: Floats = normal / np.linalg.norm(normal, axis=1)[:, None]
    return out


def _spread(values: Floats) -> float:
    """Median distance from the median."""
    return float(np.median(np.abs(values - np.median(values))))


def _levers(body: Body, lever_m: tuple[float, float, float]) -> Floats:
    """(m, 3) the antenna seen from the body in the SLAM frame; lever_m : forward, left, up."""
    up = body.up / np.linalg.norm(body.up, axis=1)[:, None]
    cos, sin = np.cos(body.pose[:, 2]), np.sin(body.pose[:, 2])
    forward = np.column_stack([cos, sin, -(up[:, 0] * cos + up[:, 1] * sin) / up[:, 2]])
    forward /= np.linalg.norm(forward, axis=1)[:, None]
    left = np.cross(up, forward)
    out: Floats = lever_m[0] * forward + lever_m[1] * left + lever_m[2] * up
    return out
