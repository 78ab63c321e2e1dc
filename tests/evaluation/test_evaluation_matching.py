"""Matches against the truth, on made-up lanelets whose figures can be said in advance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexmap_tasks.evaluation.calibration import reliability
from flexmap_tasks.evaluation.matching_truth import (
    Prediction,
    judge_matches,
    prediction_of,
    review_confusion,
    score,
    score_by_kind,
)
from flexmap_tasks.geometry.overlay import overlay
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.conflation import Matches
from flexmap_tasks.model.truth import TrueMatches


def ints(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int64)


TRUTH = TrueMatches(
    lanelet_id=ints(1, 1, 2, 3, 4), s_from_m=np.array([0.0, 40, 0, 0, 0]), s_to_m=np.array([40.0, 100, 50, 20, 30]),
    lanelet_length_m=np.array([100.0, 100, 50, 20, 30]), way_id=ints(10, 11, 12, 0, 13),
    also_way_id=ints(0, 0, 99, 0, 0), direction=ints(1, 1, -1, 0, 1),
    kind=strings(["link", "link", "junction", "none", "stub"]), reason=strings(["", "", "", "fragment", ""]),
)  # fmt: skip
"""Four lanelets: two ways of 40 and 60 m, a junction of 50 m, 20 m without a way, a stub of 30 m."""


def said(**changes: object) -> Prediction:
    """The truth, said with certainty, with changes."""
    way = TRUTH.way_id
    right = Prediction(
        TRUTH.lanelet_id, TRUTH.s_from_m / TRUTH.lanelet_length_m, TRUTH.s_to_m / TRUTH.lanelet_length_m, way,
        TRUTH.direction, np.where(way == 0, "none", "match").astype(object), np.ones(len(way)),
    )  # fmt: skip
    return replace(right, **changes)


def test_the_truth_itself_is_faultless() -> None:
    for kind, found in score_by_kind(judge_matches(said(), TRUTH)).items():
        if kind != "none":
            assert (found.precision, found.recall, found.f1, found.lanelet_f1) == (1, 1, 1, 1)
        assert (found.wrong_m, found.phantom_m, found.missed_m, found.turned_m) == (0, 0, 0, 0)
    assert score(judge_matches(said(), TRUTH)).length_m == pytest.approx(200)


def test_a_swapped_match_costs_its_metres() -> None:
    found = score(judge_matches(said(way_id=ints(10, 10, 12, 0, 13)), TRUTH))
    assert found.wrong_m == pytest.approx(60)
    assert found.precision == found.recall == pytest.approx(120 / 180)
    assert (found.lanelets, found.lanelet_precision) == (4, pytest.approx(2 / 3))


def test_a_lost_way_costs_recall_only() -> None:
    decision = strings(["match", "match", "match", "none", "none"])
    found = score(judge_matches(said(way_id=ints(10, 11, 12, 0, 0), decision=decision), TRUTH))
    assert found.precision == 1
    assert found.recall == pytest.approx(150 / 180)
    assert found.missed_m == pytest.approx(30)
    gone = said()
    keep = gone.lanelet_id != 4
    dropped = Prediction(*(getattr(gone, name)[keep] for name in Prediction.__dataclass_fields__))
    assert score(judge_matches(dropped, TRUTH)).missed_m == pytest.approx(30)


def test_a_way_where_there_is_none_costs_precision_only() -> None:
    decision = strings(["match"] * 5)
    found = score(judge_matches(said(way_id=ints(10, 11, 12, 7, 13), decision=decision), TRUTH))
    assert found.recall == 1
    assert found.phantom_m == pytest.approx(20)
    assert found.precision == pytest.approx(180 / 200)


def test_the_other_way_of_a_junction_is_right_too() -> None:
    found = score(judge_matches(said(way_id=ints(10, 11, 99, 0, 13), direction=ints(1, 1, 1, 0, 1)), TRUTH))
    assert found.f1 == 1
    assert found.turned_m == 0


def test_the_wrong_direction_shows() -> None:
    assert score(judge_matches(said(direction=ints(1, -1, -1, 0, 1)), TRUTH)).turned_m == pytest.approx(60)


def test_review_is_neither_right_nor_wrong() -> None:
    decision = strings(["match", "review", "match", "none", "review"])
    judged = judge_matches(said(decision=decision, way_id=ints(10, 11, 12, 0, 10)), TRUTH)
    found = score(judged)
    assert found.precision == 1
    assert found.recall == pytest.approx(90 / 180)
    assert found.recall_with_review == pytest.approx(150 / 180)
    confusion = review_confusion(judged)
    assert confusion["review"] == pytest.approx({"right": 60, "wrong": 30, "phantom": 0, "missed": 0})
    assert confusion["match"]["right"] == pytest.approx(90)
    assert confusion["none"] == pytest.approx({"right": 20, "wrong": 0, "phantom": 0, "missed": 0})


def test_pieces_are_scaled_by_the_lanelets_own_length() -> None:
    nan = np.full(3, np.nan)
    none = strings([""] * 3)
    matches = Matches(
        ints(1, 1, 2), np.array([0.0, 41, 0]), np.array([41.0, 102.5, 10]), ints(10, 11, 12), nan, nan, ints(1, 1, -1),
        np.ones(3), np.ones(3), strings(["match"] * 3), none, ints(0, 0, 1), nan, nan, nan, nan,
    )  # fmt: skip
    judged = judge_matches(prediction_of(matches), TRUTH)
    assert score(judged).precision == pytest.approx(1)
    assert score(judged, judged.kind == "link").recall == pytest.approx(1)


def test_calibration_error() -> None:
    confidence = np.array([0.95, 0.95, 0.55, 0.0, 0.55])
    judged = judge_matches(said(confidence=confidence, way_id=ints(10, 10, 12, 0, 10)), TRUTH)
    found = reliability(judged)
    assert found.metres[[5, 9]].tolist() == pytest.approx([80, 100])
    assert found.accuracy[[5, 9]].tolist() == pytest.approx([50 / 80, 0.4])
    assert found.error == pytest.approx((80 * abs(50 / 80 - 0.55) + 100 * 0.55) / 180)


def test_nothing_said_has_no_calibration() -> None:
    nothing = Prediction(*(getattr(said(), name)[:0] for name in Prediction.__dataclass_fields__))
    judged = judge_matches(nothing, TRUTH)
    assert reliability(judged).error is None
    assert score(judged).precision is None
    assert score(judged).recall == 0


pieces = st.lists(st.floats(0, 1), min_size=2, max_size=8).map(lambda cuts: sorted(set(cuts)))


@given(st.lists(st.tuples(pieces, pieces), min_size=1, max_size=5))
def test_an_overlay_keeps_every_length(lines: list[tuple[list[float], list[float]]]) -> None:
    tables = []
    for side in (0, 1):
        rows = [
            (k, a, b)
            for k, line in enumerate(lines)
            for a, b in zip(line[side], line[side][1:], strict=False)
        ]
        line, start, stop = zip(*rows, strict=True) if rows else ((), (), ())
        tables.append((np.array(line, dtype=np.int64), np.array(start), np.array(stop)))
    laid = overlay(len(lines), *tables)
    assert np.bincount(laid.line, laid.stop - laid.start, len(lines)) == pytest.approx(1, abs=1e-6)
    for rows, (_, start, stop) in zip((laid.first, laid.second), tables, strict=True):
        covered = np.bincount(rows[rows >= 0], (laid.stop - laid.start)[rows >= 0], len(start))
        assert covered == pytest.approx(stop - start, abs=1e-6)
