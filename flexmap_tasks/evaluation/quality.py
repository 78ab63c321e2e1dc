"""What one run achieved, as far as it can be known without truth."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flexmap_tasks.config import EvaluationParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.evaluation.deviation import deviation
from flexmap_tasks.evaluation.graph_quality import graph_measures
from flexmap_tasks.evaluation.harm_geometry import shape_change
from flexmap_tasks.evaluation.summary import measures_of, statistics
from flexmap_tasks.geometry.sheet import affine_maps
from flexmap_tasks.model.alignment import JudgedPoints, Warp
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.conflation import LaneCheck, References, Transfers
from flexmap_tasks.model.maps import Findings, LaneletMap
from flexmap_tasks.model.match_statistics import match_statistics
from flexmap_tasks.model.pose_graph import GnssUse, GraphFigures, GraphNodes, HeldOut, HeldOutHeights
from flexmap_tasks.model.quality import Measure, Quality
from flexmap_tasks.model.tracks import GnssTrack, Trajectory

ACTIONS = ("set", "keep", "review", "split", "remove")
VERDICTS = ("agree", "differ", "unknown", "unmatched")
MUCH_WIDER_M = 0.10
"""A lane that is this much wider or narrower is another lane."""

SEVERITIES = ("error", "warning", "info")


@stage("quality")
def evaluate(
    slam: Trajectory,
    gnss: GnssTrack,
    warp: Warp,
    control_points: JudgedPoints | None,
    references: References | None,
    transfers: Transfers | None,
    lane_check: LaneCheck | None,
    map_findings: Findings | None,
    transfer_findings: Findings | None,
    params: EvaluationParams,
    antenna: Trajectory | None = None,
    drive_findings: Findings | None = None,
    graph_figures: GraphFigures | None = None,
    graph_nodes: GraphNodes | None = None,
    gnss_use: GnssUse | None = None,
    held_out: HeldOut | None = None,
    held_out_heights: HeldOutHeights | None = None,
    recorded_map: LaneletMap | None = None,
    moved_map: LaneletMap | None = None,
) -> Quality:
    """The figures of a map update.

    slam : the poses in their own frame; gnss : the fixes in the map frame; warp : from the one to the other
    antenna : the poses of the antenna where the alignment knows its lever arm: these are compared with the GNSS
    recorded_map, moved_map : the lanelets before and after they were moved, where they were
    The rest is None where the run had no such step.
    """
    after_m = warp.apply(slam.xyz_m) if antenna is None else antenna.xyz_m
    measures = [*_deviations(slam, gnss, warp, after_m, params), *_alignment(warp)]
    if graph_figures is not None and graph_nodes is not None and gnss_use is not None:
        measures += graph_measures(graph_figures, graph_nodes, gnss_use, held_out, params, held_out_heights)
    if control_points is not None:
        measures += _residuals(control_points)
    if recorded_map is not None and moved_map is not None:
        measures += _shape(recorded_map, moved_map, params)
    if references is not None:
        measures += _matching(references, params)
    if transfers is not None:
        measures += _attributes(transfers)
    if lane_check is not None:
        measures += _lanes(lane_check)
    findings = [f for f in (drive_findings, map_findings, transfer_findings) if f is not None]
    if findings:
        severity = np.concatenate([f.severity for f in findings])
        measures += [_count(f"findings_{s}", severity == s) for s in SEVERITIES]
    return Quality(tuple(measures))


def _deviations(
    slam: Trajectory, gnss: GnssTrack, warp: Warp, after_m: Floats, params: EvaluationParams
) -> Iterator[Measure]:
    """Before: after the rigid start alone. Which poses have valid GNSS is seen from where the warp puts them."""
    after = deviation(after_m, gnss)
    before = deviation(warp.motion.apply_xy(slam.xyz_m[:, :2]), gnss)
    poses_m = warp.apply(slam.xyz_m)
    valid = after.valid if np.array_equal(poses_m, after_m) else deviation(poses_m, gnss).valid
    yield _count("poses", np.ones(len(slam), dtype=bool))
    yield _count("poses_with_valid_gnss", valid)
    yield from measures_of("deviation_before_all", before.distance_m)
    yield from measures_of("deviation_before_valid", before.distance_m[valid])
    for measure in measures_of("deviation_after_all", after.distance_m):
        judged = measure.name == "deviation_after_all_rmse"
        limit = params.deviation_rmse_max_m if judged else None
        yield Measure.at_most(measure.name, measure.value, measure.unit, limit)
    yield from measures_of("deviation_after_valid", after.distance_m[after.valid])


def _alignment(warp: Warp) -> Iterator[Measure]:
    motion = warp.motion
    yield Measure("rigid_rotation", float(np.degrees(motion.angle_rad)), "deg")
    yield Measure("rigid_translation_x", float(motion.translation_m[0]), "m")
    yield Measure("rigid_translation_y", float(motion.translation_m[1]), "m")
    yield Measure("rigid_grid_scale", motion.grid_scale, "1")
    yield Measure("rigid_fitted_scale", motion.fitted_scale, "1")
    yield Measure("rigid_rmse", motion.rmse_m, "m")
    sheet = warp.sheet
    if sheet is None or len(sheet.triangles) == 0:
        return
    corners = sheet.source_xy_m[sheet.triangles], sheet.target_xy_m[sheet.triangles]
    stretch = np.linalg.svd(affine_maps(*corners)[:, :, :2], compute_uv=False)
    yield Measure("sheet_triangles", float(len(sheet.triangles)), "count")
    yield Measure("sheet_stretch_min", float(stretch.min()), "1")
    yield Measure("sheet_stretch_max", float(stretch.max()), "1")


def _residuals(points: JudgedPoints) -> Iterator[Measure]:
    """How far the rigid start leaves the control points in use, the warp, and a warp that was not told of them."""
    used = points.used
    shift = np.hypot(*(points.target_xy_m - points.source_xy_m).T)
    yield _count("control_points", used)
    columns = (
        ("shift", shift), ("residual", points.residual_m), ("leave_one_out", points.leave_one_out_m),
    )  # fmt: skip
    for name, column in columns:
        figures = statistics(column[used])
        for figure in ("mean", "rmse", "max"):
            yield Measure(f"control_point_{name}_{figure}", figures[figure], "m")


def _shape(recorded: LaneletMap, moved: LaneletMap, params: EvaluationParams) -> Iterator[Measure]:
    """What moving the map did to its lanes: nine cross sections of every lanelet."""
    shape = shape_change(recorded, moved)
    change = shape.width_change_m[np.isfinite(shape.width_change_m)]
    for measure in measures_of("lane_width_change", change):
        limit = params.lane_width_change_max_m if measure.name == "lane_width_change_max" else None
        yield Measure.at_most(measure.name, measure.value, measure.unit, limit)
    wider = float((change > MUCH_WIDER_M).mean()) if len(change) else None
    yield Measure("lane_width_changed_over_10cm", wider, "1")
    folded = float(np.count_nonzero(shape.folded))
    yield Measure.at_most("lanelets_folded", folded, "count", params.lanelets_folded_max)


def _matching(references: References, params: EvaluationParams) -> Iterator[Measure]:
    found = match_statistics(references, params.short_reference_m, params.true_positive_score)
    yield Measure("references", float(found.references), "count")
    yield Measure("references_length", found.length_m, "m")
    yield Measure("references_matched", float(found.matched), "count")
    yield Measure.at_least("match_rate", found.rate, "1", params.match_rate_min)
    yield Measure("match_rate_by_length", found.rate_by_length, "1")
    yield Measure("self_scored_precision", found.self_scored_precision, "1")
    yield Measure("match_score_mean", found.mean_score, "1")


def _attributes(transfers: Transfers) -> Iterator[Measure]:
    """How often each key was set, kept and put up for review; then what happened to lanelets as a whole."""
    for action in ACTIONS:
        yield _count(f"transfers_{action}", transfers.action == action)
    for key in sorted(set(transfers.key.tolist()) - {""}):
        for action in ("set", "keep", "review"):
            yield _count(f"attribute_{key}_{action}", (transfers.key == key) & (transfers.action == action))


def _lanes(check: LaneCheck) -> Iterator[Measure]:
    for verdict in VERDICTS:
        yield _count(f"lanes_{verdict}", check.verdict == verdict)
    agree, differ = (int((check.verdict == v).sum()) for v in ("agree", "differ"))
    yield Measure("lanes_agreement", agree / (agree + differ) if agree + differ else None, "1")


def _count(name: str, rows: np.ndarray) -> Measure:
    return Measure(name, float(np.count_nonzero(rows)), "count")
