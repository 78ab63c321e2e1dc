import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from matching_maps import MapDraft, from_ways, roads, two_way_road, ways_of

from flexmap_tasks.config import CollapseParams, MatchParams
from flexmap_tasks.matching.collapse import collapse
from flexmap_tasks.matching.gaps import _before, gaps
from flexmap_tasks.matching.match import match
from flexmap_tasks.matching.road_changes import road_changes

X = [(float(x), 0.0) for x in range(0, 201, 20)]


def matched(built, placed):
    line = collapse(built, CollapseParams())
    return line, match(line, built, placed, MatchParams()).matches


def town():
    draft = MapDraft()
    first = two_way_road(draft, X)
    lost = two_way_road(draft, [(x, 300.0) for x, _ in X])
    return draft.build(), first, lost


def test_both_maps_tell_what_the_other_lacks():
    built, first, lost = town()
    placed = roads(
        [[(-100.0, 1.0), (300.0, 1.0)], [(100.0, 1.0), (100.0, 25.0)], [(0.0, 900.0), (50.0, 900.0)]]
    )
    line, m = matched(built, placed)
    g = gaps(line, placed, m, 30.0, 10.0)
    by_kind = {k: set(g.id[g.kind == k].tolist()) for k in np.unique(g.kind)}
    assert by_kind == {"not_in_hd_map": {1, 2}, "not_in_osm": set(lost)}
    assert g.whole[(g.kind == "not_in_hd_map") & (g.id == 2)].all()
    ends = (g.kind == "not_in_hd_map") & (g.id == 1)
    assert not g.whole[ends].any()
    assert np.allclose(np.sort(g.s_to_m[ends] - g.s_from_m[ends]), 30.0, atol=5.0)
    assert (g.confidence[g.kind == "not_in_osm"] > 0.5).all()
    assert not set(first) & by_kind["not_in_osm"]


def test_roads_built_since_2016_come_out_as_not_in_osm(garching):
    line, m = matched(garching.map, garching.roads_2016)
    g = gaps(line, garching.roads_2016, m, 30.0, 10.0)
    assert {2058, 2059, 3914, 3915} <= set(g.id[(g.kind == "not_in_osm") & g.whole].tolist())
    line, m = matched(garching.map, garching.roads)
    today = gaps(line, garching.roads, m, 30.0, 10.0)
    assert not ((today.kind == "not_in_osm") & today.whole & (today.s_to_m > 20.0)).any()


@given(
    st.lists(st.tuples(st.integers(0, 3), st.floats(0, 10)), max_size=20),
    st.lists(st.tuples(st.integers(0, 3), st.floats(0, 10)), max_size=20),
)
def test_edges_are_counted_per_way(edges, places):
    ids, edge = np.array([e[0] for e in edges], dtype=np.int64), np.array([e[1] for e in edges])
    way, s = np.array([p[0] for p in places], dtype=np.int64), np.array([p[1] for p in places])
    expected = [sum(i == w and e <= p for i, e in edges) for w, p in places]
    assert _before(ids, edge, way, s).tolist() == expected


def test_changes_of_matched_roads_between_two_dates():
    built, *_ = town()
    tags = [{"highway": "residential", "maxspeed": "30"}, {"highway": "residential"}, {"highway": "service"}]
    lines = [[(-20.0, 1.0), (100.0, 1.0)], [(100.0, 1.0), (230.0, 1.0)], [(0.0, 900.0), (50.0, 900.0)]]
    before = roads(lines, tags)
    ways = ways_of(before)
    first = (
        ways[0][0],
        ways[0][1],
        ways[0][2] + [0.0, 0.5],
        {"highway": "residential", "maxspeed": "50", "lit": "yes"},
    )
    fresh = (9, np.array([2, 77]), ways[1][2], {"highway": "residential"})
    after = from_ways([first, fresh, (ways[2][0], ways[2][1], ways[2][2], {"highway": "track"})])
    (_, m0), (_, m1) = matched(built, before), matched(built, after)
    c = road_changes(before, after, m0, m1)
    rows = list(zip(c.way_id.tolist(), c.kind, c.key, c.old, c.new, strict=True))
    assert rows == [
        (1, "geometry", "", "", ""),
        (1, "tag", "lit", "", "yes"),
        (1, "tag", "maxspeed", "30", "50"),
        (2, "gone", "", "", ""),
        (9, "new", "", "", ""),
    ]
    assert c.moved_m[0] == np.float64(0.5)
    assert len(road_changes(before, before, m0, m0)) == 0
