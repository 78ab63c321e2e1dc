from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from transfer_worlds import (
    LANE_M,
    Draft,
    along_x,
    matches_of,
    members_of,
    read,
    road,
    roads_of,
    rows,
    run,
    save,
    tags_of,
)

from flexmap_tasks.config import TransferParams
from flexmap_tasks.model.conflation import Enriched
from flexmap_tasks.model.lanelets import (
    adjacency,
    bound_polylines,
    centrelines,
    follow_pairs,
    lanelets_of,
    lengths_m,
)
from flexmap_tasks.model.maps import LaneletMap

SPEEDS = [{"highway": "secondary", "maxspeed": str(v)} for v in (50, 30, 70, 40, 60, 20)]


def bounds_of(lanelet_map: LaneletMap, lanelet_id: int) -> dict[str, int]:
    return {role: ref for kind, ref, role in members_of(lanelet_map, lanelet_id) if kind == "way"}


def refs(lanelet_map: LaneletMap, way_id: int) -> list[int]:
    ways = lanelet_map.document.ways
    row = int(np.flatnonzero(ways.id == way_id)[0])
    return ways.ref[ways.offset[row] : ways.offset[row + 1]].tolist()


def area_m2(lanelet_map: LaneletMap) -> tuple[float, bool]:
    lanelets = lanelets_of(lanelet_map)
    left, right = (bound_polylines(lanelet_map, lanelets, side) for side in ("left", "right"))
    total, valid = 0.0, True
    for k in range(len(lanelets)):
        a = left.xyz_m[left.offset[k] : left.offset[k + 1], :2]
        b = right.xyz_m[right.offset[k] : right.offset[k + 1], :2]
        polygon = shapely.Polygon(np.concatenate([a, b[::-1]]))
        total, valid = total + polygon.area, valid and polygon.is_valid and polygon.area > 0
    return total, valid


def sound(before: LaneletMap, after: LaneletMap) -> None:
    """What must hold after any cutting."""
    ways = after.document.ways
    for i in range(len(ways.id)):
        nodes = ways.ref[ways.offset[i] : ways.offset[i + 1]]
        assert len(nodes) >= 2
        assert len(np.unique(nodes)) == len(nodes)
    for kind in ("nodes", "ways", "relations"):
        a, b = getattr(before.document, kind), getattr(after.document, kind)
        assert np.isin(a.id, b.id).all()
        assert len(np.unique(b.id)) == len(b.id)
        assert (b.id > 0).all()
    one, two = lanelets_of(before), lanelets_of(after)
    pairs = np.stack([two.left_way, two.right_way], axis=1)
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    assert len(follow_pairs(after, two)) == len(follow_pairs(before, one)) + len(two) - len(one)
    total = [lengths_m(centrelines(m, lanelets_of(m))).sum() for m in (before, after)]
    assert total[0] == pytest.approx(total[1], rel=2e-3)
    (area_before, _), (area_after, valid) = area_m2(before), area_m2(after)
    assert valid
    assert area_before == pytest.approx(area_after, rel=1e-9)


def test_the_whole_carriageway_is_cut_and_bounds_stay_shared(tmp_path: Path) -> None:
    draft = Draft()
    drawn = road(draft, [100.0], 2, 2)
    before = draft.read(tmp_path)
    after = run(before, along_x(before, [43.0]), roads_of(SPEEDS)).map
    sound(before, after)
    lanelets = lanelets_of(after)
    assert len(lanelets) == 8
    assert len(after.document.ways.id) == 10
    assert len(after.document.nodes.id) == len(before.document.nodes.id) + 5
    near = adjacency(lanelets)
    assert len(near) == 2 * len(adjacency(lanelets_of(before)))
    assert int((~near.same_direction).sum()) == 4
    speeds = {int(i): tags_of(after, int(i))["speed_limit"] for i in lanelets.id}
    for lane in drawn.forward[0]:
        assert speeds[lane] == "50"
    for lane in drawn.backward[0]:
        assert speeds[lane] == "30"
    assert sorted(speeds.values()) == ["30"] * 4 + ["50"] * 4
    new = np.setdiff1d(after.document.nodes.id, before.document.nodes.id)
    xyz_m = after.xyz_m[np.isin(after.document.nodes.id, new)]
    np.testing.assert_allclose(xyz_m[:, 0], 43.0, atol=1e-6)
    np.testing.assert_allclose(np.sort(xyz_m[:, 1]), np.arange(-2, 3) * LANE_M, atol=1e-9)


def test_the_nearest_vertex_is_used(tmp_path: Path) -> None:
    draft = Draft()
    road(draft, [100.0], 1, 1)
    before = draft.read(tmp_path)
    after = run(before, along_x(before, [49.2]), roads_of(SPEEDS)).map
    sound(before, after)
    assert len(lanelets_of(after)) == 4
    assert after.document.nodes.id.tolist() == before.document.nodes.id.tolist()


@pytest.mark.parametrize("place", [0.5, 2.9, 97.2, 99.9])
def test_no_cut_near_an_end(tmp_path: Path, place: float) -> None:
    draft = Draft()
    road(draft, [100.0], 1, 0)
    before = draft.read(tmp_path)
    assert len(lanelets_of(run(before, along_x(before, [place]), roads_of(SPEEDS)).map)) == 1


def test_no_cut_where_nothing_that_lands_changes(tmp_path: Path) -> None:
    draft = Draft()
    road(draft, [100.0], 1, 0)
    before = draft.read(tmp_path)
    same = [
        {"maxspeed": "50", "lit": "yes", "lanes": "2"},
        {"maxspeed": "50 km/h", "lit": "no", "lanes": "3"},
    ]
    assert len(lanelets_of(run(before, along_x(before, [50.0]), roads_of(same)).map)) == 1
    as_it_is = [{"maxspeed": "10"}, {}]
    assert len(lanelets_of(run(before, along_x(before, [50.0]), roads_of(as_it_is)).map)) == 1


def test_a_gap_in_the_match_does_not_cut(tmp_path: Path) -> None:
    draft = Draft()
    lane = road(draft, [100.0], 1, 0).forward[0][0]
    before = draft.read(tmp_path)
    pieces = matches_of([(lane, 0.0, 30.0, 100, 1), (lane, 55.0, 95.0, 100, 1)])
    after = run(before, pieces, roads_of(SPEEDS))
    assert len(lanelets_of(after.map)) == 1
    assert tags_of(after.map, lane)["speed_limit"] == "50"


def test_a_long_unmatched_end_keeps_what_the_map_says(tmp_path: Path) -> None:
    draft = Draft()
    lane = road(draft, [100.0], 1, 0).forward[0][0]
    before = draft.read(tmp_path)
    after = run(before, matches_of([(lane, 0.0, 55.0, 100, 1)]), roads_of(SPEEDS)).map
    speeds = [tags_of(after, int(i))["speed_limit"] for i in lanelets_of(after).id]
    assert speeds == ["50", "10"]


def test_lanes_closed_to_cars_hold_the_carriageway_together(tmp_path: Path) -> None:
    draft = Draft()
    drawn = road(draft, [100.0], 1, 0)
    edge = draft.way([draft.node(x, -7.0) for x in (0.0, 50.0, 100.0)])
    bicycles = draft.lanelet(drawn.bounds[0][0], edge, subtype="bicycle_lane")
    before = draft.read(tmp_path)
    kept = run(before, along_x(before, [40.0]), roads_of(SPEEDS))
    assert len(lanelets_of(kept.map)) == 2
    assert rows(kept, action="review", key="", lanelet_id=drawn.forward[0][0])
    cut = run(before, along_x(before, [40.0]), roads_of(SPEEDS), TransferParams(split_everywhere=True))
    sound(before, cut.map)
    assert len(lanelets_of(cut.map)) == 4
    assert tags_of(cut.map, bicycles)["speed_limit"] == "10"


def test_a_lanelet_driven_both_ways_is_cut_on_request(tmp_path: Path) -> None:
    draft = Draft()
    road(draft, [100.0], 1, 0, one_way="no")
    before = draft.read(tmp_path)
    assert len(lanelets_of(run(before, along_x(before, [40.0]), roads_of(SPEEDS)).map)) == 1
    cut = run(before, along_x(before, [40.0]), roads_of(SPEEDS), TransferParams(split_everywhere=True)).map
    sound(before, cut)
    assert not lanelets_of(cut).one_way.any()
    assert len(lanelets_of(cut)) == 2


def test_a_merge_is_cut_alike_in_both_lanelets(tmp_path: Path) -> None:
    draft = Draft()
    drawn = road(draft, [100.0], 1, 0)
    start, end = refs_at(draft, drawn.bounds[0][0])
    outer = draft.way([start, draft.node(30.0, -6.0), draft.node(70.0, -6.0), end])
    draft.lanelet(drawn.bounds[0][0], outer)
    before = draft.read(tmp_path)
    after = run(before, along_x(before, [50.0]), roads_of(SPEEDS)).map
    assert len(lanelets_of(after)) == 4
    assert area_m2(after)[1]


def refs_at(draft: Draft, way: int) -> tuple[int, int]:
    return draft.ways[way][0][0], draft.ways[way][0][-1]


def rules_world(tmp_path: Path) -> tuple[LaneletMap, dict[str, int]]:
    """One section of 1+1 lanes with every kind of rule, an area beside it and a drawn centreline."""
    draft = Draft()
    drawn = road(draft, [100.0], 1, 1)
    ahead, back = drawn.forward[0][0], drawn.backward[0][0]
    low, _, high = drawn.bounds[0]
    ids = {"ahead": ahead, "back": back, "low": low, "high": high}
    for name, x in (("stop", 99.0), ("early", 10.0)):
        ids[name] = draft.way([draft.node(x, -3.5), draft.node(x, 0.0)], type="stop_line")
    sign = draft.way([draft.node(50.0, -5.0), draft.node(50.5, -5.0)], type="traffic_sign")
    rule = {"type": "regulatory_element"}
    ids["light"] = draft.relation(
        [("way", sign, "refers"), ("way", ids["stop"], "ref_line")], subtype="traffic_light", **rule
    )
    ids["dark"] = draft.relation([("way", sign, "refers")], subtype="traffic_light", **rule)
    ids["sign"] = draft.relation(
        [("way", sign, "refers"), ("way", ids["early"], "ref_line")], subtype="traffic_sign", **rule
    )
    ids["speed"] = draft.relation([("way", sign, "refers")], subtype="speed_limit", sign_type="de274", **rule)
    ids["yield"] = draft.relation(
        [("relation", ahead, "yield"), ("relation", back, "right_of_way")], subtype="right_of_way", **rule
    )
    for name in ("light", "dark", "sign", "speed", "yield"):
        draft.relations[ahead][0].append(("relation", ids[name], "regulatory_element"))
    ids["centre"] = draft.way([draft.node(x, -1.75) for x in (0.0, 33.0, 66.0, 100.0)], type="virtual")
    draft.relations[ahead][0].append(("way", ids["centre"], "centerline"))
    first, last = refs_at(draft, low)
    far = draft.way([last, draft.node(100.0, -20.0), draft.node(0.0, -20.0), first])
    ids["area"] = draft.relation(
        [("way", far, "outer"), ("way", low, "outer")], type="multipolygon", subtype="parking"
    )
    ids["reverse"] = draft.relation(
        [("way", low, "outer"), ("way", far, "outer")], type="multipolygon", subtype="parking"
    )
    ids["far"] = far
    return draft.read(tmp_path), ids


def test_rules_stay_on_the_pieces_they_hold_for(tmp_path: Path) -> None:
    before, ids = rules_world(tmp_path)
    after = run(before, along_x(before, [40.0]), roads_of(SPEEDS)).map
    first = ids["ahead"]
    (second,) = (
        i
        for i in lanelets_of(after).id
        if i not in (ids["ahead"], ids["back"])
        and bounds_of(after, i)["right"] != ids["low"]
        and "centerline" in bounds_of(after, i)
    )
    held = [
        {r for _, r, role in members_of(after, i) if role == "regulatory_element"} for i in (first, second)
    ]
    assert held[0] == {ids["sign"], ids["speed"], ids["yield"]}
    assert held[1] == {ids["light"], ids["dark"], ids["speed"], ids["yield"]}
    rule = members_of(after, ids["yield"])
    assert [r for _, r, role in rule if role == "yield"] == [first, second]
    assert ids["back"] in [r for _, r, role in rule if role == "right_of_way"]
    assert len(rule) == 4


def test_areas_and_drawn_centrelines_get_both_pieces_in_order(tmp_path: Path) -> None:
    before, ids = rules_world(tmp_path)
    after = run(before, along_x(before, [40.0]), roads_of(SPEEDS)).map
    for area in (ids["area"], ids["reverse"]):
        ring = [refs(after, ref) for _, ref, _ in members_of(after, area)]
        assert len(ring) == 3
        for a, b in zip(ring, ring[1:] + ring[:1], strict=True):
            assert {a[0], a[-1]} & {b[0], b[-1]}
    drawn = [
        bounds_of(after, i)["centerline"]
        for i in lanelets_of(after).id
        if "centerline" in bounds_of(after, i)
    ]
    assert drawn[0] == ids["centre"]
    assert [
        after.xyz_m[np.isin(after.document.nodes.id, refs(after, w)), 0].max() for w in drawn
    ] == pytest.approx([40.0, 100.0])


def test_a_way_that_serves_a_rule_is_not_cut(tmp_path: Path) -> None:
    draft = Draft()
    drawn = road(draft, [100.0], 1, 0)
    draft.relation([("way", drawn.bounds[0][0], "refers")], type="regulatory_element", subtype="road_marking")
    before = draft.read(tmp_path)
    after = run(before, along_x(before, [40.0]), roads_of(SPEEDS))
    assert len(lanelets_of(after.map)) == 1
    assert "serves a rule" in str(rows(after, action="review", key="")[0]["reason"])


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    stops=st.lists(st.floats(1.0, 199.0), min_size=1, max_size=4),
    forward=st.integers(1, 3),
    backward=st.integers(0, 2),
    step_m=st.sampled_from([3.0, 10.0, 200.0]),
    snap_m=st.sampled_from([0.0, 1.0]),
)
def test_any_change_points(
    stops: list[float], forward: int, backward: int, step_m: float, snap_m: float
) -> None:
    draft = Draft()
    road(draft, [80.0, 120.0], forward, backward, step_m)
    params = TransferParams(split_snap_m=snap_m)
    with TemporaryDirectory() as folder:
        before = draft.read(Path(folder))
        roads = roads_of(SPEEDS)
        once = run(before, along_x(before, sorted(stops)), roads, params)
        sound(before, once.map)
        lanelets = lanelets_of(once.map)
        per_lane = len(lanelets) / (forward + backward)
        assert per_lane == int(per_lane)
        twice = run(once.map, along_x(once.map, sorted(stops)), roads, params)
        assert not rows(twice, action="set")
        assert not rows(twice, action="split")
        again = read(save(once.map, Path(folder) / "after.osm"))
        np.testing.assert_allclose(again.xyz_m, once.map.xyz_m, atol=1e-4)


def test_new_ids_do_not_depend_on_other_cuts(tmp_path: Path) -> None:
    draft = Draft()
    road(draft, [100.0, 100.0], 1, 1)
    before = draft.read(tmp_path)
    one = run(before, along_x(before, [43.0]), roads_of(SPEEDS)).map
    two = run(before, along_x(before, [43.0, 143.0]), roads_of(SPEEDS)).map
    for kind in ("nodes", "ways", "relations"):
        assert np.isin(getattr(one.document, kind).id, getattr(two.document, kind).id).all()


def picture(lanelet_map: LaneletMap) -> list[tuple[object, ...]]:
    """Every lanelet by its bounds and tags, without any id."""
    lanelets = lanelets_of(lanelet_map)
    lines = [bound_polylines(lanelet_map, lanelets, side) for side in ("left", "right")]
    out = []
    for k, i in enumerate(lanelets.id.tolist()):
        shape = tuple(
            tuple(np.round(b.xyz_m[b.offset[k] : b.offset[k + 1]], 3).ravel().tolist()) for b in lines
        )
        out.append((shape, tuple(sorted(tags_of(lanelet_map, i).items()))))
    return sorted(out)


def moved(after: Enriched, shift: dict[int, float]) -> dict[int, float]:
    """The shift of every lanelet after cutting, as that of what it was cut from."""
    cut = {r["lanelet_id"]: shift[r["source_lanelet_id"]] for r in rows(after, action="split")}
    return shift | cut


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    stops=st.lists(st.floats(1.0, 199.0), min_size=1, max_size=4),
    spread_m=st.sampled_from([0.0, 1.5, 6.0]),
    forward=st.integers(1, 3),
    backward=st.integers(0, 3),
    seed=st.integers(0, 1000),
)
def test_ids_order_and_drawing_direction_do_not_matter(
    stops: list[float], spread_m: float, forward: int, backward: int, seed: int
) -> None:
    draft, random = Draft(), np.random.default_rng(seed)
    road(draft, [80.0, 120.0], forward, backward)
    other, new = draft.renumbered(random)
    with TemporaryDirectory() as one, TemporaryDirectory() as two:
        first, second = draft.read(Path(one)), other.read(Path(two))
        roads = roads_of(SPEEDS)
        ids = lanelets_of(first).id.tolist()
        shift = dict(zip(ids, random.uniform(-spread_m, spread_m, len(ids)).tolist(), strict=True))
        told = along_x(first, sorted(stops), shift=shift)
        same = along_x(second, sorted(stops), shift={new[i]: s for i, s in shift.items()})
        after = run(first, told, roads)
        assert picture(after.map) == picture(run(second, same, roads).map)
        sound(first, after.map)
        assert lengths_m(centrelines(after.map, lanelets_of(after.map))).min() > 1.49
        twice = run(after.map, along_x(after.map, sorted(stops), shift=moved(after, shift)), roads)
        assert not rows(twice, action="split")
