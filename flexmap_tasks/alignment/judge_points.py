"""How far each control point is from being met, and how well the others predict it."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

from flexmap_tasks.engine.stage import stage
from flexmap_tasks.geometry.sheet import affine_maps
from flexmap_tasks.geometry.triangulation import delaunay, twice_area
from flexmap_tasks.model.alignment import ControlPoints, JudgedPoints, RigidMotion, RubberSheet, Warp
from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.pose_graph import GraphNodes

MAX_LEVERAGE = 0.99
"""A point that decides its place all but alone leaves nothing to predict it by."""

_STILL = RigidMotion(np.eye(2), np.zeros(2), 1.0, 1.0, 0.0)


@stage("judged_points")
def judge_points(
    points: ControlPoints, motion: RigidMotion, warp: Warp, nodes: GraphNodes | None
) -> JudgedPoints:
    """Every point with what the warp leaves of it and where it would lie without it; the worst first.

    motion : the rigid start that the sources are given after; nodes : of the pose graph behind the warp, if any
    """
    place = np.column_stack([motion.inverse().apply_xy(points.source_xy_m), np.full(len(points), np.nan)])
    gap = warp.apply(place)[:, :2] - points.target_xy_m
    if nodes is not None:
        without = _adjusted_without(points, place[:, :2], gap, nodes)
    elif warp.sheet is not None:
        without = sheet_left_out_m(points, warp.sheet)
    else:
        without = np.hypot(*gap.T)
    without[~points.used] = np.hypot(*gap.T)[~points.used]  # nothing had to be left out
    shown = np.where(np.isnan(without), -1.0, without)
    order = np.lexsort([points.label.astype(str), -shown, ~points.used])
    p = points.take(order)
    return JudgedPoints(
        p.label, p.source_xy_m, p.target_xy_m, p.sigma_m, p.used, p.reason, np.hypot(*gap.T)[order], without[order]
    )  # fmt: skip


def _adjusted_without(points: ControlPoints, place_xy_m: Floats, gap: Floats, nodes: GraphNodes) -> Floats:
    """In an adjustment: (I - P / sigma^2)^-1 times the residual, P what it predicts of the place (leverage).

    Cook and Weisberg 1982, eq. 2.2.10, for the two rows of a point.
    """
    out = np.full(len(points), np.nan)
    for k in np.flatnonzero(points.used).tolist():
        away = nodes.source_xyz_m[:, :2] - place_xy_m[k]
        n = int((away**2).sum(axis=1).argmin())
        east, north, both = *nodes.sigma_m[n, :2] ** 2, nodes.covariance_en_m2[n]
        across = np.array([-away[n, 1], away[n, 0]]) * nodes.sigma_yaw_rad[n]
        predicted = np.array([[east, both], [both, north]]) + np.outer(across, across)
        leverage = predicted / points.sigma_m[k] ** 2
        if np.linalg.eigvalsh(leverage)[-1] < MAX_LEVERAGE:
            out[k] = np.hypot(*np.linalg.solve(np.eye(2) - leverage, gap[k]))
    return out


def sheet_left_out_m(points: ControlPoints, sheet: RubberSheet) -> Floats:
    """How far a sheet of the others puts each point from its target; NaN when there are no others.

    Only the triangles around a point change when it goes, so the sheet of its neighbours says it all.
    """
    used = np.flatnonzero(points.used)
    n = len(used)
    out = np.full(len(points), np.nan)
    if n < 2:
        return out
    source, target = sheet.source_xy_m, sheet.target_xy_m
    start, around = Delaunay(source[: n + 4] - source[: n + 4].mean(axis=0)).vertex_neighbor_vertices
    row = _rows_in(source[:n], points.source_xy_m[used])
    for k, v in zip(used.tolist(), row.tolist(), strict=True):
        link = np.sort(around[start[v] : start[v + 1]]).astype(np.int64)
        moved = target[link].copy()
        for c in np.flatnonzero(link >= n).tolist():  # a corner moves as the nearest point that is left
            gap = ((source[:n] - source[link[c]]) ** 2).sum(axis=1)
            gap[v] = np.inf
            moved[c] = source[link[c]] + (target - source)[gap.argmin()]
        out[k] = np.hypot(*(_carried(source[link], moved, source[v]) - target[v]))
    return out


def _rows_in(vertices: Floats, places: Floats) -> Ints:
    """(k,) the vertex of every place; each is there."""
    key = {tuple(xy): i for i, xy in enumerate(vertices.tolist())}
    return np.array([key[tuple(xy)] for xy in places.tolist()], dtype=np.int64)


def _carried(source: Floats, target: Floats, place: Floats) -> Floats:
    """Where the sheet of a few vertices takes a place inside it."""
    triangles = delaunay(source)
    corners = source[triangles]
    turned = np.stack([np.roll(corners, -i, axis=1) for i in range(3)], axis=1)[:, :, :2]
    to_place = np.concatenate([turned, np.broadcast_to(place, (*turned.shape[:2], 1, 2))], axis=2)
    inside = twice_area(to_place.reshape(-1, 3, 2)).reshape(-1, 3).min(axis=1)
    best = int((inside / np.abs(twice_area(corners))).argmax())
    linear = affine_maps(corners[[best]], target[triangles[[best]]])[0]
    moved: Floats = linear[:, :2] @ place + linear[:, 2]
    return moved
