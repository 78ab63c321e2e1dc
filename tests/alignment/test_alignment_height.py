"""Heights on drives over hills with known truth: SLAM that tilts, altitudes with every fault that loggers have."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from flexmap_tasks.alignment.altitudes import NEVER_MEASURED, NO_ALTITUDE, STANDS_OFF, ZERO, measured
from flexmap_tasks.alignment.heldout_height import heldout_heights
from flexmap_tasks.alignment.pose_graph import pose_graph
from flexmap_tasks.config import EvaluationParams, GraphHeldOutParams, PoseGraphParams
from flexmap_tasks.evaluation.graph_quality import graph_measures
from flexmap_tasks.evaluation.sigma_findings import sigma_findings
from flexmap_tasks.model.pose_graph import PoseGraph
from tests.climbs import Up, climbed
from tests.drives import HERE, Driven, driven, rmse, untimed

PLAIN = Up()


def adjusted(drive: Driven, up: Up = PLAIN) -> PoseGraph:
    return pose_graph(drive.slam, drive.gnss, HERE, None, None, PoseGraphParams(antenna_up_m=up.lever_up_m))


def error_m(drive: Driven, graph: PoseGraph) -> np.ndarray:
    return np.asarray(graph.nodes.xyz_m[:, 2] - drive.xyz[graph.nodes.row, 2])


FAULTS = {
    "none": PLAIN,
    "frame tilted by a degree": Up(tilt_rad=(0.02, -0.015)),
    "five times the drift": Up(walk_rad=1e-3),
    "held by gravity": Up(level_rad=3e-3, walk_rad=0.0),
    "slow errors": Up(slow_m=0.05),
    "10 m off for 300 m": Up(steps=((800, 1100, 10.0),)),
    "5 m off from the start": Up(steps=((0, 600, -5.0),)),
    "30 m off for 40 % of the way": Up(steps=((900, 2100, 30.0),)),
    "off between two gaps": Up(steps=((800, 1200, 8.0),), gaps=((700, 900), (1100, 1300))),
    "300 m without": Up(gaps=((1000, 1300),)),
    "every fifth anywhere": Up(outliers=0.2),
    "half a metre of scatter": Up(white_m=0.5),
    "rounded to decimetres": Up(resolution_m=0.1),
    "SLAM jumps by a metre": Up(slam_jumps=((1500.0, 1.0),)),
    "all of it": Up(
        slow_m=0.03, outliers=0.05, steps=((800, 1100, 10.0),), gaps=((1500, 1700),), tilt_rad=(0.02, 0.01)
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_heights_hold_whatever_altitudes_do(fault: str) -> None:
    up = FAULTS[fault]
    drive = climbed(driven(3000, 2), up, 2)
    graph = adjusted(drive, up)
    error = error_m(drive, graph)
    assert rmse(error) < 0.10
    assert 0.2 < rmse(error / graph.nodes.sigma_m[:, 2]) < 2.0  # what it predicts of itself


def test_altitudes_in_whole_metres_are_intervals() -> None:
    """Over hills the places where they change tell the height much better than the root of a twelfth."""
    up = Up(resolution_m=1.0)
    errors = []
    for seed in (1, 2, 3):
        drive = climbed(driven(3000, seed), up, seed)
        errors.append(rmse(error_m(drive, adjusted(drive, up))))
    assert np.mean(errors) < 0.10


def test_without_time_too() -> None:
    up = Up(tilt_rad=(0.01, 0.02), steps=((800, 1100, 10.0),))
    drive = untimed(climbed(driven(3000, 1), up, 1))
    assert rmse(error_m(drive, adjusted(drive, up))) < 0.10


def test_tilt_of_the_frame_is_found_and_its_deviation_honest() -> None:
    """A drive around corners tells both axes; what SLAM has wrong by drift is under a third of a degree."""
    drive = climbed(driven(3000, 2), Up(tilt_rad=(0.02, -0.015)), 2)
    nodes = adjusted(drive).nodes
    assert np.abs(nodes.tilt_xy_rad.mean(axis=0) - (-0.02, 0.015)).max() < 5e-3
    assert (nodes.sigma_tilt_rad > 0).all()
    assert (nodes.sigma_tilt_rad < 0.01).all()


def test_lever_arm_leans_with_the_road() -> None:
    """An antenna 2 m ahead and 1.4 m up, on hills of 15 %: left out, it would cost decimetres."""
    up = Up(hill_m=12.0, hill_length_m=120.0)
    drive = climbed(driven(3000, 2), up, 2)
    assert rmse(np.gradient(drive.xyz[:, 2]) / np.maximum(np.gradient(drive.along), 0.1)) > 0.07
    good = rmse(error_m(drive, adjusted(drive, up)))
    level = dataclasses.replace(drive.slam, quaternion=drive.slam.quaternion * [0.0, 0.0, 1.0, 1.0])
    norm = np.linalg.norm(level.quaternion, axis=1, keepdims=True)
    yaw_only = dataclasses.replace(level, quaternion=level.quaternion / norm)
    assert good < 0.05
    # a SLAM that knows yaw alone: its slopes are taken from its track
    assert rmse(error_m(drive, adjusted(drive._replace(slam=yaw_only), up))) < 0.08


def test_where_the_altitudes_end_the_deviation_grows() -> None:
    drive = climbed(driven(3000, 0), Up(gaps=((900, 99_999),)), 0)
    graph = adjusted(drive)
    sigma, error = graph.nodes.sigma_m[:, 2], np.abs(error_m(drive, graph))
    assert sigma[-1] > 10 * sigma[50]
    assert (error < 3 * sigma + 0.05).mean() > 0.95
    assert error.max() < 10.0  # SLAM's own drift, not a tilt run away


def test_altitudes_that_were_never_measured_are_named() -> None:
    drive = climbed(driven(1500, 0), PLAIN, 0)
    xyz = drive.gnss.xyz_m.copy()
    xyz[:, 2] = 0.0
    graph = adjusted(drive._replace(gnss=dataclasses.replace(drive.gnss, xyz_m=xyz)))
    assert np.isnan(graph.nodes.sigma_m[:, 2]).all()
    assert np.array_equal(graph.nodes.xyz_m[:, 2], graph.nodes.source_xyz_m[:, 2])
    assert set(graph.gnss_use.altitude_reason) <= {"", NEVER_MEASURED}
    assert (graph.gnss_use.altitude_reason == NEVER_MEASURED).sum() > 500
    assert not graph.gnss_use.altitude_used.any()


def test_zeros_among_altitudes() -> None:
    nan = np.nan
    assert measured(np.array([480.0, 0.0, nan, 481.0])).tolist() == ["", ZERO, NO_ALTITUDE, ""]
    assert measured(np.array([0.0, 0.0, nan])).tolist() == [NEVER_MEASURED, NEVER_MEASURED, NO_ALTITUDE]
    assert measured(np.array([1.0, 0.0, -1.0])).tolist() == ["", "", ""]  # at the sea


def test_every_altitude_says_what_became_of_it() -> None:
    up = Up(steps=((800, 1100, 10.0),), gaps=((1500, 1700),))
    use = adjusted(climbed(driven(3000, 2), up, 2), up).gnss_use
    reason = use.altitude_reason
    assert 200 < (reason == STANDS_OFF).sum() < 400
    assert (reason == NO_ALTITUDE).sum() > 100
    assert np.isfinite(use.altitude_residual_m[use.altitude_used]).all()
    assert np.percentile(np.abs(use.altitude_residual_m[use.altitude_used]), 95) < 0.1
    assert np.isnan(use.altitude_residual_m[~use.altitude_used]).all()


def test_one_altitude_lifts_all_of_the_drive() -> None:
    drive = climbed(driven(1500, 0), PLAIN, 0)
    xyz = drive.gnss.xyz_m.copy()
    xyz[:, 2] = np.where(np.arange(len(xyz)) // 5 == 100, xyz[:, 2], np.nan)
    graph = adjusted(drive._replace(gnss=dataclasses.replace(drive.gnss, xyz_m=xyz)))
    lift = graph.nodes.xyz_m[:, 2] - graph.nodes.source_xyz_m[:, 2]
    assert np.abs(error_m(drive, graph)).max() < 6.0
    assert np.isfinite(graph.nodes.sigma_m[:, 2]).all()
    assert np.ptp(lift) < 4.0  # nothing tells a tilt


def test_altitudes_that_were_withheld_are_met() -> None:
    up = Up(steps=((800, 1100, 10.0),), slow_m=0.03, stated=True)
    drive = climbed(driven(2500, 2), up, 2)
    params = GraphHeldOutParams(graph=PoseGraphParams(antenna_up_m=up.lever_up_m))
    judged = heldout_heights(drive.slam, drive.gnss, HERE, params)
    assert len(judged) > 1500
    middle = np.abs(judged.error_m)
    assert np.percentile(middle, 90) < 0.15
    assert 0.3 < np.median(middle) / np.median(judged.sigma_m) < 2.0
    inside = (judged.along_m > 820) & (judged.along_m < 1080)
    assert not inside.any()  # a stretch that stands off has no height to be met


def test_what_is_odd_about_altitudes_is_found() -> None:
    up = Up(steps=((800, 1100, 10.0),))
    graph = adjusted(climbed(driven(2500, 2), up, 2), up)
    found = sigma_findings(graph.nodes, EvaluationParams(), graph.gnss_use, graph.figures)
    assert found.code.tolist() == ["altitude-left-out"]
    assert STANDS_OFF in found.message[0]
    incomplete = dataclasses.replace(graph.figures, height="model, vertical datum X", height_share=0.6)
    found = sigma_findings(graph.nodes, EvaluationParams(), graph.gnss_use, incomplete)
    assert found.code.tolist() == ["altitude-left-out", "height-model-incomplete"]
    names = {
        m.name: m.value
        for m in graph_measures(graph.figures, graph.nodes, graph.gnss_use, None, EvaluationParams())
    }
    assert names["altitudes_used"] > 2000
    assert names["predicted_sigma_up_rmse"] < 0.1
