"""The drive for the report: GNSS, SLAM before and after, control points, the sheet, and how far they lie apart."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.geometry.polyline import arc_length_m, distance_and_seen, nearest_on_polyline
from flexmap_tasks.geometry.sheet import affine_maps
from flexmap_tasks.model.alignment import ControlPoints, RigidMotion, Warp
from flexmap_tasks.model.arrays import Bools, Floats, Ints, strings
from flexmap_tasks.model.pose_graph import GnssUse, GraphNodes, HeldOut
from flexmap_tasks.model.tracks import GnssTrack, Trajectory
from flexmap_tasks.report.embed import Json, Texts, millimetres, numbers

MOST_ROWS = 40_000
"""A longer track is drawn by every second, third, ... row, so that the page stays small."""

MOST_TIES = 3_000


def gnss_of(gnss: GnssTrack, use: GnssUse | None, texts: Texts) -> Json:
    """Fixes by row: place, horizontal sigma, status, whether the step to it was observed, and why it was left out."""
    rows = _thinned(len(gnss))
    why = strings([""] * len(gnss)) if use is None else np.where(use.used, "", use.reason)
    sigma = np.hypot(gnss.sigma_m[:, 0], gnss.sigma_m[:, 1])[rows]
    return {
        "xy": millimetres(gnss.xyz_m[rows]),
        "sigma": numbers(np.where(np.isfinite(sigma), sigma, -1.0), "f4"),
        "status": numbers(gnss.status[rows], "i4"),
        "observed": numbers(_kept_breaks(gnss.observed, rows), "u1"),
        "left_out": texts.column(why[rows]),
        "count": len(gnss),
    }


Antenna = tuple[GraphNodes | None, Trajectory | None]
"""Nodes of a pose graph, and where their antenna is."""


def slam_of(
    slam: Trajectory, gnss: GnssTrack, warp: Warp, held_out: HeldOut | None, antenna: Antenna | None = None
) -> Json:
    """Poses by row: after the rigid start, after the warp, metres driven, both distances to the GNSS line, what the
    warp itself predicts, and the distance to GNSS that was withheld; -1 where a figure is not known.

    The distance after the warp is the antenna's where the alignment knows its lever arm.
    """
    rows = _thinned(len(slam))
    before = warp.motion.apply_xy(slam.xyz_m[:, :2])
    after = warp.apply(slam.xyz_m)[:, :2]
    distance, valid = deviation(_antenna_m(after, antenna)[rows], gnss)
    return {
        "before": millimetres(before[rows]),
        "after": millimetres(after[rows]),
        "driven": numbers(arc_length_m(after)[rows] if len(after) else np.zeros(0), "f4"),
        "deviation_before": numbers(_known(deviation(before[rows], gnss)[0]), "f4"),
        "deviation_after": numbers(_known(distance), "f4"),
        "valid": numbers(valid, "u1"),
        "sigma": numbers(_known(warp.sigma_m(slam.xyz_m)[rows]), "f4"),
        "held_out": numbers(_withheld(held_out, rows), "f4"),
        "count": len(slam),
    }


def _antenna_m(after_m: Floats, antenna: Antenna | None) -> Floats:
    """(n, 2) the antenna at every pose: from node to node it turns with the body."""
    nodes, track = antenna or (None, None)
    if nodes is None or track is None:
        return after_m
    lever, rows = track.xyz_m[:, :2] - nodes.xyz_m[:, :2], np.arange(len(after_m))
    return after_m + np.column_stack([np.interp(rows, nodes.row, lever[:, i]) for i in (0, 1)])


def ties_of(
    gnss: GnssTrack, use: GnssUse | None, slam: Trajectory, warp: Warp, antenna: Antenna | None
) -> Json | None:
    """Which fix lies beside which place of the aligned antenna; some of many, only of fixes in use."""
    used = np.arange(len(gnss)) if use is None else np.flatnonzero(use.used)
    rows = used[:: max(1, -(-len(used) // MOST_TIES))]
    track = _antenna_m(warp.apply(slam.xyz_m)[:, :2], antenna)
    if len(track) < 2 or not len(rows):
        return None
    fix = gnss.xyz_m[rows, :2]
    near = nearest_on_polyline(fix, track)
    step = track[near.segment + 1] - track[near.segment]
    place = track[near.segment] + near.share[:, None] * step
    return {"fix": millimetres(fix), "place": millimetres(place)}


def calibration_of(held_out: HeldOut | None) -> Json | None:
    """What was predicted for places whose GNSS was withheld, and how far off they were."""
    if held_out is None or not len(held_out):
        return None
    known = np.flatnonzero(np.isfinite(held_out.sigma_m) & np.isfinite(held_out.distance_m))
    return {
        "sigma": numbers(held_out.sigma_m[known], "f4"),
        "error": numbers(held_out.distance_m[known], "f4"),
    }


def points_of(points: ControlPoints | None, warp: Warp, texts: Texts) -> Json | None:
    """Control points: where the rigid start leaves them, where they belong, and where the warp puts them."""
    if points is None:
        return None
    still = RigidMotion(np.eye(2), np.zeros(2), 1.0, 1.0, 0.0)
    start = np.column_stack([points.source_xy_m, np.zeros(len(points))])
    return {
        "label": texts.column(points.label),
        "source": millimetres(points.source_xy_m),
        "target": millimetres(points.target_xy_m),
        "moved": millimetres(Warp(still, warp.sheet).apply(start) if len(points) else start),
        "sigma": numbers(points.sigma_m, "f4"),
        "used": numbers(points.used, "u1"),
        "reason": texts.column(points.reason),
    }


def sheet_of(warp: Warp) -> Json | None:
    """Triangles before and after, and the largest stretch of each beside 1."""
    sheet = warp.sheet
    if sheet is None or not len(sheet.triangles):
        return None
    maps = affine_maps(sheet.source_xy_m[sheet.triangles], sheet.target_xy_m[sheet.triangles])
    stretch = np.linalg.svd(maps[:, :, :2], compute_uv=False)
    worst = np.where(np.abs(stretch[:, 0] - 1) > np.abs(stretch[:, 1] - 1), stretch[:, 0], stretch[:, 1])
    return {
        "source": millimetres(sheet.source_xy_m),
        "target": millimetres(sheet.target_xy_m),
        "triangles": numbers(sheet.triangles, "i4"),
        "stretch": numbers(worst, "f4"),
    }


def _thinned(count: int) -> Ints:
    return np.arange(0, count, max(1, -(-count // MOST_ROWS)), dtype=np.int64)


def _withheld(held_out: HeldOut | None, rows: Ints) -> Floats:
    """(n,) withheld distances at the drawn rows next before them."""
    out = np.full(len(rows), -1.0)
    if held_out is not None and len(rows):
        place = np.clip(np.searchsorted(rows, held_out.row, side="right") - 1, 0, None)
        out[place] = _known(held_out.distance_m)
    return out


def _kept_breaks(observed: Bools, rows: Ints) -> Bools:
    """A row is observed when every step since the row before it was."""
    if not len(rows):
        return observed[rows]
    broken = np.concatenate([[0], np.cumsum(~observed)])
    since = np.concatenate([rows[:1], rows[:-1] + 1])
    whole: Bools = broken[rows + 1] == broken[since]
    return whole


def deviation(poses_m: Floats, gnss: GnssTrack) -> tuple[Floats, Bools]:
    """Distance to the line through all fixes, and which poses have valid GNSS: see `distance_and_seen`."""
    return distance_and_seen(poses_m, gnss.xyz_m[:, :2], gnss.observed[1:])


def _known(values: Floats) -> Floats:
    return np.where(np.isfinite(values), values, -1.0)
