"""A release judged by the truth of the world its recording came from."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from flexmap_tasks.config import TruthEvaluationParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.evaluation import plots, truth_figures
from flexmap_tasks.evaluation.attribute_truth import attribute_scores
from flexmap_tasks.evaluation.calibration import BINS, Reliability, reliability
from flexmap_tasks.evaluation.harm import harm_done
from flexmap_tasks.evaluation.harm_geometry import shape_change
from flexmap_tasks.evaluation.lineage import lineage, onto_sources
from flexmap_tasks.evaluation.map_truth import node_errors
from flexmap_tasks.evaluation.markdown import markdown
from flexmap_tasks.evaluation.matching_truth import (
    Prediction,
    judge_matches,
    prediction_of,
    review_confusion,
    score_by_kind,
)
from flexmap_tasks.evaluation.nearest_way import nearest_way
from flexmap_tasks.evaluation.trajectory_truth import in_step, pose_errors, true_trajectory
from flexmap_tasks.geometry.polyline import arc_length_m
from flexmap_tasks.model.conflation import LaneCheck, Matches, Transfers
from flexmap_tasks.model.lanelets import lanelets_of
from flexmap_tasks.model.maps import LaneletMap, PlacedRoads, RoadNetwork
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.quality import Measure, Quality
from flexmap_tasks.model.tracks import Trajectory
from flexmap_tasks.model.truth import Truth

FORMAT = 1


@dataclass(slots=True)
class Evaluation:
    """What is being put together: figures, tables by name, and files by name."""

    measures: list[Measure] = field(default_factory=list)
    tables: dict[str, Any] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)


@stage("evaluation")
def evaluate_release(
    before: LaneletMap | None,
    finished: LaneletMap | None,
    aligned: Trajectory,
    projection: Projection,
    matches: Matches | None,
    baseline: Matches | None,
    transfers: Transfers | None,
    lane_check: LaneCheck | None,
    roads: RoadNetwork | None,
    quality: Quality | None,
    truth: Truth,
    params: TruthEvaluationParams,
) -> dict[str, bytes]:
    """`evaluation.json`, `evaluation.md` and plots.

    before : the map as drawn; finished : the map as written, its `xyz_m` in the map frame; aligned : the poses
    in the map frame; baseline : what buffer growing makes of the same map, where `matches` are another's
    quality : the run's own figures, shown beside under their own names
    """
    made = Evaluation()
    _trajectory(made, aligned, projection, truth, params)
    if before is not None and finished is not None:
        _map(made, before, finished, transfers, projection, truth, params)
        if matches is not None and roads is not None:
            placed = PlacedRoads(roads, projection.to_xy_m(roads.lonlat_deg))
            lanelets = lanelets_of(finished)
            nearest = nearest_way(finished, placed, params.lane_subtypes)
            nearest = onto_sources(nearest, lanelets, lineage(finished, lanelets, transfers))
            _matching(made, matches, nearest, baseline, truth, params)
        if transfers is not None:
            _attributes(made, before, finished, transfers, truth, params)
    if lane_check is not None:
        made.measures += truth_figures.lane_figures(lane_check, truth.lanes)
    if quality is not None:
        made.tables["run"] = {m.name: {"value": m.value, "unit": m.unit} for m in quality.measures}
    document = {"format": FORMAT, "measures": [asdict(m) for m in made.measures], **made.tables}
    text = json.dumps(document, indent=1, allow_nan=False) + "\n"
    return {
        "evaluation.json": text.encode(),
        "evaluation.md": markdown(made.measures, made.tables).encode(),
        **made.files,
    }


def _trajectory(
    made: Evaluation, aligned: Trajectory, projection: Projection, truth: Truth, params: TruthEvaluationParams
) -> None:
    true, estimate = true_trajectory(truth.poses, projection), in_step(aligned, truth.poses)
    errors = pose_errors(estimate, true, truth.poses.yaw_rad)
    made.measures += truth_figures.trajectory_figures(errors, estimate, true, truth.poses, params)
    along = arc_length_m(true.xyz_m[:, :2])
    made.files["error_along_route.svg"] = plots.error_along_route(
        along, errors.planar_m, errors.up_m, truth.poses.outage
    )


def _map(
    made: Evaluation,
    before: LaneletMap,
    finished: LaneletMap,
    transfers: Transfers | None,
    projection: Projection,
    truth: Truth,
    params: TruthEvaluationParams,
) -> None:
    errors = node_errors(finished, truth.nodes, projection)
    made.measures += truth_figures.map_figures(errors, params)
    gone = np.empty(0, dtype=np.int64)
    if transfers is not None:
        gone = transfers.lanelet_id[transfers.action == "remove"]
    harm, shape = harm_done(before, finished, moved=True, deleted=gone), shape_change(before, finished)
    made.measures += truth_figures.harm_figures(harm, shape, params)
    made.tables["harm"] = harm.counts
    made.tables["harm_info"] = harm.info
    made.files["error_map.svg"] = plots.error_map(errors.true_xy_m, errors.planar_m)
    made.files["width_change.svg"] = plots.width_change_histogram(shape.width_change_m)


def _matching(
    made: Evaluation,
    matches: Matches,
    nearest: Prediction,
    baseline: Matches | None,
    truth: Truth,
    params: TruthEvaluationParams,
) -> None:
    judged = judge_matches(prediction_of(matches), truth.matches)
    scores, found = score_by_kind(judged), reliability(judged)
    made.measures += truth_figures.matching_figures(scores, found, params)
    methods = {"release": scores, "nearest_way": score_by_kind(judge_matches(nearest, truth.matches))}
    if baseline is not None:
        methods["buffer_growing"] = score_by_kind(judge_matches(prediction_of(baseline), truth.matches))
    made.tables["matching"] = {
        method: {kind: asdict(score) for kind, score in by_kind.items()}
        for method, by_kind in methods.items()
    }
    made.tables["review"] = review_confusion(judged)
    made.tables["reliability"] = _bins(found)
    made.files["reliability.svg"] = plots.reliability_diagram(found)


def _attributes(
    made: Evaluation,
    before: LaneletMap,
    finished: LaneletMap,
    transfers: Transfers,
    truth: Truth,
    params: TruthEvaluationParams,
) -> None:
    junctions = np.unique(truth.matches.lanelet_id[truth.matches.kind == "junction"])
    scores = attribute_scores(before, finished, transfers, truth.tags, junctions)
    made.measures += truth_figures.attribute_figures(scores, params)
    made.tables["attributes"] = {key: asdict(score) for key, score in scores.items()}


def _bins(found: Reliability) -> list[dict[str, float | None]]:
    return [
        {
            "from": k / BINS,
            "to": (k + 1) / BINS,
            "metres": float(found.metres[k]),
            "confidence": float(found.confidence[k]) if found.metres[k] else None,
            "accuracy": float(found.accuracy[k]) if found.metres[k] else None,
        }
        for k in range(BINS)
    ]
