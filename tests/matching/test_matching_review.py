"""People's decisions on matches: carried out before transfer, kept while the ground holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matching_maps import MapDraft, covered_once, roads, two_way_road

from flexmap_tasks.config import CollapseParams, MatchParams
from flexmap_tasks.formats.review_decisions_csv import decisions_of
from flexmap_tasks.matching.collapse import collapse
from flexmap_tasks.matching.match import match
from flexmap_tasks.matching.review import review_matches
from flexmap_tasks.model.review import ReviewedMatches

X = [(float(x), 0.0) for x in range(0, 201, 20)]
WAYS = [[(-20.0, 2.0), (230.0, 2.0)], [(230.0, -20.0), (-20.0, -20.0)], [(0.0, 900.0), (200.0, 900.0)]]
DRAFT = MapDraft()
AHEAD, BACK = two_way_road(DRAFT, X)
BUILT, ROADS = DRAFT.build(), roads(WAYS)
RAW = match(collapse(BUILT, CollapseParams()), BUILT, ROADS, MatchParams()).matches
OPEN = replace(RAW, decision=np.full(len(RAW), "review", dtype=object), confidence=np.full(len(RAW), 0.4))


def decided(*rows: dict[str, object], matches=OPEN) -> ReviewedMatches:
    whole = {"kind": "match", "lanelet_id": AHEAD, "way_id": 1, "s_from_m": 0, "s_to_m": 200}
    texts = [{k: str(v) for k, v in (whole | row).items()} for row in rows]
    return review_matches(matches, decisions_of(texts), BUILT, ROADS)


def of(result: ReviewedMatches, lanelet: int) -> dict[str, object]:
    (row,) = np.flatnonzero(result.matches.lanelet_id == lanelet).tolist()
    return {name: getattr(result.matches, name)[row] for name in type(result.matches).__slots__}


def test_the_way_that_was_offered_is_accepted() -> None:
    result = decided({"decision": "accept", "who": "ann", "when": "2026-01-02T03:04:05Z"})
    row = of(result, AHEAD)
    assert (row["way_id"], row["decision"], row["confidence"], row["direction"]) == (1, "match", 1.0, 1)
    assert row["reason"] == "accepted by a person (ann, 2026-01-02T03:04:05Z)"
    assert of(result, BACK)["decision"] == "review"
    assert len(result.unused) == 0
    covered_once(BUILT, result.matches)


def test_another_way_is_chosen_with_its_place_and_direction() -> None:
    row = of(decided({"decision": "accept", "value": 2}), AHEAD)
    assert (row["way_id"], row["decision"], row["direction"]) == (2, "match", -1)
    assert (row["way_s_from_m"], row["way_s_to_m"]) == (pytest.approx(230), pytest.approx(30))


def test_a_piece_has_no_counterpart() -> None:
    row = of(decided({"decision": "reject"}), AHEAD)
    assert (row["way_id"], row["decision"], row["direction"]) == (0, "none", 0)
    assert np.isnan([row["way_s_from_m"], row["way_s_to_m"], row["d_angle_deg"]]).all()


def test_what_matching_was_sure_of_can_be_decided_too() -> None:
    row = of(decided({"decision": "accept", "value": 2}, matches=RAW), AHEAD)
    assert (row["way_id"], row["decision"]) == (2, "match")


def test_the_last_word_counts() -> None:
    result = decided({"decision": "reject"}, {"decision": "accept"})
    assert of(result, AHEAD)["decision"] == "match"
    assert len(result.unused) == 0


@pytest.mark.parametrize(("s_from_m", "s_to_m", "holds"), [(4, 190, True), (0, 260, True), (0, 60, False)])
def test_it_holds_while_it_covers_most_of_the_piece(s_from_m: float, s_to_m: float, holds: bool) -> None:
    result = decided({"decision": "accept", "s_from_m": s_from_m, "s_to_m": s_to_m})
    assert (of(result, AHEAD)["decision"] == "match") == holds
    assert (len(result.unused) == 0) == holds


@pytest.mark.parametrize(
    "changed",
    [{"way_id": 2}, {"lanelet_id": 4711}, {"value": 99}, {"value": 3}],
    ids=["another way is offered", "the lanelet is gone", "the chosen way is gone", "it is far away"],
)
def test_where_the_ground_has_changed_nothing_is_decided(changed: dict[str, object]) -> None:
    result = decided({"decision": "accept"} | changed)
    assert result.matches.decision.tolist() == OPEN.decision.tolist()
    assert result.matches.way_id.tolist() == OPEN.way_id.tolist()
    assert len(result.unused) == 1
