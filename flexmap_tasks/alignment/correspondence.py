"""Which fix belongs to which place of the drive."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flexmap_tasks.alignment.drive import Drive
from flexmap_tasks.alignment.gnss_line import GnssLine
from flexmap_tasks.geometry.graph2d import Fix, Seen, State, at_nodes
from flexmap_tasks.geometry.polyline import arc_length_m
from flexmap_tasks.geometry.rigid import PlanarFit, fit_planar_motion
from flexmap_tasks.geometry.se2 import rotated, wrapped
from flexmap_tasks.geometry.turns import track_heading
from flexmap_tasks.model.arrays import Bools, Floats, Ints
from flexmap_tasks.model.tracks import GnssTrack

REACH_M = 15.0
"""How far along the line a place may slide from where the association put it."""

CHORD_M, TURN_RAD = 20.0, 0.03
"""The direction of the way is taken over so far on both sides where it turns by less than this against it."""

FOOT_M = 1e-4
"""The foot of a place on the line is found to this."""

EDGE_M = 1.5
"""Next to a gap the direction of the line is not known."""

MAX_GAP_S = 0.5
"""A fix is only used where SLAM poses lie this near in time on both sides."""

TRIED_FIXES = 2000
"""Fixes that find the start; more say nothing new."""

CAUCHY_M = 1.0
"""Misfit at which a fix counts half in the rigid start."""


class Correspondence(NamedTuple):
    """Fixes tied to nodes.

    fix : the observations; line_row : (m,) rows of the GnssLine; sigma_m : (m,) stated standard deviation
    """

    fix: Fix
    line_row: Ints
    sigma_m: Floats


def by_shape(state: State, line: GnssLine, along_m: Floats, sigma_m: Floats) -> Correspondence:
    """Without time: the place of the line beside every node's antenna, on the same pass.

    along_m : (n,) arc length at every node from the monotone association
    sigma_m : (k,) stated standard deviation of every fix of the line
    """
    antenna = state.antenna
    s = slide(line, antenna, along_m)
    heading = line.heading_at(s)
    along_gap = rotated(antenna - line.at(s), -heading)[:, 0]
    ends = (s > EDGE_M) & (s < line.along_m[-1] - EDGE_M)
    seen = line.seen_at(s) & line.seen_at(s - EDGE_M) & line.seen_at(s + EDGE_M)
    node = np.flatnonzero(seen & ends & (np.abs(along_gap) < 1.0))
    row = np.clip(np.searchsorted(line.along_m, s[node]), 0, len(line.fix) - 1)
    body, part = np.zeros((len(node), 2)), np.full(len(node), -1)
    across = _direction(antenna)[node] + np.pi / 2
    fix = at_nodes(node, body, part, line.at(s[node]), across)
    return Correspondence(fix, row, sigma_m[row])


def _direction(antenna_m: Floats) -> Floats:
    """(n,) direction of the antenna's way, over a long chord wherever a short one says the same within its noise.

    Every turn of the direction holds the drive where the association happened to put it along the road. Those of
    noise must not: on a straight road nothing is known of it. A chord in the middle of a bend is as its tangent.
    """
    near, along = track_heading(antenna_m), arc_length_m(antenna_m)
    ahead, behind = (
        np.column_stack([np.interp(along + reach, along, column) for column in antenna_m.T])
        for reach in (CHORD_M, -CHORD_M)
    )
    far = np.arctan2(*(ahead - behind).T[::-1])
    return np.where(np.abs(wrapped(near - far)) < TURN_RAD, far, near)


def slide(line: GnssLine, xy_m: Floats, along_m: Floats) -> Floats:
    """(n,) arc length of the foot of every point on the line, no further than `REACH_M` from the given one."""
    s = along_m
    for _ in range(12):
        ahead = rotated(xy_m - line.at(s), -line.heading_at(s))[:, 0]
        before, s = s, np.clip(s + ahead, along_m - REACH_M, along_m + REACH_M)
        s = np.clip(s, 0.0, line.along_m[-1])
        if np.abs(s - before).max(initial=0.0) < FOOT_M:
            break
    return s


def by_time(state: State, drive: Drive, line: GnssLine, gnss_s: Floats, sigma_m: Floats) -> Correspondence:
    """With time: every fix tied to the nodes around it, the body's way since and until then taken from SLAM.

    gnss_s : (k,) time of every fix of the line in seconds of the drive, clocks taken as one
    """
    offset = float(state.shared[3])
    at = gnss_s + offset
    row = np.flatnonzero(covered(drive, at))
    at = at[row]
    pose, velocity = drive.at(at), drive.velocity_at(at)
    stamp, last = drive.stamps, len(drive.node) - 1
    node = np.clip(np.searchsorted(stamp[drive.node], at, side="right") - 1, 0, last)
    after = np.minimum(node + 1, last)
    along = arc_length_m(drive.pose[:, :2])
    start, stop = along[drive.node[node]], along[drive.node[after]]
    share = np.clip((np.interp(at, stamp, along) - start) / np.maximum(stop - start, 1e-9), 0.0, 1.0)
    fix = Fix(
        _seen(drive, node, pose, velocity, offset),
        _seen(drive, after, pose, velocity, offset),
        share,
        drive.part[node],
        line.xy_m[row],
        np.zeros(len(row)),
    )
    return Correspondence(fix, row, sigma_m[row])


def _seen(drive: Drive, node: Ints, pose: Floats, velocity: Floats, offset_s: float) -> Seen:
    """Poses and velocities from nodes; places without the offset, which is an unknown."""
    base = drive.pose[drive.node[node]]
    body = rotated(pose[:, :2] - base[:, :2], -base[:, 2])
    turn = wrapped(pose[:, 2] - base[:, 2])
    seen_velocity = rotated(velocity, turn)
    return Seen(node, body - offset_s * seen_velocity, turn, seen_velocity)


def covered(drive: Drive, at_s: Floats) -> Bools:
    """(k,) whether SLAM poses surround a time closely."""
    stamp = drive.stamps
    k = np.searchsorted(stamp, at_s)
    inside = (k > 0) & (k < len(stamp))
    k = np.clip(k, 1, len(stamp) - 1)
    far = np.maximum(stamp[k] - stamp[k - 1], 0.0)
    # SLAM that keeps one pose every few metres leaves longer lapses than this: then its own usual lapse counts
    close: Bools = inside & (far <= max(MAX_GAP_S, 3.0 * float(np.median(np.diff(stamp)))))
    return close


def timed_start(
    drive: Drive, line: GnssLine, gnss_s: Floats, offset_max_s: float
) -> tuple[PlanarFit, float] | None:
    """Robust rigid motion and clock offset of a timed drive; None when the two times do not overlap.

    Every offset on a grid is tried with a rigid fit over pieces of the drive; the one with the smallest typical
    misfit starts the adjustment, which refines it.
    """
    offsets = np.linspace(-offset_max_s, offset_max_s, 2 * int(np.ceil(offset_max_s / 0.1)) + 1)
    best: tuple[float, PlanarFit, float] | None = None
    for offset in offsets[np.argsort(np.abs(offsets), kind="stable")].tolist():
        row = np.flatnonzero(covered(drive, gnss_s + offset))
        row = row[:: max(len(row) // TRIED_FIXES, 1)]
        if len(row) < 3:
            continue
        source, target = drive.at(gnss_s[row] + offset)[:, :2], line.xy_m[row]
        fit, misfit = _robust(source, target)
        if best is None or misfit < 0.999 * best[0]:
            best = (misfit, fit, offset)
    return None if best is None else (best[1], best[2])


def _robust(source: Floats, target: Floats) -> tuple[PlanarFit, float]:
    weight = np.ones(len(source))
    for _ in range(8):
        fit = fit_planar_motion(source, target, weight)
        gap = np.hypot(*(target - source @ fit.rotation.T - fit.translation).T)
        weight = 1.0 / (1.0 + (gap / max(CAUCHY_M, float(np.median(gap)))) ** 2)
    return fit, float(np.median(gap))


def gnss_seconds(gnss: GnssTrack, line: GnssLine, first_ns: int) -> Floats | None:
    """(k,) times of the line's fixes in seconds since the first pose; None when the recording has no time."""
    if gnss.stamp_ns is None:
        return None
    seconds: Floats = 1e-9 * (gnss.stamp_ns[line.fix] - first_ns).astype(np.float64)
    return seconds
