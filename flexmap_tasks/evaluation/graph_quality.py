"""The figures of a pose graph: what it estimated, what it left out, and how far it can be trusted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flexmap_tasks.config import EvaluationParams
from flexmap_tasks.evaluation.sigma_findings import axis_sigma_m
from flexmap_tasks.evaluation.summary import measures_of
from flexmap_tasks.model.pose_graph import GnssUse, GraphFigures, GraphNodes, HeldOut, HeldOutHeights
from flexmap_tasks.model.quality import Measure

AECC_BAND_M = (0.10, 0.20)
"""Accuracy that automated driving asks of a map (AECC 2020, as the paper quotes it)."""


def graph_measures(
    figures: GraphFigures,
    nodes: GraphNodes,
    use: GnssUse,
    held_out: HeldOut | None,
    params: EvaluationParams,
    held_out_heights: HeldOutHeights | None = None,
) -> Iterator[Measure]:
    """Estimates, predicted deviations per axis in the plane, and errors on withheld GNSS where there are any."""
    yield Measure("lever_arm_forward", figures.lever_forward_m, "m")
    yield Measure("lever_arm_left", figures.lever_left_m, "m")
    yield Measure("slam_scale", figures.scale, "1")
    yield Measure("clock_offset", figures.clock_offset_s, "s")
    yield Measure("revisit_edges", float(figures.revisit_edges), "count")
    yield Measure("revisit_agreement", figures.revisit_agreement, "1")
    passes = figures.revisit_disagreement_m if figures.revisit_edges else None
    yield Measure("revisit_disagreement_p90", passes, "m")
    yield Measure("gnss_used", float(np.count_nonzero(use.used)), "count")
    yield Measure("gnss_left_out", float(np.count_nonzero(~use.used)), "count")
    for measure in measures_of("predicted_sigma", axis_sigma_m(nodes)):
        limit = params.sigma_max_m if measure.name == "predicted_sigma_max" else None
        yield Measure.at_most(measure.name, measure.value, measure.unit, limit)
    yield from _heights(figures, nodes, use, held_out_heights)
    if held_out is None:
        return
    yield Measure("held_out_poses", float(len(held_out)), "count")
    for measure in measures_of("held_out_error", held_out.distance_m):
        limit = params.held_out_rmse_max_m if measure.name == "held_out_error_rmse" else None
        yield Measure.at_most(measure.name, measure.value, measure.unit, limit)
    for band in AECC_BAND_M:
        share = float((held_out.distance_m <= band).mean()) if len(held_out) else None
        yield Measure(f"held_out_within_{100 * band:.0f}cm", share, "1")
    yield from (
        m for m in measures_of("held_out_predicted_sigma", held_out.sigma_m) if m.name.endswith("_rmse")
    )


def _heights(
    figures: GraphFigures, nodes: GraphNodes, use: GnssUse, held_out: HeldOutHeights | None
) -> Iterator[Measure]:
    """Predicted deviation of heights, what became of altitudes, and errors on withheld ones where there are any."""
    yield from measures_of("predicted_sigma_up", nodes.sigma_m[:, 2])
    yield from measures_of("predicted_sigma_tilt", np.degrees(nodes.sigma_tilt_rad), "deg")
    yield Measure("height_known_share", figures.height_share, "1")
    yield Measure("altitudes_used", float(np.count_nonzero(use.altitude_used)), "count")
    left_out = ~use.altitude_used & (use.altitude_reason != "") & (use.altitude_reason != "no altitude")
    yield Measure("altitudes_left_out", float(np.count_nonzero(left_out)), "count")
    told = use.altitude_used & (use.altitude_reason == "")
    yield from measures_of("altitude_residual", np.abs(use.altitude_residual_m[told]))
    if held_out is None:
        return
    yield Measure("held_out_altitudes", float(len(held_out)), "count")
    yield from measures_of("held_out_height_error", np.abs(held_out.error_m))
    yield from (
        m
        for m in measures_of("held_out_height_predicted_sigma", held_out.sigma_m)
        if m.name.endswith("_rmse")
    )
