from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from transfer_worlds import (
    Draft,
    along_x,
    edited,
    matches_of,
    members_of,
    road,
    roads_of,
    rows,
    run,
    save,
    tags_of,
)

from flexmap_tasks.config import CollapseParams, TransferParams, TransferRule
from flexmap_tasks.formats.review_decisions_csv import decisions_of
from flexmap_tasks.matching.collapse import collapse
from flexmap_tasks.model.lanelets import lanelets_of
from flexmap_tasks.transfer.lane_check import expected_lanes
from flexmap_tasks.transfer.transfer import transfer


def one_road(tmp_path: Path, **tags: str):
    draft = Draft()
    drawn = road(draft, [100.0], 1, 1, **tags)
    return draft.read(tmp_path), drawn.forward[0][0], drawn.backward[0][0]


def test_values_land_and_absent_ones_empty_nothing(tmp_path: Path) -> None:
    before, ahead, back = one_road(tmp_path, road_surface="sett")
    roads = roads_of(
        [
            {
                "highway": "secondary",
                "maxspeed": "50",
                "name": "Am Ring",
                "maxspeed:backward": "30",
                "surface": "",
            }
        ]
    )
    after = run(before, along_x(before, []), roads)
    assert tags_of(after.map, ahead) == tags_of(before, ahead) | {"speed_limit": "50", "road_name": "Am Ring"}
    assert tags_of(after.map, back) == tags_of(before, back) | {"speed_limit": "30", "road_name": "Am Ring"}
    (row,) = rows(after, lanelet_id=ahead, key="speed_limit")
    assert (row["old"], row["new"], row["way_id"], row["way_version"], row["action"]) == (
        "10",
        "50",
        100,
        1,
        "set",
    )
    assert rows(after, lanelet_id=ahead, key="subtype", action="keep")
    assert not rows(after, key="road_surface")


def test_twice_changes_nothing(tmp_path: Path) -> None:
    before, *_ = one_road(tmp_path)
    roads = roads_of(
        [
            {"highway": "residential", "maxspeed": "50", "oneway": "no"},
            {"highway": "residential", "maxspeed": "30"},
        ]
    )
    once = run(before, along_x(before, [47.0]), roads)
    twice = run(once.map, along_x(once.map, [47.0]), roads)
    assert len(lanelets_of(once.map)) == 4
    assert not rows(twice, action="set")
    assert not rows(twice, action="split")
    for kind in ("nodes", "ways", "relations"):
        a, b = getattr(once.map.document, kind), getattr(twice.map.document, kind)
        assert a.id.tolist() == b.id.tolist()
        assert a.tags.value.tolist() == b.tags.value.tolist()


@pytest.mark.parametrize("oneway", ["yes", "no", "-1", "reversible", "banana", ""])
def test_no_lanelet_becomes_two_way(tmp_path: Path, oneway: str) -> None:
    before, *_ = one_road(tmp_path)
    after = run(before, along_x(before, []), roads_of([{"highway": "service", "oneway": oneway}]))
    assert lanelets_of(after.map).one_way.all()


def test_one_way_fills_only_a_gap(tmp_path: Path) -> None:
    draft = Draft()
    silent, both = road(draft, [50.0], 1, 0, one_way=""), road(draft, [50.0], 1, 0, one_way="no")
    before = draft.read(tmp_path)
    after = run(before, along_x(before, []), roads_of([{"highway": "service", "oneway": "yes"}]))
    assert tags_of(after.map, silent.forward[0][0])["one_way"] == "yes"
    assert tags_of(after.map, both.forward[0][0])["one_way"] == "no"
    assert rows(after, lanelet_id=both.forward[0][0], key="one_way", action="review")


def test_a_lanelet_against_a_one_way_road_is_named_and_left(tmp_path: Path) -> None:
    before, ahead, back = one_road(tmp_path)
    after = run(
        before, along_x(before, []), roads_of([{"highway": "primary", "oneway": "yes", "maxspeed": "70"}])
    )
    assert tags_of(after.map, ahead)["speed_limit"] == "70"
    assert tags_of(after.map, back) == tags_of(before, back)
    assert [r["new"] for r in rows(after, lanelet_id=back, action="review", key="speed_limit")] == ["70"]
    assert (after.findings.code.tolist(), after.findings.id.tolist()) == (["wrong-way-lanelet"], [back])


@pytest.mark.parametrize(
    "subtype", ["bus_lane", "bicycle_lane", "crosswalk", "walkway", "road_shoulder", "exit"]
)
def test_the_author_knows_the_subtype(tmp_path: Path, subtype: str) -> None:
    before, ahead, _ = one_road(tmp_path, subtype=subtype, participant_vehicle="")
    after = run(before, along_x(before, []), roads_of([{"highway": "motorway", "maxspeed": "100"}]))
    assert tags_of(after.map, ahead)["subtype"] == subtype


def test_a_busway_does_not_close_a_road(tmp_path: Path) -> None:
    before, ahead, _ = one_road(tmp_path)
    after = run(before, along_x(before, []), roads_of([{"highway": "busway"}]))
    assert tags_of(after.map, ahead)["subtype"] == "road"
    assert rows(after, lanelet_id=ahead, key="subtype", action="review")


def test_location_only_with_evidence(tmp_path: Path) -> None:
    draft = Draft()
    rural, silent, private = (road(draft, [50.0], 1, 0, location=x) for x in ("nonurban", "", "private"))
    before = draft.read(tmp_path)
    after = run(before, along_x(before, []), roads_of([{"highway": "residential"}]))
    found = [tags_of(after.map, r.forward[0][0])["location"] for r in (rural, silent, private)]
    assert found == ["nonurban", "urban", "private"]
    zone = run(
        before, along_x(before, []), roads_of([{"highway": "residential", "zone:traffic": "DE:urban"}])
    )
    found = [tags_of(zone.map, r.forward[0][0])["location"] for r in (rural, silent, private)]
    assert found == ["urban", "urban", "private"]


def test_review_and_doubt_change_nothing(tmp_path: Path) -> None:
    before, ahead, back = one_road(tmp_path)
    roads = roads_of([{"highway": "primary", "maxspeed": "70", "name": "X"}])
    rows_in = [(ahead, 0.0, 100.0, 100, 1), (back, 0.0, 100.0, 100, -1)]
    after = run(before, matches_of(rows_in, decision=["review", "match"], confidence=[0.9, 0.2]), roads)
    assert after.map.document.relations.tags.value.tolist() == before.document.relations.tags.value.tolist()
    assert {r["lanelet_id"] for r in rows(after, key="road_name", action="review", new="X")} == {ahead, back}


def test_a_value_of_a_small_part_is_not_written(tmp_path: Path) -> None:
    before, ahead, _ = one_road(tmp_path)
    after = run(
        before,
        matches_of([(ahead, 0.0, 12.0, 100, 1)]),
        roads_of([{"maxspeed": "70"}]),
        TransferParams(split=False),
    )
    assert tags_of(after.map, ahead)["speed_limit"] == "10"
    assert rows(after, lanelet_id=ahead, key="speed_limit", action="review")[0]["reason"].startswith(
        "only 12 %"
    )


def test_uncertain_matches_that_agree_do_not_stand_in_the_way(tmp_path: Path) -> None:
    before, ahead, _ = one_road(tmp_path)
    pieces = [(ahead, 0.0, 40.0, 100, 1), (ahead, 40.0, 100.0, 200, 1)]
    roads, params = roads_of([{"maxspeed": "70"}, {"maxspeed": "70"}]), TransferParams(split=False)
    agreed = run(before, matches_of(pieces, decision=["match", "review"]), roads, params)
    assert tags_of(agreed.map, ahead)["speed_limit"] == "70"
    unsure = run(before, matches_of(pieces, decision=["review", "review"]), roads, params)
    assert tags_of(unsure.map, ahead)["speed_limit"] == "10"
    other = roads_of([{"maxspeed": "70"}, {"maxspeed": "60"}])
    assert (
        tags_of(run(before, matches_of(pieces, decision=["match", "review"]), other, params).map, ahead)[
            "speed_limit"
        ]
        == "10"
    )


def test_majority_of_metres_without_splitting(tmp_path: Path) -> None:
    before, ahead, back = one_road(tmp_path)
    roads = roads_of([{"maxspeed": "50"}, {"maxspeed": "30"}])
    after = run(before, along_x(before, [30.0]), roads, TransferParams(split=False))
    assert [tags_of(after.map, x)["speed_limit"] for x in (ahead, back)] == ["30", "30"]


@pytest.mark.parametrize(
    ("policy", "speed", "action"),
    [("osm_wins", "50", "set"), ("fill_only", "10", "keep"), ("review_conflicts", "10", "review")],
)
def test_policies(tmp_path: Path, policy: str, speed: str, action: str) -> None:
    before, ahead, _ = one_road(tmp_path)
    rule = TransferRule(key="maxspeed", target="speed_limit", parser="speed", policy=policy)
    after = run(before, along_x(before, []), roads_of([{"maxspeed": "50"}]), TransferParams(rules=(rule,)))
    assert tags_of(after.map, ahead)["speed_limit"] == speed
    assert [r["action"] for r in rows(after, lanelet_id=ahead)] == [action]


def test_garbage_ends_nothing(tmp_path: Path) -> None:
    before, ahead, _ = one_road(tmp_path)
    bad = dict.fromkeys(
        ("highway", "maxspeed", "name", "surface", "oneway", "lane_markings", "lanes"), "\x7f☃;;|-1e999"
    )
    good = [(ahead, 0.0, 50.0, 100, 1), (ahead, np.nan, 90.0, 100, 1), (ahead, 90.0, 60.0, 100, 1)]
    lost = [
        (ahead, 50.0, 60.0, 4711, 1),
        (4711, 0.0, 1.0, 100, 1),
        (ahead, 60.0, 1e12, 100, -1),
        (ahead, 0.0, 9.0, 100, 0),
    ]
    after = run(before, matches_of(good + lost), roads_of([bad]))
    assert tags_of(after.map, ahead) == tags_of(before, ahead)
    assert "osm-value-not-used" in after.findings.code.tolist()


def test_empty_inputs(tmp_path: Path) -> None:
    before, *_ = one_road(tmp_path)
    after = run(before, matches_of([]), roads_of([]))
    assert len(after.transfers.key) == 0
    assert after.lane_check.verdict.tolist() == ["unmatched"] * 2


def test_lane_check_by_direction(tmp_path: Path) -> None:
    draft = Draft()
    drawn = road(draft, [50.0, 50.0, 50.0, 50.0, 50.0], 2, 1)
    before = draft.read(tmp_path)
    tags = [
        {"lanes": "3"}, {"lanes": "2"}, {"lanes:forward": "2", "lanes:backward": "2"},
        {"lanes": "variable"}, {"lanes": "3", "lanes:forward": "2", "lanes:backward": "2"},
    ]  # fmt: skip
    after = run(before, along_x(before, [50.0, 100.0, 150.0, 200.0]), roads_of(tags))
    check = dict(zip(after.lane_check.lanelet_id.tolist(), after.lane_check.verdict.tolist(), strict=True))
    ahead = [check[s[0]] for s in drawn.forward]
    back = [check[s[0]] for s in drawn.backward]
    assert ahead == ["agree", "differ", "agree", "unknown", "unknown"]
    assert back == ["agree", "differ", "differ", "unknown", "unknown"]
    assert {"lanes=variable is no number of lanes", "lanes=3, but its parts make 4"} <= set(
        after.lane_check.reason
    )
    assert set(after.findings.message) == {
        "lanes=variable is no number of lanes",
        "lanes=3, but its parts make 4",
    }


@pytest.mark.parametrize(
    ("tags", "sense", "lanes"),
    [
        ({"turn:lanes": "left|through|right", "oneway": "yes"}, 1, 3),
        ({"turn:lanes": "left|through|right"}, 1, -1),
        ({"turn:lanes:backward": "left|through"}, -1, 2),
        ({"lanes": "4", "turn:lanes:forward": "left|through|right"}, 1, 4),
        ({"lanes": "2;3"}, 1, -1),
        ({"lanes": " 2 "}, 1, 2),
        ({}, 1, -1),
    ],
)
def test_expected_lanes(tags: dict[str, str], sense: int, lanes: int) -> None:
    assert expected_lanes(tags, sense).lanes == lanes


def test_a_lane_count_far_off_is_for_a_person(tmp_path: Path) -> None:
    before, *_ = one_road(tmp_path)
    after = run(before, along_x(before, []), roads_of([{"lanes": "5"}]))
    assert [(r["old"], r["new"], r["action"]) for r in rows(after, key="lanes")] == [("2", "5", "review")] * 2
    near = run(before, along_x(before, []), roads_of([{"lanes": "3"}]))
    assert not rows(near, key="lanes")


@pytest.mark.parametrize(
    ("limits", "believed"),
    [
        ((50, 130, 50), False),
        ((80, 20, 70), False),
        ((50, 90, 50), True),
        ((50, 130, 130), True),
        ((50, 130, 100), True),
    ],
)
def test_a_short_stretch_that_stands_out_is_for_a_person(
    tmp_path: Path, limits: tuple[int, ...], believed: bool
) -> None:
    draft = Draft()
    drawn = road(draft, [200.0, 60.0, 200.0], 1, 1)
    before = draft.read(tmp_path)
    roads = roads_of([{"maxspeed": str(v)} for v in limits])
    after = run(before, along_x(before, [200.0, 260.0]), roads)
    middle = [drawn.forward[1][0], drawn.backward[1][0]]
    assert [tags_of(after.map, x)["speed_limit"] for x in middle] == [
        str(limits[1]) if believed else "10"
    ] * 2
    assert bool(rows(after, lanelet_id=middle[0], key="speed_limit", action="review")) != believed
    long = run(before, along_x(before, [200.0, 260.0]), roads, TransferParams(speed_jump_max_m=10.0))
    assert tags_of(long.map, middle[0])["speed_limit"] == str(limits[1])


def test_provenance_and_verdict_as_tags(tmp_path: Path) -> None:
    before, ahead, _ = one_road(tmp_path)
    params = TransferParams(provenance_tags=True, lane_check_tags=True)
    roads = roads_of([{"maxspeed": "50", "lanes": "2"}])
    once = run(before, along_x(before, []), roads, params)
    tags = tags_of(once.map, ahead)
    assert tags["source:speed_limit"] == "OpenStreetMap way 100 v1 2023-11-01T00:00:00Z"
    assert tags["lane_check"] == "agree"
    assert set(tags) - set(tags_of(before, ahead)) == {"source:speed_limit", "lane_check"}
    twice = run(once.map, along_x(once.map, []), roads, params)
    assert twice.map.document.relations.tags.value.tolist() == once.map.document.relations.tags.value.tolist()


def test_lane_check_of_a_one_way_road_looks_at_its_direction(tmp_path: Path) -> None:
    draft = Draft()
    drawn = road(draft, [50.0], 2, 1)
    before = draft.read(tmp_path)
    rows_in = [(x, 0.0, 50.0, 100, 1) for x in drawn.forward[0]] + [(drawn.backward[0][0], 0.0, 50.0, 200, 1)]
    roads = roads_of([{"oneway": "yes", "lanes": "2"}, {"oneway": "yes", "lanes": "1"}])
    after = run(before, matches_of(rows_in), roads)
    assert after.lane_check.verdict.tolist() == ["agree"] * 3


def fragment_world(tmp_path: Path):
    """Two sections of 1+1 lanes; beside the first lies a lane that leads nowhere."""
    draft = Draft()
    drawn = road(draft, [50.0, 50.0], 1, 1)
    outer = draft.way([draft.node(x, -7.0) for x in (0.0, 25.0, 50.0)])
    stray = draft.lanelet(drawn.bounds[0][0], outer)
    return draft, drawn, stray


def test_fragments_go_only_on_request(tmp_path: Path) -> None:
    draft, _, stray = fragment_world(tmp_path)
    before, roads = draft.read(tmp_path), roads_of([{"lanes": "2"}])
    kept = run(before, along_x(before, []), roads)
    assert stray in lanelets_of(kept.map).id
    after = run(before, along_x(before, []), roads, TransferParams(remove_fragments=True))
    assert set(lanelets_of(before).id) - set(lanelets_of(after.map).id) == {stray}
    assert [r["lanelet_id"] for r in rows(after, action="remove")] == [stray]
    assert after.map.document.ways.id.tolist() == before.document.ways.id.tolist()
    assert stray not in after.lane_check.lanelet_id


@pytest.mark.parametrize(
    ("decision", "remove", "action"),
    [("accept", False, "remove"), ("reject", True, "keep"), (None, False, "review"), (None, True, "remove")],
)
def test_a_person_decides_on_a_fragment(
    tmp_path: Path, decision: str | None, remove: bool, action: str
) -> None:
    draft, _, stray = fragment_world(tmp_path)
    before, roads = draft.read(tmp_path), roads_of([{"lanes": "2"}])
    centerlines, params = collapse(before, CollapseParams()), TransferParams(remove_fragments=remove)
    matches = along_x(before, [])
    (row,) = rows(transfer(before, centerlines, matches, roads, params), key="fragment")
    ground = {name: str(row[name]) for name in ("lanelet_id", "way_id", "key", "old", "new")}
    told = [ground | {"kind": "fragment", "decision": decision}] if decision else []
    elsewhere = {"kind": "fragment", "decision": "accept" if not remove else "reject", **ground, "new": "9"}
    after = transfer(
        before, centerlines, matches, roads, params, decisions_on_fragments=decisions_of([elsewhere, *told])
    )
    assert [r["action"] for r in rows(after, key="fragment", lanelet_id=stray)] == [action]
    assert (stray in lanelets_of(after.map).id) == (action != "remove")


def test_no_fragment_that_a_rule_names(tmp_path: Path) -> None:
    draft, _, stray = fragment_world(tmp_path)
    draft.relation([("relation", stray, "yield")], type="regulatory_element", subtype="right_of_way")
    before = draft.read(tmp_path)
    after = run(
        before, along_x(before, []), roads_of([{"lanes": "2"}]), TransferParams(remove_fragments=True)
    )
    assert stray in lanelets_of(after.map).id


@pytest.mark.parametrize(
    ("gap_m", "lanes", "matched", "gone"),
    [(0.4, 2, False, True), (4.0, 2, False, False), (0.4, 3, False, False), (0.4, 2, True, False)],
)
def test_a_lone_lanelet_beside_a_full_carriageway(
    tmp_path: Path, gap_m: float, lanes: int, matched: bool, gone: bool
) -> None:
    draft = Draft()
    road(draft, [100.0], 1, 1)
    edge = -3.5 - gap_m
    near, far = (draft.way([draft.node(x, y) for x in (40.0, 50.0, 60.0)]) for y in (edge, edge - 3.0))
    lone = draft.lanelet(near, far)
    before = draft.read(tmp_path)
    roads = roads_of([{"lanes": str(lanes)}, {"lanes": "1", "oneway": "yes"}])
    pieces = [(int(i), 0.0, 100.0, 100, 1) for i in lanelets_of(before).id if i != lone]
    after = run(
        before,
        matches_of(pieces + [(lone, 0.0, 20.0, 200, 1)] * matched),
        roads,
        TransferParams(remove_fragments=True),
    )
    assert (lone not in lanelets_of(after.map).id) == gone
    assert len(rows(after, action="remove", lanelet_id=lone)) == gone


def test_no_fragment_where_the_count_fits(tmp_path: Path) -> None:
    draft, _, stray = fragment_world(tmp_path)
    before = draft.read(tmp_path)
    after = run(
        before, along_x(before, []), roads_of([{"lanes": "3"}]), TransferParams(remove_fragments=True)
    )
    assert stray in lanelets_of(after.map).id
    assert members_of(after.map, stray) == members_of(before, stray)


def test_a_speed_limit_rule_of_the_map_decides(tmp_path: Path) -> None:
    draft = Draft()
    lanes = [road(draft, [50.0], 1, 0).forward[0][0] for _ in range(2)]
    for lane, sign in zip(lanes, ("50 km/h", "de274-30"), strict=True):
        rule = draft.relation([], type="regulatory_element", subtype="speed_limit", sign_type=sign)
        draft.relations[lane][0].append(("relation", rule, "regulatory_element"))
    before = draft.read(tmp_path)
    after = run(before, along_x(before, []), roads_of([{"maxspeed": "50"}]))
    assert [tags_of(after.map, x)["speed_limit"] for x in lanes] == ["10", "10"]
    assert [rows(after, lanelet_id=x)[0]["action"] for x in lanes] == ["keep", "review"]


@pytest.mark.parametrize(
    ("now", "person", "kept", "action"),
    [
        ("50", "40", "40", "keep"),
        ("70", "40", "40", "review"),
        ("70", None, "70", "set"),
        ("70", "70", "70", "keep"),
    ],
)
def test_what_a_person_changed_since_the_last_release_stays(
    tmp_path: Path, now: str, person: str | None, kept: str, action: str
) -> None:
    before, ahead, back = one_road(tmp_path)
    released = run(before, along_x(before, []), roads_of([{"maxspeed": "50", "name": "A"}])).map
    changed = released if person is None else edited(released, ahead, "speed_limit", person)
    news = roads_of([{"maxspeed": now, "name": "A"}])
    after = run(changed, along_x(changed, []), news, last_release=released)
    assert tags_of(after.map, ahead)["speed_limit"] == kept
    assert tags_of(after.map, back)["speed_limit"] == now
    assert [r["action"] for r in rows(after, lanelet_id=ahead, key="speed_limit")] == [action]
    assert not rows(after, key="road_name", action="set")


def test_a_new_extract_changes_only_what_it_changed(tmp_path: Path) -> None:
    before, *_ = one_road(tmp_path)
    then, now = (
        [{"maxspeed": "50", "surface": "sett"}] * 2,
        [{"maxspeed": "50", "surface": "sett"}, {"maxspeed": "30", "surface": "sett"}],
    )
    released = run(before, along_x(before, [40.0]), roads_of(then)).map
    after = run(released, along_x(released, [40.0]), roads_of(now), last_release=released)
    assert {(r["key"], r["new"]) for r in rows(after, action="set")} == {("speed_limit", "30")}
    assert len(lanelets_of(after.map)) == 4


def test_a_limit_may_land_as_a_rule(tmp_path: Path) -> None:
    draft = Draft()
    drawn = road(draft, [100.0, 100.0], 1, 1)
    before = draft.read(tmp_path)
    rule = TransferRule(key="maxspeed", target="speed_limit", parser="speed", element="speed_limit_rule")
    params, roads = TransferParams(rules=(rule,)), roads_of([{"maxspeed": "50"}, {"maxspeed": "30 mph"}])
    once = run(before, along_x(before, [143.0]), roads, params)
    relations = once.map.document.relations
    rules = relations.id[relations.tags.column("subtype") == "speed_limit"]
    assert sorted(tags_of(once.map, int(r))["sign_type"] for r in rules) == ["48.28 km/h", "50 km/h"]
    assert tags_of(once.map, drawn.forward[0][0])["speed_limit"] == "10"
    twice = run(once.map, along_x(once.map, [143.0]), roads, params)
    assert not rows(twice, action="set")
    assert not rows(twice, action="review")
    lanelet2 = pytest.importorskip("lanelet2")
    path = save(once.map, tmp_path / "after.osm")
    loaded, errors = lanelet2.io.loadRobust(
        str(path), lanelet2.projection.UtmProjector(lanelet2.io.Origin(48.1, 11.5))
    )
    traffic = lanelet2.traffic_rules.create(
        lanelet2.traffic_rules.Locations.Germany, lanelet2.traffic_rules.Participants.Vehicle
    )
    told = {r["lanelet_id"]: float(str(r["new"])) for r in rows(once, action="set")}
    assert not errors
    assert len(told) == 6
    for lanelet in loaded.laneletLayer:
        assert float(traffic.speedLimit(lanelet).speedLimit) == pytest.approx(told[lanelet.id], abs=0.01)


def test_the_mapping_table_of_the_docs_reads_a_new_key(tmp_path: Path) -> None:
    """The example in docs/conflation.md works as it stands there."""
    page = (Path(__file__).resolve().parents[2] / "docs" / "conflation.md").read_text(encoding="utf-8")
    example = next(part for part in page.split("```yaml\n") if part.startswith("conflation:\n  transfer:"))
    settings = yaml.safe_load(example.split("```")[0])["conflation"]["transfer"]
    params = TransferParams.model_validate(settings)
    draft = Draft()
    ahead = road(draft, [50.0], 1, 0).forward[0][0]
    before = draft.read(tmp_path)
    tags = {"highway": "tertiary", "smoothness": "good", "ref": "St 2350", "maxspeed": "70"}
    after = run(before, along_x(before, []), roads_of([tags]), params)
    relations = after.map.document.relations
    found = relations.tags.of_element(int(np.flatnonzero(relations.id == ahead)[0]))
    assert (found["road_smoothness"], found["road_ref"]) == ("good", "St 2350")
    assert rows(after, key="speed_limit", new="70")
