"""The quality table: its figures against simple sums, and the golden ones of the Garching route."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from flexmap_tasks.alignment.control_points import control_points
from flexmap_tasks.alignment.judge_points import judge_points
from flexmap_tasks.alignment.project import project_utm
from flexmap_tasks.alignment.rubber_sheet import rigid_warp, rubber_sheet
from flexmap_tasks.alignment.umeyama import umeyama
from flexmap_tasks.config import (
    EvaluationParams,
    GnssParams,
    PairParams,
    ProjectionParams,
    RubberSheetParams,
    SlamParams,
    UmeyamaParams,
)
from flexmap_tasks.evaluation.deviation import deviation
from flexmap_tasks.evaluation.quality import evaluate
from flexmap_tasks.evaluation.summary import statistics
from flexmap_tasks.formats.artifacts import encode
from flexmap_tasks.ingest.gnss import ingest_gnss
from flexmap_tasks.ingest.lanelet_map import ingest_lanelet_map
from flexmap_tasks.ingest.slam import ingest_slam
from flexmap_tasks.model.alignment import ControlPoints, RigidMotion, Warp
from flexmap_tasks.model.arrays import Floats, strings
from flexmap_tasks.model.conflation import LaneCheck, References, Transfers
from flexmap_tasks.model.maps import Findings
from flexmap_tasks.model.quality import Measure, Quality
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import GnssTrack, Trajectory

STILL = Warp(RigidMotion(np.eye(2), np.zeros(2), 1.0, 1.0, 0.0), None)


def gnss(xy_m: Floats, observed: list[bool] | None = None) -> GnssTrack:
    n = len(xy_m)
    return GnssTrack(
        np.column_stack([xy_m, np.full(n, np.nan)]), np.full((n, 3), np.nan), np.zeros(n, np.int64),
        np.arange(n), np.array(observed or [True] * n), None,
    )  # fmt: skip


def poses(xy_m: Floats) -> Trajectory:
    n = len(xy_m)
    return Trajectory(np.column_stack([xy_m, np.zeros(n)]), np.tile([0.0, 0, 0, 1], (n, 1)), None)


def numbers(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int64)


@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=30))
def test_statistics(values: list[float]) -> None:
    found = statistics(np.array([*values, np.nan]))
    n, mean = len(values), sum(values) / len(values)
    assert found["mean"] == pytest.approx(mean, abs=1e-6)
    assert found["std"] == pytest.approx((sum((v - mean) ** 2 for v in values) / n) ** 0.5, abs=1e-6)
    assert found["rmse"] == pytest.approx((sum(v * v for v in values) / n) ** 0.5, abs=1e-6)
    assert found["max"] == max(values)


def test_no_values_no_figures() -> None:
    assert set(statistics(np.empty(0)).values()) == {None}


@given(st.integers(0, 1000))
def test_deviation_is_the_distance_to_the_line(seed: int) -> None:
    chance = np.random.default_rng(seed)
    line, places = chance.normal(0, 50, (20, 2)), chance.normal(0, 50, (30, 2))
    expected = shapely.distance(shapely.linestrings(line), shapely.points(places))
    assert np.abs(deviation(places, gnss(line)).distance_m - expected).max() < 1e-7


def test_a_pose_beside_an_outage_is_not_valid() -> None:
    line = np.array([[0.0, 0], [10, 0], [50, 30], [60, 30]])
    found = deviation(
        np.array([[5.0, 1], [10, -1], [30, 15], [50, 32]]), gnss(line, [True, True, False, True])
    )
    assert found.valid.tolist() == [True, True, False, True]
    assert found.distance_m.tolist() == pytest.approx([1, 1, 0, 2])


@pytest.mark.parametrize(
    ("observed", "valid"),
    [
        ([True, True, True, False], [True, True, True]),
        ([True, True, False, False], [True, True, False]),
        ([True, False, False, False], [False, False, False]),
    ],
)
def test_validity_at_an_outage_does_not_hang_on_rounding(observed: list[bool], valid: list[bool]) -> None:
    """Outside of a corner, a place is as near to the step before as to the one behind: either makes it valid."""
    line = np.array([[0.0, 0], [10, 0], [10, 10], [10, 20]])
    turned = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    places = np.array([[9.0, 1e-9], [10.3, -0.4], [12.0, 5.0]])
    assert deviation(places @ turned.T, gnss(line @ turned.T, observed)).valid.tolist() == valid


def table(**more: object) -> Quality:
    inputs: dict[str, object] = dict.fromkeys(
        ("control_points", "references", "transfers", "lane_check", "map_findings", "transfer_findings")
    )
    line = np.array([[0.0, 0], [100, 0]])
    inputs |= {"slam": poses(np.array([[0.0, 1], [50, 3]])), "gnss": gnss(line), "warp": STILL, **more}
    return evaluate(params=EvaluationParams(**inputs.pop("limits", {})), **inputs)  # type: ignore[arg-type]


def test_deviation_before_and_after() -> None:
    moved = Warp(RigidMotion(np.eye(2), np.array([0.0, -1.0]), 1.0, 1.0, 0.0), None)
    quality = table(warp=moved)
    assert quality.value("deviation_after_all_mean") == pytest.approx(1.0)
    assert quality.value("deviation_before_all_rmse") == pytest.approx(2**0.5)
    assert quality.value("poses") == quality.value("poses_with_valid_gnss") == 2


@pytest.mark.parametrize(("limit", "passed"), [(2.2, False), (2.3, True), (None, None)])
def test_limits(limit: float | None, passed: bool | None) -> None:
    quality = table(limits={"deviation_rmse_max_m": limit})
    (measure,) = [m for m in quality.measures if m.name == "deviation_after_all_rmse"]
    assert measure.value == pytest.approx(5**0.5)
    assert measure.passed is passed
    assert quality.passed is (passed is not False)


def test_what_could_not_be_measured_does_not_pass() -> None:
    assert Measure.at_least("x", None, "1", 0.5).passed is False
    assert Measure.at_most("x", None, "1", 0.5).passed is False
    with pytest.raises(ValueError, match="cannot be measured"):
        Measure("x", float("nan"), "m")


def test_matching() -> None:
    references = References(
        numbers(0, 1, 2, 3), np.array([1.0, 10, 30, 60]), np.array([True, True, False, True]),
        np.array([0.9, 0.9, np.nan, 0.7]), np.full(4, 2.5), numbers(1, 1, 0, 1),
    )  # fmt: skip
    quality = table(references=references, limits={"match_rate_min": 0.7})
    assert quality.value("references") == 3
    assert quality.value("match_rate") == pytest.approx(2 / 3)
    assert quality.value("match_rate_by_length") == pytest.approx(0.7)
    assert quality.value("self_scored_precision") == pytest.approx(0.5)
    assert quality.passed is False


def test_counts() -> None:
    keys = strings(["speed_limit", "speed_limit", "road_name", ""])
    text = strings([""] * 4)
    transfers = Transfers(
        numbers(1, 2, 3, 4), numbers(1, 2, 3, 4), keys, text, text, numbers(1, 1, 1, 1), numbers(1, 1, 1, 1), text,
        np.ones(4), strings(["set", "review", "keep", "split"]), text,
    )  # fmt: skip
    check = LaneCheck(
        numbers(1, 2, 3, 4), numbers(1, 1, 1, 0), numbers(1, 1, 1, 1), numbers(1, 2, -1, -1),
        strings(["agree", "differ", "unknown", "unmatched"]),
        np.array([False, True, False, False]), text,
    )  # fmt: skip
    findings = Findings(strings(["a"]), strings(["warning"]), strings(["way"]), numbers(1), strings(["m"]))
    quality = table(transfers=transfers, lane_check=check, map_findings=findings, transfer_findings=findings)
    counts = {
        m.name: m.value for m in quality.measures if m.name.startswith(("transfers", "attr", "lanes", "find"))
    }
    assert counts == {
        "transfers_set": 1, "transfers_keep": 1, "transfers_review": 1, "transfers_split": 1, "transfers_remove": 0,
        "attribute_road_name_set": 0, "attribute_road_name_keep": 1, "attribute_road_name_review": 0,
        "attribute_speed_limit_set": 1, "attribute_speed_limit_keep": 0, "attribute_speed_limit_review": 1,
        "lanes_agree": 1, "lanes_differ": 1, "lanes_unknown": 1, "lanes_unmatched": 1, "lanes_agreement": 0.5,
        "findings_error": 0, "findings_warning": 2, "findings_info": 0,
    }  # fmt: skip


def test_what_moving_does_to_lanes(shared_data: Path) -> None:
    recorded = ingest_lanelet_map(Source("map", shared_data / "garching" / "lanelet2_route_1.osm"))
    wider, mirrored = (replace(recorded, xyz_m=recorded.xyz_m * (1, f, 1)) for f in (1.02, -1))
    limits = {"lane_width_change_max_m": 0.05}
    quality = table(recorded_map=recorded, moved_map=wider, limits=limits)
    assert 0.05 < (quality.value("lane_width_change_max") or 0) < 0.4
    assert 0 < (quality.value("lane_width_changed_over_10cm") or 0) < 0.2
    assert quality.value("lanelets_folded") == 0
    assert [m.name for m in quality.measures if m.passed is False] == ["lane_width_change_max"]
    folded = table(recorded_map=recorded, moved_map=mirrored)
    assert (folded.value("lanelets_folded") or 0) > 400
    assert not folded.passed


def test_every_name_once_and_json() -> None:
    quality = table()
    names = [m.name for m in quality.measures]
    assert len(names) == len(set(names))
    ((file, content),) = encode(quality, "quality")
    assert file == "quality.json"
    assert b'"deviation_after_all_p95"' in content


def test_control_points_before_and_after_the_warp() -> None:
    points = ControlPoints(
        strings(["a", "b"]), np.array([[0.0, 0], [5, 5]]), np.array([[3.0, 4], [99, 99]]), np.ones(2),
        np.array([True, False]), strings(["", ""]),
    )  # fmt: skip
    quality = table(control_points=judge_points(points, STILL.motion, STILL, None))
    assert quality.value("control_points") == 1
    assert quality.value("control_point_shift_max") == quality.value("control_point_residual_mean") == 5


@pytest.fixture(scope="module")
def garching(shared_data: Path) -> tuple[Quality, Quality]:
    """Rigid start alone, and the sheet with the ten points."""

    def source(name: str) -> Source:
        return Source(name, shared_data / "garching" / name)

    projected = project_utm(ingest_gnss(source("route_1_GPS.txt"), GnssParams()), ProjectionParams())
    slam = ingest_slam(source("route1_pose_kitti.txt"), SlamParams())
    track = projected.gnss_track
    motion = umeyama(slam, track, projected.projection, UmeyamaParams(grid_scale=False))
    points = control_points(
        source("control_points_peer.csv"), slam, track, motion, projected.projection, PairParams()
    )
    sheet = rubber_sheet(points, motion, slam, None, None, RubberSheetParams())
    rest = (None, None, None, None, None, EvaluationParams())
    judged = judge_points(points, motion, sheet, None)
    return evaluate(slam, track, rigid_warp(motion), None, *rest), evaluate(slam, track, sheet, judged, *rest)


def test_garching_rigid_start_as_the_original_measures_it(garching: tuple[Quality, Quality]) -> None:
    rigid, sheet = garching
    for statistic, golden in (("mean", 5.946), ("std", 5.226), ("rmse", 7.916)):
        assert rigid.value(f"deviation_after_all_{statistic}") == pytest.approx(golden, abs=6e-4)
        assert sheet.value(f"deviation_before_all_{statistic}") == pytest.approx(golden, abs=6e-4)
    assert rigid.value("rigid_rotation") == pytest.approx(-5.609090, abs=1e-5)


def test_garching_with_the_ten_points(garching: tuple[Quality, Quality]) -> None:
    sheet = garching[1]
    for statistic, most in (("mean", 1.00), ("std", 1.61), ("rmse", 1.90)):
        figure = sheet.value(f"deviation_after_all_{statistic}")
        assert figure is not None
        assert figure <= most
    valid, rmse = sheet.value("poses_with_valid_gnss"), sheet.value("deviation_after_valid_rmse")
    assert valid is not None
    assert rmse is not None
    assert 1100 <= valid <= 1140
    assert rmse < 0.85
    residual = sheet.value("control_point_residual_max")
    assert residual is not None
    assert residual < 1e-9
