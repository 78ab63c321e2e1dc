"""Refusals of drives from which no trustworthy map can come, each with one clear line."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.alignment.drive import Drive
from flexmap_tasks.alignment.solve import Solved
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.geometry.polyline import arc_length_m
from flexmap_tasks.geometry.se2 import between
from flexmap_tasks.model.arrays import Floats

MIN_EXTENT_M = 10.0
"""Places that all lie within this are standstill and its noise, however long the way between them adds up to."""

CHORD_M, STEEP_SHARE = 10.0, 0.05
"""No car climbs at 45 degrees over a chord of this length; a jump or two of SLAM's height may look like it."""

BEND_M, MAX_BEND = 100.0, 0.5
"""SLAM over this way, or half of a shorter drive, is wrong by some percent at most, never by half of it."""

MAX_SIGMA_M = 1.0
"""Predicted deviation per axis of half of all poses: beyond it the tracks do not say where the drive lies."""


def refuse_still(xy_m: Floats, name: str) -> None:
    """Raises AlignmentError when (n, 2) places do not go anywhere."""
    extent = float(np.hypot(*np.ptp(xy_m, axis=0))) if len(xy_m) else 0.0
    if extent < MIN_EXTENT_M:
        raise AlignmentError(
            name,
            f"stands still: all {len(xy_m)} places lie within {extent:.2f} m; a drive over at least "
            f"{MIN_EXTENT_M:g} m is needed",
        )


def refuse_steep(xyz_m: Floats) -> None:
    """Raises AlignmentError when height is not in the third column, as in the axes of a camera. (n, 3)"""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xyz_m, axis=0), axis=1))])
    wanted = np.arange(0.0, along[-1], CHORD_M)
    if len(wanted) < 2:
        return
    step = np.diff(np.column_stack([np.interp(wanted, along, column) for column in xyz_m.T]), axis=0)
    steep = float((np.abs(step[:, 2]) > np.hypot(step[:, 0], step[:, 1])).mean())
    if steep > STEEP_SHARE:
        raise AlignmentError(
            "SLAM trajectory",
            f"{steep:.0%} of the way climbs or falls at over 45 degrees: z must point up. Camera axes (x right, "
            "y down, z forward) become x = z, y = -x, z = -y; turn the poses, the map and the point cloud alike",
        )


def refuse_other_drive(drive: Drive, solved: Solved) -> None:
    """Raises AlignmentError when SLAM could only be laid on GNSS by force."""
    refuse_still(solved.line.xy_m, "GNSS track")
    bend = _bend(drive.pose[drive.node], solved.solution.state.pose)
    if bend > MAX_BEND:
        raise AlignmentError(
            "tracks",
            f"SLAM and GNSS cannot be one drive: a tenth of the SLAM trajectory would have to be bent by {bend:.0%} "
            f"of its way over {BEND_M:g} m; check that both files are of the same drive and their axes right-handed",
        )


def refuse_unsure(sigma_m: Floats) -> None:
    """Raises AlignmentError when half of the poses that have fixes are not known to `MAX_SIGMA_M` per axis. (n, 2)"""
    typical = float(np.median(np.sqrt((sigma_m**2).mean(axis=1))))
    if typical > MAX_SIGMA_M:
        raise AlignmentError(
            "tracks",
            f"SLAM and GNSS do not say where along its way the drive lies: half of the poses beside GNSS are "
            f"known to {typical:.1f} m or worse, {MAX_SIGMA_M:g} m is needed; drive at least one turn, or give "
            "control points",
        )


def _bend(source: Floats, adjusted: Floats) -> float:
    """90th percentile of how far the adjusted poses leave SLAM over `BEND_M`, as a share of it. (n, 3) each"""
    along = arc_length_m(source[:, :2])
    way = min(BEND_M, along[-1] / 2)
    first = np.flatnonzero(along + way <= along[-1])
    last = np.searchsorted(along, along[first] + way)
    gap = between(source[first], source[last]) - between(adjusted[first], adjusted[last])
    return float(np.percentile(np.hypot(gap[:, 0], gap[:, 1]), 90) / way)
