"""What transfer promises of every kind of tag, value by value."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from transfer_worlds import Draft, along_x, edited, matches_of, read, road, roads_of, rows, run, save, tags_of

from flexmap_tasks.config import TransferParams, TransferRule
from flexmap_tasks.formats.osm_xml import parse_osm_xml
from flexmap_tasks.model.lanelets import lanelets_of
from flexmap_tasks.model.maps import OSM_ATTRIBUTION, LaneletMap
from flexmap_tasks.transfer.lane_check import expected_lanes
from flexmap_tasks.transfer.side_check import side_lanes
from flexmap_tasks.transfer.write import attributed


@pytest.mark.parametrize(
    ("tags", "ahead", "back"),
    [
        ({"maxspeed": "30 mph"}, "48.28", "48.28"),
        ({"maxspeed": "10 knots"}, "18.52", "18.52"),
        ({"maxspeed": "80 km/h"}, "80", "80"),
        ({"maxspeed": "walk"}, "7", "7"),
        ({"maxspeed": "none"}, None, None),
        ({"maxspeed": "50;30"}, None, None),
        ({"maxspeed": "DE:urban"}, "50", "50"),
        ({"maxspeed": "AT:zone30"}, "30", "30"),
        ({"maxspeed": "RU:rural"}, "90", "90"),
        ({"maxspeed": "BE-VLG:rural"}, "70", "70"),
        ({"maxspeed": "XX:rural"}, None, None),
        ({"maxspeed": "50", "maxspeed:forward": "70"}, "70", "50"),
        ({"maxspeed:lanes": "80|80"}, "80", "80"),
        ({"maxspeed:lanes": "100|80"}, None, None),
        ({"maxspeed": "80", "maxspeed:lanes": "|80|"}, "80", "80"),
        ({"maxspeed": "80", "maxspeed:lanes": "80|60"}, None, None),
        ({"maxspeed": "80", "maxspeed:lanes:backward": "60|60"}, "80", None),
        ({"maxspeed:lanes:forward": "60", "maxspeed:lanes:backward": "50"}, "60", "50"),
    ],
)
def test_limits(tmp_path: Path, tags: dict[str, str], ahead: str | None, back: str | None) -> None:
    """Each direction gets its limit; without a certain one the map keeps its own, and both stand in a review."""
    draft = Draft()
    drawn = road(draft, [50.0], 1, 1)
    before = draft.read(tmp_path)
    after = run(before, along_x(before, []), roads_of([tags]))
    for lane, limit in ((drawn.forward[0][0], ahead), (drawn.backward[0][0], back)):
        (row,) = rows(after, lanelet_id=lane, key="speed_limit")
        assert tags_of(after.map, lane)["speed_limit"] == (limit or "10")
        assert row["action"] == ("set" if limit else "review")
        assert row["old"] == "10"
        assert row["new"]


@pytest.mark.parametrize(
    ("key", "target", "ahead", "back"),
    [
        ("maxspeed:conditional", "speed_limit", True, True),
        ("maxspeed:forward:conditional", "speed_limit", True, False),
        ("maxspeed:backward:conditional", "speed_limit", False, True),
        ("oneway:conditional", "one_way", True, True),
    ],
)
def test_what_holds_only_at_times_is_for_a_person(
    tmp_path: Path, key: str, target: str, ahead: bool, back: bool
) -> None:
    draft = Draft()
    drawn = road(draft, [50.0], 1, 1)
    before = draft.read(tmp_path)
    after = run(before, along_x(before, []), roads_of([{key: "30 @ (22:00-06:00)"}]))
    for lane, told in ((drawn.forward[0][0], ahead), (drawn.backward[0][0], back)):
        found = rows(after, lanelet_id=lane, key=target, action="review")
        assert [r["new"] for r in found] == [f"{key}=30 @ (22:00-06:00)"] * told
        assert tags_of(after.map, lane) == tags_of(before, lane)


@pytest.mark.parametrize(
    ("tags", "ahead", "back"),
    [
        ({"lanes": "3", "lanes:backward": "1"}, (2, True), (1, True)),
        ({"lanes": "4", "lanes:forward": "2", "lanes:both_ways": "1"}, (2, True), (1, True)),
        ({"lanes": "1", "lanes:backward": "1"}, (-1, True), (1, True)),
        ({"lanes": "2", "oneway": "-1"}, (2, True), (2, True)),
        ({"lanes:forward": "2"}, (2, True), (-1, False)),
        ({"turn:lanes:forward": "left|through;right"}, (2, True), (-1, False)),
    ],
)
def test_lanes_per_direction(tags: dict[str, str], ahead: tuple[int, bool], back: tuple[int, bool]) -> None:
    for sense, expected in ((1, ahead), (-1, back)):
        found = expected_lanes(tags, sense)
        assert (found.lanes, found.one_direction) == expected


@pytest.mark.parametrize(
    ("value", "number"), [("yes", 1), ("both", 2), ("right", 1), ("left", 1), ("no", 0), ("sometimes", None)]
)
def test_a_shoulder_of_a_one_way_road(value: str, number: int | None) -> None:
    assert side_lanes({"oneway": "yes", "shoulder": value}, 1, True).get("road_shoulder") == number


@pytest.mark.parametrize("oneway", ["reversible", "alternating"])
def test_a_direction_that_changes_is_for_a_person(tmp_path: Path, oneway: str) -> None:
    draft = Draft()
    drawn = road(draft, [50.0], 1, 1)
    before = draft.read(tmp_path)
    after = run(before, along_x(before, []), roads_of([{"oneway": oneway}]))
    found = rows(after, key="one_way", action="review")
    assert {(r["lanelet_id"], r["old"], r["new"]) for r in found} == {
        (drawn.forward[0][0], "yes", oneway),
        (drawn.backward[0][0], "yes", oneway),
    }
    assert not [c for c in after.findings.code if c == "wrong-way-lanelet"]


def test_a_road_drawn_against_its_only_direction(tmp_path: Path) -> None:
    """oneway=-1: the lanelet along the way is the one against traffic."""
    draft = Draft()
    drawn = road(draft, [50.0], 1, 1)
    before = draft.read(tmp_path)
    after = run(before, along_x(before, []), roads_of([{"oneway": "-1", "maxspeed": "50"}]))
    assert after.findings.id[after.findings.code == "wrong-way-lanelet"].tolist() == [drawn.forward[0][0]]
    assert tags_of(after.map, drawn.backward[0][0])["speed_limit"] == "50"


@pytest.mark.parametrize(("confidence", "limit"), [(0.49, "10"), (0.5, "50")])
def test_the_least_confidence(tmp_path: Path, confidence: float, limit: str) -> None:
    draft = Draft()
    lane = road(draft, [50.0], 1, 0).forward[0][0]
    before = draft.read(tmp_path)
    matches = matches_of([(lane, 0.0, 50.0, 200, 1)], confidence=[confidence])
    after = run(before, matches, roads_of([{}, {"maxspeed": "50"}]))
    assert tags_of(after.map, lane)["speed_limit"] == limit
    (row,) = rows(after, key="speed_limit")
    told = (row["way_id"], row["way_version"], row["way_timestamp"], row["confidence"])
    assert told == (200, 2, "2023-11-01T00:00:00Z", confidence)


@pytest.mark.parametrize("policy", ["osm_wins", "fill_only", "review_conflicts"])
@pytest.mark.parametrize("element", ["tag", "speed_limit_rule"])
def test_every_policy_fills_a_gap_on_every_target(tmp_path: Path, policy: str, element: str) -> None:
    draft = Draft()
    lane = road(draft, [50.0], 1, 0, speed_limit="").forward[0][0]
    before = draft.read(tmp_path)
    rule = {"key": "maxspeed", "target": "speed_limit", "parser": "speed"}
    params = TransferParams.model_validate({"rules": [rule | {"policy": policy, "element": element}]})
    after = run(before, along_x(before, []), roads_of([{"maxspeed": "50"}]), params)
    assert [r["action"] for r in rows(after, lanelet_id=lane)] == ["set"]
    rules = after.map.document.relations.tags.column("sign_type")
    assert (tags_of(after.map, lane).get("speed_limit"), "50 km/h" in rules) == (
        ("50", False) if element == "tag" else (tags_of(before, lane).get("speed_limit"), True)
    )


def test_a_map_with_values_of_openstreetmap_says_so(tmp_path: Path) -> None:
    draft = Draft()
    road(draft, [50.0], 1, 1)
    before = draft.read(tmp_path)
    roads = roads_of([{"maxspeed": "50"}])
    once = run(before, along_x(before, []), roads).map
    again = read(save(once, tmp_path / "once.osm"))
    assert again.document.root["attribution"] == OSM_ATTRIBUTION
    twice = run(again, along_x(again, []), roads_of([{"maxspeed": "30"}])).map
    assert twice.document.root["attribution"] == OSM_ATTRIBUTION
    assert "attribution" not in run(before, along_x(before, []), roads_of([{}])).map.document.root
    own = parse_osm_xml(b'<osm version="0.6" attribution="Town survey"></osm>', "map.osm")
    assert attributed(own).root["attribution"] == f"Town survey; {OSM_ATTRIBUTION}"


@pytest.mark.parametrize("step_m", [0.7, 1.0, 2.6, 100.0])
@pytest.mark.parametrize("place", [3.05, 96.95])
def test_a_vertex_too_near_to_an_end_does_not_hinder_a_cut(
    tmp_path: Path, step_m: float, place: float
) -> None:
    draft = Draft()
    road(draft, [100.0], 1, 1, step_m)
    before = draft.read(tmp_path)
    roads = roads_of([{"maxspeed": "50"}, {"maxspeed": "30"}])
    after = run(before, along_x(before, [place]), roads, TransferParams(split_stretch_m=0.0)).map
    ways = after.document.ways
    assert len(lanelets_of(after)) == 4
    ends = after.xyz_m[np.isin(after.document.nodes.id, ways.ref[ways.offset[:-1]]), 0]
    inner = ends[(ends > 0.01) & (ends < 99.99)]
    assert len(inner) == 3
    assert inner.min() >= 3.0
    assert inner.max() <= 97.0


@pytest.mark.parametrize("need", ["path", "rule", "named", "nothing"])
def test_only_a_fragment_that_nothing_needs_goes(tmp_path: Path, need: str) -> None:
    """Beside a carriageway of 1+1 lanes lies one lane too many; a path goes through it, or a rule holds for it."""
    draft = Draft()
    drawn = road(draft, [50.0, 50.0], 1, 1)
    starts = [draft.ways[w[0]][0][0] for w in drawn.bounds] + [draft.ways[drawn.bounds[1][0]][0][-1]]
    edge = [draft.node(x, -7.0) for x in (0.0, 50.0, 100.0)]
    stray = draft.lanelet(drawn.bounds[0][0], draft.way(edge[:2]))
    if need == "path":
        draft.lanelet(draft.way([starts[1], starts[2]]), draft.way(edge[1:]), subtype="road")
    elif need != "nothing":
        members = [("relation", stray, "refers")] if need == "named" else []
        rule = draft.relation(members, type="regulatory_element", subtype="speed_limit", sign_type="30 km/h")
        if need == "rule":
            draft.relations[stray][0].append(("relation", rule, "regulatory_element"))
    before = draft.read(tmp_path)
    matches = along_x(before, [], reach=(-1e9, 50.0))
    after = run(before, matches, roads_of([{"lanes": "2"}]), TransferParams(remove_fragments=True))
    gone = sorted(set(lanelets_of(before).id.tolist()) - set(lanelets_of(after.map).id.tolist()))
    assert gone == [stray] * (need == "nothing")
    assert [r["lanelet_id"] for r in rows(after, action="remove")] == gone


def test_with_every_option_a_second_time_changes_nothing(tmp_path: Path) -> None:
    draft = Draft()
    drawn = road(draft, [100.0, 60.0], 2, 1)
    before = edited(draft.read(tmp_path), drawn.forward[0][0], "road_name", "Alt")
    rules = (
        TransferRule(key="maxspeed", target="speed_limit", parser="speed", element="speed_limit_rule"),
        TransferRule(key="name", target="road_name", policy="review_conflicts"),
        TransferRule(key="surface", target="road_surface", parser="word", policy="fill_only"),
    )
    params = TransferParams(
        rules=rules, provenance_tags=True, lane_check_tags=True, remove_fragments=True, split_everywhere=True
    )
    roads = roads_of(
        [
            {"maxspeed": "50", "name": "A", "surface": "asphalt", "lanes": "3"},
            {"maxspeed:lanes": "30|30", "name": "B", "surface": "sett", "lanes": "5"},
        ]
    )
    once = run(before, along_x(before, [43.0]), roads, params)
    first = save(once.map, tmp_path / "once.osm")
    again = read(first)
    twice = run(again, along_x(again, [43.0]), roads, params)
    assert rows(once, action="split")
    assert save(twice.map, tmp_path / "twice.osm").read_bytes() == first.read_bytes()
    reviews = [
        sorted((r["lanelet_id"], r["key"], r["new"]) for r in rows(e, action="review")) for e in (once, twice)
    ]
    assert reviews[0] == reviews[1] != []


def edges(lanelet_map: LaneletMap, path: Path, source: dict[int, int]) -> Counter[tuple[str, int, int]]:
    """Every edge of Lanelet2's own routing graph, between the lanelets that were there before cutting."""
    lanelet2 = pytest.importorskip("lanelet2")
    projector = lanelet2.projection.UtmProjector(lanelet2.io.Origin(48.1, 11.5))
    loaded, errors = lanelet2.io.loadRobust(str(save(lanelet_map, path)), projector)
    assert not list(errors)
    rules = lanelet2.traffic_rules.create(
        lanelet2.traffic_rules.Locations.Germany, lanelet2.traffic_rules.Participants.Vehicle
    )
    graph = lanelet2.routing.RoutingGraph(loaded, rules)
    assert not list(graph.checkValidity(False))
    ways = {"follow": graph.following, "left": graph.lefts, "right": graph.rights}
    return Counter(
        (name, source.get(x.id, x.id), source.get(y.id, y.id))
        for name, reached in ways.items()
        for x in loaded.laneletLayer
        for y in reached(x)
    )


def test_lanelet2_routes_over_the_edges_of_before_and_one_more_per_cut(tmp_path: Path) -> None:
    draft = Draft()
    drawn = road(draft, [100.0, 60.0], 2, 2)
    for section in drawn.bounds:
        for way in (section[1], section[3]):
            draft.ways[way][1]["subtype"] = "dashed"
    before = draft.read(tmp_path)
    after = run(before, along_x(before, [43.0]), roads_of([{"maxspeed": "50"}, {"maxspeed": "30"}]))
    source = {r["lanelet_id"]: r["source_lanelet_id"] for r in rows(after, action="split")}
    assert len(source) == 4
    was, now = edges(before, tmp_path / "a.osm", {}), edges(after.map, tmp_path / "b.osm", source)
    cut = [*drawn.forward[0], *drawn.backward[0]]
    changes = Counter({k: 1 for k in was if k[0] != "follow" and k[1] in cut})
    assert sum(changes.values()) == 4
    assert now == was + Counter(("follow", k, k) for k in cut) + changes
