import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from matching_maps import (
    MapDraft,
    covered_once,
    differing_metres,
    from_ways,
    lanelet_map,
    metres_by_way,
    offset_line,
    roads,
    two_way_road,
    ways_of,
    with_other_ids,
)

from flexmap_tasks.config import CollapseParams, MatchParams
from flexmap_tasks.geometry.beliefs import beliefs
from flexmap_tasks.geometry.transitions import Net, pair_weights
from flexmap_tasks.matching.collapse import collapse
from flexmap_tasks.matching.match import match
from flexmap_tasks.matching.paths.road_graph import node_distances, one_way_of, road_graph
from flexmap_tasks.matching.paths.samples import samples_of
from flexmap_tasks.model.lanelets import follow_pairs, lanelets_of

PARAMS = MatchParams()
X = [(float(x), 0.0) for x in range(0, 201, 20)]


def run(built, placed, side="right"):
    return match(collapse(built, CollapseParams(driving_side=side)), built, placed, PARAMS)


def straight():
    draft = MapDraft()
    forward, backward = two_way_road(draft, X)
    return draft.build(), forward, backward


def test_it_is_the_default():
    assert PARAMS.method == "path"


def test_a_road_beside_its_way_is_matched_in_both_directions():
    built, forward, backward = straight()
    m = run(built, roads([[(-20.0, 2.0), (230.0, 2.0)]])).matches
    covered_once(built, m)
    assert m.decision.tolist() == ["match", "match"]
    assert m.lanelet_id.tolist() == [forward, backward]
    assert m.direction.tolist() == [1, -1]
    assert np.allclose(m.way_s_from_m, [20.0, 220.0], atol=1e-6)
    assert np.allclose(m.way_s_to_m, [220.0, 20.0], atol=1e-6)
    assert (m.confidence > 0.99).all()


def test_dual_carriageways_take_the_lanes_that_drive_on_them():
    built, forward, backward = straight()
    ways = [[(-20.0, -4.0), (230.0, -4.0)], [(230.0, 4.0), (-20.0, 4.0)]]
    m = run(built, roads(ways, [{"highway": "primary", "oneway": "yes"}] * 2)).matches
    assert dict(zip(m.lanelet_id.tolist(), m.way_id.tolist(), strict=True)) == {forward: 1, backward: 2}
    assert set(m.direction.tolist()) == {1}


def test_left_hand_traffic_takes_the_other_carriageways():
    draft = MapDraft()
    near = draft.lanelet(offset_line(X, 3.5), X)
    oncoming = draft.lanelet(offset_line(X, -3.5)[::-1], X[::-1])
    ways = [[(-20.0, 4.0), (230.0, 4.0)], [(230.0, -4.0), (-20.0, -4.0)]]
    m = run(draft.build(), roads(ways, [{"highway": "primary", "oneway": "yes"}] * 2), "left").matches
    assert dict(zip(m.lanelet_id.tolist(), m.way_id.tolist(), strict=True)) == {near: 1, oncoming: 2}


def test_driving_against_a_one_way_road_goes_to_review():
    built, forward, backward = straight()
    m = run(built, roads([[(-20.0, 0.0), (230.0, 0.0)]], [{"highway": "service", "oneway": "yes"}])).matches
    got = dict(zip(m.lanelet_id.tolist(), zip(m.decision, m.reason, strict=True), strict=True))
    assert got[forward][0] == "match"
    assert got[backward] == ("review", "the lanelet runs against a one-way road")


def test_a_displaced_town_is_matched_by_its_shape():
    """Every road lies 9 m off, where the next parallel road is no further away than the right one."""
    draft, ways, right = MapDraft(), [], {}
    for k, y in enumerate((0.0, 60.0, 78.0, 150.0)):
        ids = two_way_road(draft, [(x, y) for x, _ in X])
        right |= dict.fromkeys(ids, k + 1)
        ways.append([(-30.0, y + 9.0), (230.0, y + 9.0)])
    built = draft.build()
    m = run(built, roads(ways)).matches
    covered_once(built, m)
    assert dict(zip(m.lanelet_id.tolist(), m.way_id.tolist(), strict=True)) == right


def test_a_parallel_road_does_not_stand_in_for_one_that_is_missing():
    draft, ways = MapDraft(), []
    lost = two_way_road(draft, [(x, 300.0) for x, _ in X])
    for y in (0.0, 60.0, 120.0):
        two_way_road(draft, [(x, y) for x, _ in X])
        ways.append([(-30.0, y + 0.5), (230.0, y + 0.5)])
    ways.append([(-30.0, 314.0), (230.0, 314.0)])
    m = run(draft.build(), roads(ways)).matches
    assert set(m.decision[np.isin(m.lanelet_id, lost)]) == {"none"}
    assert set(m.decision[~np.isin(m.lanelet_id, lost)]) == {"match"}


def test_a_town_that_is_displaced_more_and_more_is_followed():
    """Roads lie off by up to 16 m in one corner of the town, as far as the next road, and not at all in another."""
    draft, ways, right = MapDraft(), [], {}
    for k in range(9):
        ids = two_way_road(draft, [(x, 60.0 * k) for x, _ in X])
        right |= dict.fromkeys(ids, k + 1)
        ways.append([(-30.0, 62.0 * k), (230.0, 62.0 * k)])
    m = run(draft.build(), roads(ways)).matches
    assert dict(zip(m.lanelet_id.tolist(), m.way_id.tolist(), strict=True)) == right


def test_a_road_drawn_badly_between_its_ends_is_matched_on():
    """The way bows 14 m away from the lanes and comes back: a road does not end and begin again there."""
    draft = MapDraft()
    course = [(float(x), 0.0) for x in range(0, 401, 20)]
    two_way_road(draft, course)
    bow = [(x, 14.0 if 160 < x < 240 else 0.0) for x, _ in [(-20.0, 0.0), *course, (420.0, 0.0)]]
    m = run(draft.build(), roads([bow])).matches
    assert set(m.way_id.tolist()) == {1}


def test_a_road_for_one_lane_does_not_stand_in_for_a_wide_one():
    """Two lanes each way, and no road but a lane for deliveries 6 m beside; one lane each way may well be that."""
    for lanes, tags, found in (
        (2, {"highway": "service"}, 0), (2, {"highway": "tertiary", "lanes": "1", "oneway": "yes"}, 0),
        (2, {"highway": "tertiary"}, 4), (1, {"highway": "service"}, 4),
    ):  # fmt: skip
        draft, ways = MapDraft(), []
        for y in (200.0, 300.0, 400.0):
            two_way_road(draft, [(x, y) for x, _ in X])
            ways.append([(-30.0, y), (230.0, y)])
        mine = []
        for k in range(lanes):
            inner, outer = 3.5 * k, 3.5 * (k + 1)
            mine.append(draft.lanelet(offset_line(X, -inner), offset_line(X, -outer)))
            mine.append(draft.lanelet(offset_line(X, inner)[::-1], offset_line(X, outer)[::-1]))
        placed = roads([*ways, [(-30.0, 4.5), (230.0, 4.5)]], [{"highway": "residential"}] * 3 + [tags])
        m = run(draft.build(), placed).matches
        assert set(m.way_id[np.isin(m.lanelet_id, mine)].tolist()) == {found}, (lanes, tags)


def test_a_bridge_is_not_mistaken_for_the_road_below():
    """Two roads cross without a node in common: each lanelet stays on its own."""
    draft = MapDraft()
    along = two_way_road(draft, X)
    across = two_way_road(draft, [(100.0, float(y)) for y in range(-100, 101, 20)])
    built = draft.build()
    ways = [[(-30.0, 1.0), (230.0, 1.0)], [(101.0, -130.0), (101.0, 130.0)]]
    tags = [{"highway": "residential"}, {"highway": "residential", "bridge": "yes", "layer": "1"}]
    m = run(built, roads(ways, tags)).matches
    assert set(m.way_id[np.isin(m.lanelet_id, along)].tolist()) == {1}
    assert set(m.way_id[np.isin(m.lanelet_id, across)].tolist()) == {2}


@pytest.mark.parametrize("tags", [{"layer": "1"}, {"bridge": "viaduct"}])
def test_roads_above_each_other_are_told_apart_by_height(tags):
    """Two decks over one course; the ways differ in their layer only."""
    draft = MapDraft()
    low = draft.lanelet(X, offset_line(X, -3.5))
    high = draft.lanelet([(x, 0.1) for x, _ in X], offset_line(X, -3.4))
    built = draft.build()
    xyz = built.xyz_m.copy()
    upper = np.isin(xyz[:, 1].round(3), (0.1, -3.4))
    xyz[upper, 2] = 7.0
    course = [(-20.0, -1.5), (230.0, -1.5)], [(-20.0, -1.51), (230.0, -1.51)]
    plain = {"highway": "motorway"}
    m = run(lanelet_map(built.document, xyz), roads(course, [plain, plain | tags])).matches
    assert dict(zip(m.lanelet_id.tolist(), m.way_id.tolist(), strict=True)) == {low: 1, high: 2}
    m = run(lanelet_map(built.document, xyz), roads(course, [plain | tags, plain])).matches
    assert dict(zip(m.lanelet_id.tolist(), m.way_id.tolist(), strict=True)) == {low: 2, high: 1}


def crossing():
    """A T-junction: a two-way main road in two parts, a side road, and two of the turns."""
    draft = MapDraft()
    two_way_road(draft, [(0.0, 0.0), (90.0, 0.0)])
    two_way_road(draft, [(110.0, 0.0), (200.0, 0.0)])
    two_way_road(draft, [(100.0, -10.0), (100.0, -90.0)])
    ahead = draft.lanelet([(90.0, 0.0), (110.0, 0.0)], [(90.0, -3.5), (110.0, -3.5)])
    turn = draft.lanelet(
        [(90.0, 0.0), (97.0, -3.0), (100.0, -10.0)], [(90.0, -3.5), (95.0, -5.0), (96.5, -10.0)]
    )
    return draft.build(), ahead, turn


def test_turns_follow_the_roads_they_join():
    built, ahead, turn = crossing()
    main, side = [(-30.0, 1.0), (101.0, 1.0), (230.0, 1.0)], [(101.0, 1.0), (101.0, -120.0)]
    m = run(built, roads([main, side])).matches
    covered_once(built, m)
    assert set(m.way_id[m.lanelet_id == ahead].tolist()) == {1}
    of_turn = m.way_id[m.lanelet_id == turn].tolist()
    assert of_turn in ([1, 2], [2])


def test_a_turn_into_a_road_that_does_not_exist_ends_halfway():
    built, _, turn = crossing()
    m = run(built, roads([[(-30.0, 1.0), (230.0, 1.0)]])).matches
    rows = np.flatnonzero(m.lanelet_id == turn)
    assert m.way_id[rows].tolist() == [1, 0]
    assert m.decision[rows[1]] == "none"
    side = [i for i in np.unique(m.lanelet_id) if (m.way_id[m.lanelet_id == i] == 0).all()]
    assert len(side) == 2


def test_a_ring_may_be_driven_past_the_place_where_its_way_begins():
    """A ring without a junction: the way begins halfway along a lanelet."""
    angle = np.linspace(0, 2 * np.pi, 37)[:-1]
    ring = [(float(x), float(y)) for x, y in zip(40 * np.cos(angle), 40 * np.sin(angle), strict=True)]
    draft = MapDraft()
    parts = [[ring[(k + 9 * q + 5) % 36] for k in range(10)] for q in range(4)]
    ids = [
        draft.lanelet([(x * 0.94, y * 0.94) for x, y in p], [(x * 1.06, y * 1.06) for x, y in p])
        for p in parts
    ]
    built = draft.build()
    m = run(built, roads([[*ring, ring[0]]])).matches
    covered_once(built, m)
    assert set(m.direction.tolist()) == {1}
    length = np.abs(m.way_s_to_m - m.way_s_from_m)
    assert length == pytest.approx(m.s_to_m - m.s_from_m, rel=0.05, abs=0.5)
    assert len(m) == len(ids) + 1


@pytest.mark.parametrize("lines", [[], [[(0.0, 0.0)]], [[(0.0, 400.0), (100.0, 400.0)]]])
def test_no_roads_nearby(lines):
    built, *_ = straight()
    m = run(built, roads(lines)).matches
    covered_once(built, m)
    assert set(m.decision) == {"none"}


def test_no_lanes_and_lanes_without_length():
    draft = MapDraft()
    draft.lanelet(X, offset_line(X, -2.0), "walkway")
    assert len(run(draft.build(), roads([X])).matches) == 0
    built, *_ = straight()
    squeezed = built.xyz_m.copy()
    squeezed[:, 0] = 5.0
    m = run(lanelet_map(built.document, squeezed), roads([X])).matches
    assert len(np.unique(m.lanelet_id)) == 2


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.lists(st.tuples(st.floats(-20, 220), st.floats(-15, 15)), max_size=8), max_size=6),
    st.lists(st.sampled_from(["yes", "-1", "no", "reversible", ""]), min_size=6, max_size=6),
)
def test_no_drawing_of_roads_breaks_the_cover(lines, one_way):
    built, *_ = straight()
    tags = [{"highway": "road", "oneway": value} for _, value in zip(lines, one_way, strict=False)]
    m = run(built, roads(lines, tags)).matches
    covered_once(built, m)
    assert ((m.confidence >= 0) & (m.confidence <= 1)).all()
    assert (np.isfinite(m.way_s_from_m) == (m.way_id > 0)).all()
    assert ((m.decision == "none") == (m.way_id == 0)).all()


def test_garching_is_matched_almost_whole(garching):
    line = collapse(garching.map, CollapseParams())
    m = match(line, garching.map, garching.roads, PARAMS).matches
    covered_once(garching.map, m)
    samples = samples_of(line, garching.map, 5.0)
    turns = line.members.lanelet_id[samples.connector[samples.offset[samples.home]]]
    road = ~np.isin(m.lanelet_id, turns)
    length = m.s_to_m - m.s_from_m
    assert length[road & (m.way_id > 0)].sum() / length[road].sum() >= 0.99
    assert length[m.way_id > 0].sum() / length.sum() >= 0.98
    old = match(line, garching.map, garching.roads_2016, PARAMS).matches
    assert {2058, 2059, 3914, 3915} <= set(old.lanelet_id[old.way_id == 0].tolist()), "roads built since 2016"
    _nothing_else_is_lost(garching, m, old)


def _nothing_else_is_lost(garching, today, then):
    """What has a road in 2023 and none in 2016 lies by a way that was not there in 2016, or runs into such a lane.

    All but 70 m, of short pieces of one small road between new ones.
    """
    new = np.setdiff1d(garching.roads.network.way_id, garching.roads_2016.network.way_id)
    found = lanelets_of(garching.map)
    follow = found.id[follow_pairs(garching.map, found)]
    built = set(today.lanelet_id[np.isin(today.way_id, new)].tolist())
    joined = (
        built | {a for a, b in follow.tolist() if b in built} | {b for a, b in follow.tolist() if a in built}
    )
    lost, known = metres_of_lanelets(then, then.way_id == 0), metres_of_lanelets(today, today.way_id > 0)
    gone = {i: min(m, known.get(i, 0.0)) for i, m in lost.items() if i not in joined}
    assert sum(gone.values()) < 0.01 * sum(known.values()), gone


def metres_of_lanelets(matches, rows) -> dict[int, float]:
    out: dict[int, float] = {}
    for lanelet, a, b in zip(
        matches.lanelet_id[rows].tolist(),
        matches.s_from_m[rows].tolist(),
        matches.s_to_m[rows].tolist(),
        strict=True,
    ):
        out[lanelet] = out.get(lanelet, 0.0) + b - a
    return out


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_ids_and_order_do_not_matter(garching, seed):
    expected = run(garching.map, garching.roads).matches
    shuffled, back = with_other_ids(garching.map, seed)
    rng = np.random.default_rng(seed)
    ways = ways_of(garching.roads)
    new_id = dict(zip([w[0] for w in ways], (rng.permutation(len(ways)) + 1).tolist(), strict=True))
    nodes = np.unique(garching.roads.network.node_id)
    new_node = rng.permutation(len(nodes)) + 1
    renamed = [(new_id[w[0]], new_node[np.searchsorted(nodes, w[1])], w[2], w[3]) for w in ways]
    got = run(shuffled, from_ways(sorted(renamed, key=lambda w: w[0]))).matches
    old_id = {v: k for k, v in new_id.items()} | {0: 0}
    a = metres_by_way(expected)
    b = {(back[i], old_id[w], d): m for (i, w, d), m in metres_by_way(got).items()}
    assert differing_metres(a, b) == pytest.approx(0.0, abs=1e-3)


def merged(ways):
    """Pairs of ways with equal tags that meet end to start made one; new id -> old ids with lengths."""
    out, parts, used = [], {}, set()
    starts = {int(n[0]): k for k, (_, n, _, _) in enumerate(ways) if len(n) > 1}
    for k, (i, n, p, t) in enumerate(ways):
        j = starts.get(int(n[-1])) if len(n) > 1 else None
        if k in used:
            continue
        if j is not None and j != k and j not in used and j > k and ways[j][3] == t:
            used.add(j)
            out.append((i, np.concatenate([n, ways[j][1][1:]]), np.concatenate([p, ways[j][2][1:]]), t))
            parts[i] = {i, ways[j][0]}
            continue
        out.append((i, n, p, t))
        parts.setdefault(i, {i})
    return out, parts


def forget_ways(metres, name):
    out = {}
    for (i, w, d), m in metres.items():
        key = (i, name(w), d if name(w) == w else 0)
        out[key] = out.get(key, 0.0) + m
    return out


def test_ways_reversed_split_merged_or_densified_give_the_same_matches(garching):
    expected = metres_by_way(run(garching.map, garching.roads).matches)
    ways = ways_of(garching.roads)

    turned = [(i, n[::-1], p[::-1], turned_tags(t)) for i, n, p, t in ways]
    got = metres_by_way(run(garching.map, from_ways(turned)).matches)
    back = {(i, w, -d): m for (i, w, d), m in got.items()}
    assert differing_metres(expected, back) == pytest.approx(0.0, abs=1e-3)

    parts = []
    for i, n, p, t in ways:
        at = len(n) // 2
        parts += [(i * 2, n[: at + 1], p[: at + 1], t), (i * 2 + 1, n[at:], p[at:], t)]
    split: dict[tuple[int, int, int], float] = {}
    for (i, w, d), m in metres_by_way(run(garching.map, from_ways(parts)).matches).items():
        split[i, w // 2, d] = split.get((i, w // 2, d), 0.0) + m
    assert differing_metres(expected, split) == pytest.approx(0.0, abs=1e-3)

    joined, origin = merged(ways)
    assert len(joined) < len(ways)
    first = {old: new for new, olds in origin.items() for old in olds}
    got = metres_by_way(run(garching.map, from_ways(joined)).matches)
    want: dict[tuple[int, int, int], float] = {}
    for (i, w, d), m in expected.items():
        want[i, first.get(w, 0), d] = want.get((i, first.get(w, 0), d), 0.0) + m
    assert differing_metres(want, got) == pytest.approx(0.0, abs=0.01)

    dense = [
        (i, np.asarray(shapely.segmentize(shapely.linestrings(p), 1.7).coords), t) for i, _, p, t in ways
    ]
    _, number = np.unique(np.concatenate([d[1] for d in dense]).round(6), axis=0, return_inverse=True)
    ends = np.cumsum([0, *(len(d[1]) for d in dense)])
    again = [
        (i, number.ravel()[a:b], p, t) for (i, p, t), a, b in zip(dense, ends[:-1], ends[1:], strict=True)
    ]
    got = metres_by_way(run(garching.map, from_ways(again)).matches)
    assert differing_metres(expected, got) < 1.0


def turned_tags(tags):
    """The same road drawn the other way round."""
    value = tags.get("oneway")
    ring = tags.get("junction") in ("roundabout", "circular") or tags.get("highway") in (
        "motorway",
        "motorway_link",
    )
    swap = {"yes": "-1", "true": "-1", "1": "-1", "-1": "yes"}
    if value in swap:
        return tags | {"oneway": swap[value]}
    return tags | {"oneway": "-1"} if ring and value != "no" else tags


def test_a_map_moved_elsewhere_gives_the_same_matches(garching):
    """Another frame, as on the other side of a zone border: turned by the convergence and far away."""
    expected = metres_by_way(run(garching.map, garching.roads).matches)
    turn, move = np.radians(4.3), np.array([-411_300.0, 12_345.6])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    xy = garching.map.xyz_m[:, :2] @ rotation.T + move
    moved = lanelet_map(garching.map.document, np.column_stack([xy, garching.map.xyz_m[:, 2]]))
    ways = [(i, n, p @ rotation.T + move, t) for i, n, p, t in ways_of(garching.roads)]
    got = metres_by_way(run(moved, from_ways(ways)).matches)
    assert differing_metres(expected, got) < 0.01 * sum(expected.values())


def test_links_end_at_junctions_and_where_roads_change():
    ways = [
        [(0.0, 0.0), (50.0, 0.0)],
        [(100.0, 0.0), (50.0, 0.0)],
        [(100.0, 0.0), (150.0, 0.0)],
        [(50.0, 0.0), (50.0, 90.0)],
    ]
    tags = [{"highway": "residential"}] * 2 + [
        {"highway": "residential", "bridge": "yes"},
        {"highway": "service"},
    ]
    graph = road_graph(roads(ways, tags))
    assert len(graph) == 4
    plain = road_graph(roads(ways[:2], tags[:2]))
    assert len(plain) == 1
    assert plain.length_m.tolist() == [100.0]
    assert sorted(plain.way.tolist()) == [0, 1]
    opposed = road_graph(roads(ways[:2], [{"highway": "residential", "oneway": "yes"}] * 2))
    assert len(opposed) == 2


def test_one_way_as_tagged_or_implied():
    tags = [{"oneway": v} for v in ("yes", "-1", "no", "reversible")]
    tags += [{"junction": "roundabout"}, {"highway": "motorway"}, {"highway": "motorway", "oneway": "no"}, {}]
    lines = [[(0.0, float(k)), (1.0, float(k))] for k in range(len(tags))]
    assert one_way_of(roads(lines, tags).network).tolist() == [1, -1, 0, 0, 1, 1, 0, 0]


def test_node_distances_are_shortest_ways():
    square = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]
    ways = [[square[k], square[(k + 1) % 4]] for k in range(4)] + [
        [p, (p[0] * 9 - 40, p[1] * 9 - 40)] for p in square
    ]
    graph = road_graph(roads(ways))
    offset, node, metres = node_distances(graph, 25.0)
    corner = {tuple(graph.a_m[graph.offset[k]]): int(graph.tail[k]) for k in range(len(graph))}
    corner |= {tuple(graph.b_m[graph.offset[k + 1] - 1]): int(graph.head[k]) for k in range(len(graph))}
    of = corner[0.0, 0.0]
    near = dict(
        zip(
            node[offset[of] : offset[of + 1]].tolist(),
            metres[offset[of] : offset[of + 1]].tolist(),
            strict=True,
        )
    )
    assert near == {of: 0.0, corner[10.0, 0.0]: 10.0, corner[0.0, 10.0]: 10.0, corner[10.0, 10.0]: 20.0}


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_beliefs_on_a_tree_are_the_exact_marginals(n, seed):
    rng = np.random.default_rng(seed)
    size = rng.integers(1, 4, n)
    offset = np.concatenate([[0], np.cumsum(size)])
    unary = rng.uniform(0.1, 1.0, offset[-1])
    edges = np.array([(int(rng.integers(0, k)), k) for k in range(1, n)], dtype=np.int64).reshape(-1, 2)
    tables = [rng.uniform(0.1, 1.0, (size[a], size[b])) for a, b in edges]
    pair_offset = np.concatenate([[0], np.cumsum([t.size for t in tables])]).astype(np.int64)
    pair = np.concatenate([t.ravel() for t in tables]) if tables else np.zeros(0)
    joint = np.zeros(size)
    for index in np.ndindex(*size):
        weight = np.prod([unary[offset[k] + index[k]] for k in range(n)])
        joint[index] = weight * np.prod(
            [t[index[a], index[b]] for t, (a, b) in zip(tables, edges, strict=True)]
        )
    got = beliefs(offset.astype(np.int64), unary, edges, pair_offset, pair, n)
    for k in range(n):
        exact = joint.sum(axis=tuple(j for j in range(n) if j != k))
        assert np.allclose(got[offset[k] : offset[k + 1]], exact / exact.sum(), atol=1e-6)


def test_transitions_measure_the_way_along_the_road():
    """Link 0 runs from node 0 to 1 (100 m), link 1 from node 1 to 2 (50 m); 20 m are travelled."""
    net = Net(
        np.array([0, 1]),
        np.array([1, 2]),
        np.array([100.0, 50.0]),
        np.array([0, 1, 2, 3]),
        np.array([0, 1, 2]),
        np.zeros(3),
    )
    link, direction = np.array([0, 0, 1, 0, -1]), np.array([1, 1, 1, -1, 0])
    s = np.array([90.0, 100.0, 10.0, 95.0, 0.0])
    offset = np.array([0, 1, 5])
    _, weight = pair_weights(
        offset, link, direction, s, np.array([[0, 1]]), np.array([20.0]), np.array([4.0]), net, 5.0, 3.0
    )
    # 10 m ahead on the same link; 20 m around the corner; turned back; into nowhere.
    assert weight == pytest.approx(np.exp([-10 / 4, 0.0, -5 / 4, -3.0]))
