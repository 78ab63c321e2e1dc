"""The pose graph: SLAM, GNSS through its lever arm, revisits and control points in one adjustment."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.alignment.drive import Drive, drive_of
from flexmap_tasks.alignment.height import Raised, raised
from flexmap_tasks.alignment.observations import ACROSS, ALONG, GNSS, YAW
from flexmap_tasks.alignment.plausible import refuse_other_drive, refuse_steep, refuse_still, refuse_unsure
from flexmap_tasks.alignment.revisits import passes
from flexmap_tasks.alignment.solve import Solved, solve
from flexmap_tasks.config import PoseGraphParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.geometry.graph2d import Fix, State, at_nodes, relative_rows
from flexmap_tasks.geometry.normal_equations import inverse_on_pattern
from flexmap_tasks.geometry.polyline import steps_m
from flexmap_tasks.geometry.se2 import rotated, wrapped
from flexmap_tasks.model.alignment import ControlPoints, RigidMotion, Warp
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.bend import Bend
from flexmap_tasks.model.height_model import HeightModel
from flexmap_tasks.model.pose_graph import GnssUse, GraphFigures, GraphNodes, PoseGraph
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import GnssTrack, Trajectory

MIN_POSES = 3

AGREED_SIGMAS = 4.0
"""A revisit that the solution leaves by less than this many deviations is agreed with."""

STEP_M, STEP_RAD = 2.0**-13, 2.0**-20
"""What corrections are rounded to: 0.12 mm, and 0.03 mm at the blend's usual reach; powers of two, so exact."""

MIN_AREA_SHARE = 0.2
"""The plane around the poses may be squeezed, but never to less than this."""


@stage("pose_graph")
def pose_graph(
    slam: Trajectory,
    gnss: GnssTrack,
    projection: Projection,
    points: ControlPoints | None,
    points_motion: RigidMotion | None,
    params: PoseGraphParams,
    height_model: HeightModel | None = None,
) -> PoseGraph:
    """The drive adjusted, with a predicted deviation for every pose and no hand input needed.

    points, points_motion : the user's control points, if any, and the rigid start their sources are given after
    height_model : the ground that the drive is laid onto, where the parameters say so
    Raises AlignmentError when the tracks do not determine an alignment.
    """
    drive = checked_drive(slam, params)
    control = control_of(points, points_motion, drive)
    solved = solve(
        drive, gnss, first_stamp(slam), float(np.log(projection.grid_scale_factor)), control, params
    )
    refuse_other_drive(drive, solved)
    up = raised(slam, gnss, drive, solved, projection, params, height_model)
    nodes = _nodes(drive, solved, up)
    refuse_unsure(nodes.sigma_m[np.unique(solved.found.fix.node), :2])
    return PoseGraph(
        _motion(solved),
        nodes,
        _figures(drive, solved, up, params.revisit_radius_m),
        _use(gnss, solved, up),
    )


@stage("warp")
def pose_graph_warp(graph: PoseGraph, params: PoseGraphParams, slam: Trajectory | None = None) -> Warp:
    """The plane moved by blended pose corrections, rounded far below what they are known to.

    Rounding lets differences that mean nothing, such as those of another processor's last bits, vanish.
    slam : the drive of the graph; with its stamps the warp can also move points by their time
    Raises AlignmentError when the corrections fold the plane near the drive.
    """
    nodes = graph.nodes
    stamp_ns = None if slam is None or slam.stamp_ns is None else slam.stamp_ns[nodes.row]
    bend = Bend(
        source_xy_m=np.ascontiguousarray(nodes.source_xyz_m[:, :2]),
        target_xy_m=_rounded(nodes.xyz_m[:, :2], STEP_M),
        turn_rad=_rounded(wrapped(nodes.yaw_rad - nodes.source_yaw_rad), STEP_RAD),
        stretch=_rounded(np.full(len(nodes), graph.figures.scale), STEP_RAD),
        lift_m=_rounded(nodes.xyz_m[:, 2] - nodes.source_xyz_m[:, 2], STEP_M),
        sigma_m=_rounded(np.sqrt((nodes.sigma_m[:, :2] ** 2).mean(axis=1)), STEP_M),
        sigma_turn_rad=_rounded(nodes.sigma_yaw_rad, STEP_RAD),
        blend_m=np.full(len(nodes), params.blend_sigma_m),
        source_z_m=np.ascontiguousarray(nodes.source_xyz_m[:, 2]),
        tilt_xy_rad=_rounded(nodes.tilt_xy_rad, STEP_RAD),
        stretch_up=_rounded(np.full(len(nodes), graph.figures.scale_up), STEP_RAD),
        sigma_up_m=_rounded(nodes.sigma_m[:, 2], STEP_M),
        sigma_tilt_rad=_rounded(nodes.sigma_tilt_rad, STEP_RAD),
        stamp_ns=stamp_ns,
    )
    warp = Warp(graph.motion, None, bend=bend)
    _refuse_folds(warp, nodes)
    return warp


def _rounded(values: Floats, step: float) -> Floats:
    whole: Floats = np.round(values / step)
    return np.ascontiguousarray(whole * step)


@stage("antenna_track")
def antenna_track(graph: PoseGraph) -> Trajectory:
    """Where the graph has the antenna at every node: what is comparable with the GNSS line."""
    nodes, figures = graph.nodes, graph.figures
    lever = np.tile([figures.lever_forward_m, figures.lever_left_m], (len(nodes), 1))
    xy_m = nodes.xyz_m[:, :2] + rotated(lever, nodes.yaw_rad)
    half = nodes.yaw_rad / 2
    quaternion = np.column_stack([np.zeros((len(nodes), 2)), np.sin(half), np.cos(half)])
    return Trajectory(np.column_stack([xy_m, nodes.xyz_m[:, 2]]), quaternion, None)


def first_stamp(slam: Trajectory) -> int:
    """Stamp of the first pose; 0 when there is no time."""
    return 0 if slam.stamp_ns is None else int(slam.stamp_ns[0])


def checked_drive(slam: Trajectory, params: PoseGraphParams) -> Drive:
    """The drive, refused when it stands still or its height is not in z."""
    refuse_steep(slam.xyz_m)
    refuse_still(slam.xyz_m[:, :2], "SLAM trajectory")
    if len(slam) >= MIN_POSES:
        drive = drive_of(slam, params.node_spacing_m)
        if len(drive.node) >= MIN_POSES:
            return drive
    raise AlignmentError(
        "SLAM trajectory",
        f"{len(slam)} poses over {steps_m(slam.xyz_m[:, :2]).sum():.1f} m; a drive of at least "
        f"{MIN_POSES} poses {params.node_spacing_m:g} m apart is needed",
    )


def no_control() -> tuple[Fix, Floats]:
    """No control points."""
    none = np.empty((0, 2))
    row = np.empty(0, np.int64)
    return at_nodes(row, none, row, none, none[:, 0]), np.empty(0)


def control_of(points: ControlPoints | None, motion: RigidMotion | None, drive: Drive) -> tuple[Fix, Floats]:
    """The user's points, each seen from the node it is nearest to."""
    rows = np.empty(0, np.int64) if points is None else np.flatnonzero(points.used)
    if points is None or motion is None or len(rows) == 0:
        return no_control()
    nodes = drive.pose[drive.node]
    source = motion.inverse().apply_xy(points.source_xy_m[rows])
    nearest = ((source[:, None] - nodes[:, :2]) ** 2).sum(axis=2).argmin(axis=1)
    body = rotated(source - nodes[nearest, :2], -nodes[nearest, 2])
    fix = at_nodes(nearest, body, drive.part[nearest], points.target_xy_m[rows], np.zeros(len(rows)))
    return fix, points.sigma_m[rows]


def _motion(solved: Solved) -> RigidMotion:
    fit = solved.fit
    return RigidMotion(fit.rotation, fit.translation, 1.0, fit.scale, fit.rmse)


def _nodes(drive: Drive, solved: Solved, up: Raised) -> GraphNodes:
    row, state = drive.node, solved.solution.state
    source, z = drive.pose[row], drive.z_m[row]
    inverse = inverse_on_pattern(solved.solution.lu)
    at = 3 * np.arange(len(row))
    variance = np.maximum(inverse.diagonal()[: 3 * len(row)].reshape(-1, 3), 0.0)
    covariance = np.asarray(inverse[at, at + 1]).ravel()
    return GraphNodes(
        row=row.astype(np.int64),
        source_xyz_m=np.column_stack([source[:, :2], z]),
        source_yaw_rad=source[:, 2],
        xyz_m=np.column_stack([state.pose[:, :2], z + up.lift_m]),
        yaw_rad=wrapped(state.pose[:, 2]),
        sigma_m=np.column_stack([np.sqrt(variance[:, :2]), up.sigma_m]),
        covariance_en_m2=covariance,
        sigma_yaw_rad=np.sqrt(variance[:, 2]),
        tilt_xy_rad=up.tilt,
        sigma_tilt_rad=up.sigma_tilt,
    )


def _figures(drive: Drive, solved: Solved, up: Raised, radius_m: float) -> GraphFigures:
    state, scale = solved.solution.state, solved.solution.scale
    shared = state.shared.tolist()
    variance = inverse_on_pattern(solved.solution.lu).diagonal()[-4:]
    sigma = np.sqrt(np.maximum(variance, 0.0)).tolist()
    return GraphFigures(
        timed=solved.timed,
        lever_forward_m=shared[0],
        lever_left_m=shared[1],
        scale=float(np.exp(shared[2])),
        clock_offset_s=shared[3],
        sigma_lever_forward_m=sigma[0],
        sigma_lever_left_m=sigma[1],
        sigma_scale=sigma[2],
        sigma_clock_offset_s=sigma[3],
        noise_along_m=float(scale[ALONG]),
        noise_across_m=float(scale[ACROSS]),
        noise_yaw_rad=float(scale[YAW]),
        noise_gnss=float(scale[GNSS]),
        revisit_edges=len(solved.known.revisit.first),
        revisit_agreement=_agreement(solved, state),
        revisit_disagreement_m=_disagreement(drive, state, radius_m),
        scale_up=up.scale,
        noise_climb_m=up.noise_climb_m,
        noise_tilt_rad=up.noise_tilt_rad,
        noise_altitude=up.noise_altitude,
        height=up.height,
        height_share=up.share,
    )


def _disagreement(drive: Drive, state: State, radius_m: float) -> float:
    """90th percentile over all pairs of passes, in the plane."""
    pairs = passes(drive.pose[drive.node], radius_m)
    if len(pairs.first) == 0:
        return 0.0
    gap = relative_rows(state, pairs).residual.reshape(-1, 3)
    return float(np.percentile(np.hypot(gap[:, 0], gap[:, 1]), 90))


def _agreement(solved: Solved, state: State) -> float:
    revisit = solved.known.revisit
    if len(revisit.first) == 0:
        return 1.0
    gap = relative_rows(state, revisit).residual.reshape(-1, 3)
    limit = AGREED_SIGMAS * max(float(solved.solution.scale[ALONG]), 0.05)
    return float((np.hypot(gap[:, 0], gap[:, 1]) < limit).mean())


def _use(gnss: GnssTrack, solved: Solved, up: Raised) -> GnssUse:
    used, residual = np.zeros(len(gnss), bool), np.full(len(gnss), np.nan)
    index = solved.line.fix[solved.found.line_row]
    from_group = solved.solution.groups[GNSS]
    after = from_group.residual + from_group.jacobian @ solved.solution.step
    used[solved.line.fix] = True
    used[solved.reason != ""] = False
    residual[index] = np.hypot(*after.reshape(-1, 2).T) if solved.timed else np.abs(after)
    return GnssUse(
        gnss.row,
        used,
        solved.reason,
        residual,
        up.altitude_used,
        up.altitude_reason,
        up.altitude_residual_m,
    )


def _refuse_folds(warp: Warp, nodes: GraphNodes) -> None:
    around = np.array([[0, 0], [10, 0], [-10, 0], [0, 10], [0, -10], [25, 25], [-25, -25]], float)
    xy = (nodes.source_xyz_m[:, None, :2] + around).reshape(-1, 2)
    z = np.repeat(nodes.source_xyz_m[:, 2], len(around))
    area = np.linalg.det(warp.jacobian(np.column_stack([xy, z])))
    worst = int(area.argmin())
    if area[worst] < MIN_AREA_SHARE:
        row = int(nodes.row[worst // len(around)])
        raise AlignmentError(
            "SLAM trajectory",
            f"the corrections of neighbouring poses contradict each other: the plane shrinks to {area[worst]:.2f} of "
            "its area; check the SLAM trajectory for a jump",
            f"near pose {row}",
        )
