"""Several drives through one area, each aligned by itself, become one alignment.

Every drive says how the SLAM frame is to be corrected where it drove, and how far that is to be trusted. Drives are
independent, so a place takes the mean of what they say weighted by 1 / variance (Gauss-Markov): where one had no
GNSS, another takes over. What a drive says fades out with the distance from it: nothing jumps where it turns off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from flexmap_tasks.engine.stage import stage
from flexmap_tasks.geometry.se2 import rotated, wrapped
from flexmap_tasks.model.arrays import Floats, strings
from flexmap_tasks.model.fusion import AlignedDrive, DriveUse, Fusion
from flexmap_tasks.model.pose_graph import GraphNodes, PoseGraph

REACH_M, REACH_UP_M = 15.0, 4.0
"""What a drive says fades out over this distance in the plane, and over this height: another deck of a bridge."""

NEIGHBOURS = 16
"""Nodes of a drive that say something about one place: at the usual spacing, all on both sides of two passes."""

MIN_SIGMA_M, MIN_SIGMA_RAD = 0.005, 1e-5
"""No pose is known better: a deviation of zero would silence all other drives."""

MAX_SIGMAS, MAX_DISAGREEMENT_M = 5.0, 0.2
"""A drive whose median disagreement exceeds both is left out: it contradicts what it and the others predict."""

FRAME_M, FRAME_SHARE = 10.0, 0.05
"""Without a place in common a drive may lie this far, and this share of the distance, from where the map's own drive
would put it: SLAM drifts by less, the frame of another SLAM lies elsewhere."""


class Said(NamedTuple):
    """What one drive says about (n,) places: xy_m (n, 2), turn_rad, lift_m, and their variances, var_m2 per axis.

    near : (n,) from 1 on the drive down to 0 where it says nothing; lift_m and its variance NaN without altitude
    """

    xy_m: Floats
    turn_rad: Floats
    lift_m: Floats
    var_m2: Floats
    var_turn: Floats
    var_lift_m2: Floats
    near: Floats


@stage("fusion")
def fuse_drives(graph: PoseGraph, drives: Mapping[str, AlignedDrive]) -> Fusion:
    """One pose graph of the map's own drive and of all others that agree with it, and what became of each.

    graph : of the map's own drive, which always counts
    """
    kept: dict[str, PoseGraph] = {"": graph}
    rows: dict[str, dict[str, object]] = {"": {}}
    waiting = {name: drive.graph for name, drive in sorted(drives.items()) if drive.graph is not None}
    heard = {name: [_said(graph, g.nodes.source_xyz_m)] for name, g in waiting.items()}
    while waiting:
        name = max(waiting, key=lambda n: _common(heard[n]))
        candidate = waiting.pop(name)
        rows[name] = _judged(candidate, _joined(heard[name]), graph)
        if not rows[name]["reason"]:
            kept[name] = candidate
            for other, g in waiting.items():
                heard[other].append(_said(candidate, g.nodes.source_xyz_m))
    fused, weight = _fused(kept, graph)
    return Fusion(fused, _table(graph, drives, kept, rows, weight))


def _common(heard: Sequence[Said]) -> int:
    """How many places of a drive the others say something about."""
    return int((np.stack([said.near for said in heard]) > 0).any(axis=0).sum())


def _corrections(graph: PoseGraph) -> tuple[Floats, Floats]:
    """Turn and lift of every node."""
    nodes = graph.nodes
    return wrapped(nodes.yaw_rad - nodes.source_yaw_rad), nodes.xyz_m[:, 2] - nodes.source_xyz_m[:, 2]


def _variances(nodes: GraphNodes) -> tuple[Floats, Floats, Floats]:
    """Of every node: in the plane per axis, of its turn, of its height (NaN without altitude)."""
    plane = np.maximum((nodes.sigma_m[:, :2] ** 2).mean(axis=1), MIN_SIGMA_M**2)
    return (
        plane, np.maximum(nodes.sigma_yaw_rad, MIN_SIGMA_RAD) ** 2, np.maximum(nodes.sigma_m[:, 2], MIN_SIGMA_M) ** 2
    )  # fmt: skip


def _own(graph: PoseGraph) -> Said:
    """What a drive says at its own nodes."""
    turn, lift = _corrections(graph)
    plane, var_turn, up = _variances(graph.nodes)
    return Said(graph.nodes.xyz_m[:, :2], turn, _known(lift, up), plane, var_turn, up, np.ones(len(turn)))


def _known(lift_m: Floats, var_m2: Floats) -> Floats:
    return np.where(np.isfinite(var_m2), lift_m, np.nan)


def _said(graph: PoseGraph, place_m: Floats) -> Said:
    """What a drive says at (n, 3) places of the SLAM frame: its nodes around, each as a motion of the plane."""
    nodes, scale = graph.nodes, np.array([1.0, 1.0, REACH_M / REACH_UP_M])
    count = min(NEIGHBOURS, len(nodes))
    distance, index = cKDTree(nodes.source_xyz_m * scale).query(
        place_m * scale, k=np.arange(1, count + 1), distance_upper_bound=REACH_M
    )
    node = np.minimum(index, len(nodes) - 1)  # those beyond reach get no weight
    kernel = np.where(np.isfinite(distance), np.maximum(1.0 - (distance / REACH_M) ** 2, 0.0) ** 2, 0.0)
    turn, lift = _corrections(graph)
    plane, var_turn, up = _variances(nodes)
    away = (place_m[:, None, :2] - nodes.source_xyz_m[node, :2]).reshape(-1, 2)
    moved = graph.figures.scale * rotated(away, turn[node].ravel()).reshape(*node.shape, 2)
    xy = nodes.xyz_m[node, :2] + moved
    first = turn[node[:, :1]]
    about = first[:, 0] + _mean(wrapped(turn[node] - first), kernel / var_turn[node])
    has = np.isfinite(up[node])
    lifts = np.where(has, kernel / np.where(has, up[node], 1.0), 0.0)
    by = kernel / plane[node]
    there = lift[node] + (nodes.tilt_xy_rad[node] * away.reshape(*node.shape, 2)).sum(axis=2)
    return Said(
        np.column_stack([_mean(xy[..., 0], by), _mean(xy[..., 1], by)]),
        about,
        _mean(there, lifts),
        _mean(plane[node], kernel),
        _mean(var_turn[node], kernel),
        _mean(up[node], np.where(has, kernel, 0.0)),
        kernel.max(axis=1),
    )


def _mean(values: Floats, weight: Floats) -> Floats:
    """Along the last axis, of values that have weight; NaN where none has."""
    total = weight.sum(axis=-1)
    of_all = (np.where(weight > 0, values, 0.0) * weight).sum(axis=-1)
    out: Floats = np.where(total > 0, of_all / np.where(total > 0, total, 1.0), np.nan)
    return out


def _joined(said: Sequence[Said]) -> Said:
    """The mean of what drives say, weighted by 1 / variance and how near each is.

    Where they scatter more than they predict, the variance grows by as much (Birge 1932).
    """
    xy, near = np.stack([s.xy_m for s in said]), np.stack([s.near for s in said])
    weight = _weights(np.stack([s.var_m2 for s in said]), near)
    middle = np.column_stack([_mean(xy[..., k].T, weight.T) for k in (0, 1)])
    square = (weight * np.where(weight > 0, ((xy - middle) ** 2).sum(axis=2), 0.0)).sum(axis=0)
    birge = np.maximum(1.0, square / np.maximum(2.0 * (near.sum(axis=0) - 1.0), 1.0))
    turn, var_turn = _joined_values([s.turn_rad for s in said], [s.var_turn for s in said], near, angles=True)
    lift, var_lift = _joined_values([s.lift_m for s in said], [s.var_lift_m2 for s in said], near)
    return Said(middle, turn, lift, _variance(weight, near) * birge, var_turn, var_lift, near.max(axis=0))


def _weights(variance: Floats, near: Floats) -> Floats:
    known = (near > 0) & np.isfinite(variance)
    return np.where(known, near / np.where(known, variance, 1.0), 0.0)


def _variance(weight: Floats, near: Floats) -> Floats:
    """Of the mean: what fades out adds less than its weight. NaN where nothing has weight."""
    total = weight.sum(axis=0)
    out: Floats = np.where(
        total > 0, (weight * near).sum(axis=0) / np.where(total > 0, total, 1.0) ** 2, np.nan
    )
    return out


def _joined_values(
    values: list[Floats], variances: list[Floats], near: Floats, *, angles: bool = False
) -> tuple[Floats, Floats]:
    weight = _weights(np.stack(variances), near)
    first = weight.argmax(axis=0)  # angles are counted from one that has weight
    start = np.stack(values)[first, np.arange(len(first))]
    off = np.stack(values) - start
    off = np.where(weight > 0, wrapped(off) if angles else off, 0.0)
    return start + _mean(off.T, weight.T), _variance(weight, near)


def _judged(candidate: PoseGraph, said: Said, graph: PoseGraph) -> dict[str, object]:
    """Row of the table for a drive that is held against those that count so far."""
    common, own = np.flatnonzero(said.near > 0), _own(candidate)
    if len(common) == 0:
        return {"common_places": 0, "reason": _elsewhere(candidate, graph)}
    apart = np.hypot(*(own.xy_m - said.xy_m)[common].T)
    sigmas = float(np.median(apart / np.sqrt(own.var_m2[common] + said.var_m2[common])))
    apart_m = float(np.median(apart))
    contradicts = sigmas > MAX_SIGMAS and apart_m > MAX_DISAGREEMENT_M
    why = f"disagrees with the other drives by {apart_m:.2f} m, {sigmas:.1f} of the deviations predicted"
    return {
        "common_places": len(common), "disagreement_m": apart_m, "disagreement_sigmas": sigmas,
        "reason": why if contradicts else "",
    }  # fmt: skip


def _elsewhere(candidate: PoseGraph, graph: PoseGraph) -> str:
    """Why a drive without a place in common does not belong to the map; "" where it may extend it."""
    nodes = candidate.nodes
    source = nodes.source_xyz_m[:, :2]
    off = np.median(np.hypot(*(graph.motion.apply_xy(source) - nodes.xyz_m[:, :2]).T))
    away = np.median(cKDTree(graph.nodes.source_xyz_m[:, :2]).query(source)[0])
    if off <= FRAME_M + FRAME_SHARE * away:
        return ""
    return f"lies {off:.0f} m from where the map's drive would put it: not localised in the frame of the map's SLAM"


def _fused(kept: Mapping[str, PoseGraph], graph: PoseGraph) -> tuple[PoseGraph, dict[str, float]]:
    """All nodes with the corrections of all drives, and the share each drive has in their certainty."""
    parts: list[GraphNodes] = []
    weight = dict.fromkeys(kept, 0.0)
    for name, own in kept.items():
        said = {n: _own(own) if n == name else _said(g, own.nodes.source_xyz_m) for n, g in kept.items()}
        joined = _joined(list(said.values()))
        shares = np.stack([_weights(s.var_m2, s.near) for s in said.values()])
        for n, share in zip(said, (shares / shares.sum(axis=0)).sum(axis=1).tolist(), strict=True):
            weight[n] += share
        parts.append(_moved(own.nodes, joined))
    total = sum(weight.values())
    nodes = GraphNodes(*(np.concatenate([getattr(p, f) for p in parts]) for f in GraphNodes.__slots__))
    known = np.isfinite(graph.nodes.sigma_m[:, 2]).any()
    return replace(graph, nodes=_levelled(nodes, bool(known))), {n: w / total for n, w in weight.items()}


def _moved(nodes: GraphNodes, said: Said) -> GraphNodes:
    sigma = np.sqrt(said.var_m2)
    return replace(
        nodes,
        xyz_m=np.column_stack([said.xy_m, nodes.source_xyz_m[:, 2] + said.lift_m]),
        yaw_rad=wrapped(nodes.source_yaw_rad + said.turn_rad),
        sigma_m=np.column_stack([sigma, sigma, np.sqrt(said.var_lift_m2)]),
        covariance_en_m2=np.zeros(len(nodes)),
        sigma_yaw_rad=np.sqrt(said.var_turn),
    )


def _levelled(nodes: GraphNodes, known: bool) -> GraphNodes:
    """Nodes whose height no drive knows are lifted as the nearest whose height one does.

    known : whether the map's own drive knows heights; if not, they stay as recorded everywhere
    """
    lift, sigma_m = nodes.xyz_m[:, 2] - nodes.source_xyz_m[:, 2], nodes.sigma_m.copy()
    has = np.isfinite(lift)
    if not known:
        lift, sigma_m[:, 2] = np.zeros(len(nodes)), np.nan
    elif not has.all():
        source = nodes.source_xyz_m[:, :2]
        lift[~has] = lift[has][cKDTree(source[has]).query(source[~has])[1]]
    xyz = np.column_stack([nodes.xyz_m[:, :2], nodes.source_xyz_m[:, 2] + lift])
    return replace(nodes, xyz_m=xyz, sigma_m=sigma_m)


def _table(
    graph: PoseGraph,
    drives: Mapping[str, AlignedDrive],
    kept: Mapping[str, PoseGraph],
    rows: Mapping[str, Mapping[str, object]],
    weight: Mapping[str, float],
) -> DriveUse:
    own = AlignedDrive(graph, "", int(graph.nodes.row[-1]) + 1, len(graph.gnss_use))
    all_of = {"": own, **dict(sorted(drives.items()))}

    def column(field: str, missing: object) -> list[object]:
        return [rows.get(name, {}).get(field, missing) for name in all_of]

    def figure(field: str) -> Floats:
        return np.array(
            [np.nan if d.graph is None else getattr(d.graph.figures, field) for d in all_of.values()]
        )

    return DriveUse(
        drive=strings(all_of),
        poses=np.array([d.poses for d in all_of.values()], dtype=np.int64),
        fixes=np.array([d.fixes for d in all_of.values()], dtype=np.int64),
        fixes_used=np.array(
            [0 if d.graph is None else d.graph.gnss_use.used.sum() for d in all_of.values()], dtype=np.int64
        ),
        common_places=np.array(column("common_places", 0), dtype=np.int64),
        disagreement_m=np.array(column("disagreement_m", np.nan), dtype=np.float64),
        disagreement_sigmas=np.array(column("disagreement_sigmas", np.nan), dtype=np.float64),
        weight=np.array([weight.get(name, 0.0) for name in all_of]),
        used=np.array([name in kept for name in all_of]),
        reason=strings(rows.get(name, {}).get("reason", "") or d.reason for name, d in all_of.items()),
        lever_forward_m=figure("lever_forward_m"),
        lever_left_m=figure("lever_left_m"),
        clock_offset_s=figure("clock_offset_s"),
    )
