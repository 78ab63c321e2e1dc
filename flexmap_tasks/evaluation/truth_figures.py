"""The figures of an evaluation against the truth, part by part."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from flexmap_tasks.config import TruthEvaluationParams
from flexmap_tasks.evaluation.attribute_truth import AttributeScore
from flexmap_tasks.evaluation.calibration import Reliability
from flexmap_tasks.evaluation.harm import Harm
from flexmap_tasks.evaluation.harm_geometry import ShapeChange
from flexmap_tasks.evaluation.map_truth import NodeErrors
from flexmap_tasks.evaluation.matching_truth import Score
from flexmap_tasks.evaluation.summary import measures_of, statistics
from flexmap_tasks.evaluation.trajectory_truth import PoseErrors, relative_errors
from flexmap_tasks.model.conflation import LaneCheck
from flexmap_tasks.model.osm import rows_of
from flexmap_tasks.model.quality import Measure
from flexmap_tasks.model.tracks import Trajectory
from flexmap_tasks.model.truth import TrueLanes, TruePoses

WIDE_CHANGE_M = 0.1


def trajectory_figures(
    errors: PoseErrors,
    estimate: Trajectory,
    true: Trajectory,
    truth: TruePoses,
    params: TruthEvaluationParams,
) -> Iterator[Measure]:
    """Absolute errors over all poses and by what GNSS was doing, then relative ones."""
    seen = ~truth.outage & ~truth.multipath
    yield from measures_of("trajectory_planar", errors.planar_m)
    for name, rows in (("gnss", seen), ("outage", truth.outage), ("multipath", truth.multipath)):
        figures = statistics(errors.planar_m[rows])
        limit = params.trajectory_rmse_max_m if name == "gnss" else None
        yield Measure.at_most(f"trajectory_planar_{name}_rmse", figures["rmse"], "m", limit)
        yield Measure(f"trajectory_planar_{name}_max", figures["max"], "m")
    for name, values in (("along", errors.along_m), ("across", errors.across_m), ("height", errors.up_m)):
        yield Measure(f"trajectory_{name}_bias", statistics(values)["mean"], "m")
        yield Measure(f"trajectory_{name}_rmse", statistics(values)["rmse"], "m")
        yield Measure(f"trajectory_{name}_std", statistics(values)["std"], "m")
    yield from measures_of("ape", errors.spatial_m)
    for every in params.relative_steps:
        shift, turn = relative_errors(estimate, true, every)
        yield Measure(f"rpe_{every}_translation_rmse", statistics(shift)["rmse"], "m")
        yield Measure(f"rpe_{every}_rotation_rmse", statistics(turn)["rmse"], "deg")


def map_figures(errors: NodeErrors, params: TruthEvaluationParams) -> Iterator[Measure]:
    """Errors of the nodes."""
    for measure in measures_of("map_planar", errors.planar_m):
        limit = params.map_error_p95_max_m if measure.name == "map_planar_p95" else None
        yield Measure.at_most(measure.name, measure.value, measure.unit, limit)
    for name, values in (
        ("along", errors.along_m),
        ("across", errors.across_m),
        ("height", errors.gap_m[:, 2]),
    ):
        yield Measure(f"map_{name}_rmse", statistics(values)["rmse"], "m")
        yield Measure(f"map_{name}_p95", statistics(np.abs(values))["p95"], "m")
    yield Measure("map_height_std", statistics(errors.gap_m[:, 2])["std"], "m")
    yield Measure("map_nodes", float(len(errors.node_id)), "count")
    yield Measure("map_nodes_without_truth", float(errors.unknown), "count")
    yield Measure("map_nodes_lost", float(errors.lost), "count")


def harm_figures(harm: Harm, shape: ShapeChange, params: TruthEvaluationParams) -> Iterator[Measure]:
    """What was done to the map besides moving it."""
    yield Measure.at_most("harm", float(harm.total), "count", float(params.harm_max))
    change = shape.width_change_m
    figures = statistics(change)
    yield Measure("width_change_p95", figures["p95"], "m")
    yield Measure.at_most("width_change_max", figures["max"], "m", params.width_change_max_m)
    wide = float((change > WIDE_CHANGE_M).mean()) if len(change) else None
    yield Measure("width_change_over_10cm", wide, "1")
    yield Measure.at_most("lanelets_folded", float(shape.folded.sum()), "count", 0.0)
    yield Measure("lanelets_not_compared", float(shape.skipped), "count")


def matching_figures(
    scores: Mapping[str, Score], found: Reliability, params: TruthEvaluationParams
) -> Iterator[Measure]:
    """The main figures of matching; the tables hold the rest."""
    for kind, score in scores.items():
        prefix = "match" if kind == "all" else f"match_{kind}"
        yield Measure(f"{prefix}_precision", score.precision, "1")
        yield Measure(f"{prefix}_recall", score.recall, "1")
        yield Measure(f"{prefix}_recall_with_review", score.recall_with_review, "1")
        limit = params.match_f1_min if kind == "all" else None
        yield Measure.at_least(f"{prefix}_f1", score.f1, "1", limit)
        yield Measure(f"{prefix}_lanelet_f1", score.lanelet_f1, "1")
    yield Measure.at_most("calibration_error", found.error, "1", params.calibration_error_max)


def attribute_figures(
    scores: Mapping[str, AttributeScore], params: TruthEvaluationParams
) -> Iterator[Measure]:
    """Share of metres whose value is wrong or missing."""
    for key, score in scores.items():
        yield Measure.at_most(f"attribute_{key}_error", score.error, "1", params.attribute_error_max)


def lane_figures(check: LaneCheck, truth: TrueLanes) -> Iterator[Measure]:
    """Share of lanelets whose verdict is the one that a faultless match gives."""
    row = rows_of(truth.lanelet_id, check.lanelet_id)
    known = row >= 0
    row, said = row[known], check.verdict[known]
    same = np.where(truth.lanes_drawn[row] == truth.lanes_osm[row], "agree", "differ")
    told = np.where(truth.lanes_osm[row] < 0, "unknown", same)
    expected = np.where(truth.way_id[row] == 0, "unmatched", told)
    yield Measure("lane_verdicts_right", float((said == expected).mean()) if len(said) else None, "1")
