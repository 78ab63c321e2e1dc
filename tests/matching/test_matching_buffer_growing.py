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
from flexmap_tasks.geometry.buffers import BufferShape, inside
from flexmap_tasks.geometry.segments import cut
from flexmap_tasks.matching.buffers.references import reference_lines
from flexmap_tasks.matching.collapse import collapse
from flexmap_tasks.matching.match import match
from flexmap_tasks.model.conflation import References
from flexmap_tasks.model.match_statistics import match_statistics

PARAMS = MatchParams(method="buffer_growing")
X = [(float(x), 0.0) for x in range(0, 101, 20)]


def run(built, placed, params=PARAMS):
    return match(collapse(built, CollapseParams()), built, placed, params)


def straight():
    draft = MapDraft()
    forward, backward = two_way_road(draft, X)
    return draft.build(), forward, backward


def test_a_road_beside_its_way_is_matched_in_both_directions():
    built, forward, backward = straight()
    m = run(built, roads([[(-20.0, 1.0), (130.0, 1.0)]])).matches
    covered_once(built, m)
    assert m.decision.tolist() == ["match", "match"]
    assert m.lanelet_id.tolist() == [forward, backward]
    assert m.direction.tolist() == [1, -1]
    assert np.allclose(m.way_s_from_m, [20.0, 120.0])
    assert np.allclose(m.way_s_to_m, [120.0, 20.0])
    assert (m.score > 0.9).all()
    assert np.allclose(m.d_angle_deg, 0.0, atol=1e-9)


def test_without_a_road_nearby_there_is_no_counterpart():
    built, *_ = straight()
    m = run(built, roads([[(0.0, 40.0), (100.0, 40.0)]])).matches
    covered_once(built, m)
    assert set(m.decision) == {"none"}
    assert set(m.way_id.tolist()) == {0}
    assert np.isnan(m.way_s_from_m).all()
    assert set(m.reason) == {"no road lies inside the buffers"}


@pytest.mark.parametrize(("aside_m", "half_width_m"), [(2.0, 2.5), (3.5, 3.75), (5.5, 5.625), (5.7, None)])
def test_buffers_are_enlarged_until_a_road_lies_inside(aside_m, half_width_m):
    built, *_ = straight()
    r = run(built, roads([[(-50.0, aside_m), (150.0, aside_m)]])).references
    assert r.matched.tolist() == [half_width_m is not None]
    assert r.buffer_half_width_m.tolist() == pytest.approx([half_width_m or np.nan], nan_ok=True)


def test_the_nearer_of_two_parallel_roads_is_taken():
    built, *_ = straight()
    near, far = [(-5.0, 1.0), (105.0, 1.0)], [(-5.0, -2.0), (105.0, -2.0)]
    assert set(run(built, roads([near, far])).matches.way_id.tolist()) == {1}
    assert set(run(built, roads([far, near])).matches.way_id.tolist()) == {2}


def test_a_crossing_road_is_not_followed():
    built, *_ = straight()
    along = [
        [(-20.0, 0.5), (50.0, 0.5)],
        [(50.0, 0.5), (120.0, 0.5)],
        [(50.0, -60.0), (50.0, 0.5), (50.0, 60.0)],
    ]
    m = run(built, roads(along)).matches
    covered_once(built, m)
    assert set(m.way_id.tolist()) == {1, 2}
    first = (m.way_id == 1) & (m.direction == 1)
    assert m.s_to_m[first] == pytest.approx([50.0], abs=0.1)


def test_a_way_that_ends_halfway_leaves_the_rest_without_counterpart():
    built, forward, _ = straight()
    m = run(built, roads([[(-20.0, 0.5), (85.0, 0.5)]])).matches
    covered_once(built, m)
    rest = (m.lanelet_id == forward) & (m.decision == "none")
    assert m.s_from_m[rest] == pytest.approx([85.0], abs=0.1)
    assert set(m.reason[rest]) == {"the matched road does not reach this far"}


def test_exclusion_limits_exclude():
    built, *_ = straight()
    slanted = roads([[(-10.0, -3.4), (110.0, 3.4)]])
    assert run(built, slanted).references.matched.all()
    strict = MatchParams(method="buffer_growing", angle_max_deg=2.0)
    found = run(built, slanted, strict)
    assert not found.references.matched.any()
    assert set(found.matches.reason) == {"every road inside the buffers breaks an exclusion limit"}


def test_a_curved_road_that_wiggles_about_its_way_is_matched():
    """Two lines that cross again and again are alike; no chord is turned round for it."""
    draft = MapDraft()
    x = np.linspace(0, 134, 40)
    two_way_road(draft, list(zip(x, 0.7 * np.sin(x / 9), strict=True)))
    built = draft.build()
    m = run(built, roads([[(-10.0, 0.0), (145.0, 0.0)]])).matches
    covered_once(built, m)
    assert set(m.decision) == {"match"}


def test_areas_and_broken_ways_are_passed_over():
    built, *_ = straight()
    lines = [
        [(-20.0, 0.5), (130.0, 0.5)],
        [(0.0, 0.0)],
        [(10.0, 0.2), (10.0, 0.2)],
        [],
        [(20.0, 0.0), (60.0, 2.0), (60.0, -2.0), (20.0, 2.0), (40.0, -2.0), (20.0, 0.0)],
        [(-20.0, 0.5), (130.0, 0.5)],
        [(np.nan, 0.0), (50.0, np.inf)],
        [(0.0, 0.0), (100.0, 0.0), (100.0, 1.0), (0.0, 1.0), (0.0, 0.0)],
    ]
    tags = [{"highway": "residential"}] * 7 + [{"highway": "residential", "area": "yes"}]
    m = run(built, roads(lines, tags)).matches
    covered_once(built, m)
    assert set(m.way_id.tolist()) == {1}


@pytest.mark.parametrize("lines", [[], [[(0.0, 0.0)]]])
def test_no_roads_at_all(lines):
    built, *_ = straight()
    m = run(built, roads(lines)).matches
    covered_once(built, m)
    assert set(m.decision) == {"none"}


def test_no_lanes_at_all():
    draft = MapDraft()
    draft.lanelet(X, offset_line(X, -2.0), "walkway")
    found = run(draft.build(), roads([X]))
    assert len(found.matches) == 0
    assert len(found.references) == 0


def test_references_end_at_junctions_and_corners_and_cover_everything(garching):
    line = collapse(garching.map, CollapseParams())
    ref = reference_lines(line, 5.0, 30.0)
    segments = cut(line.offset, line.xy_m, 5.0)
    assert len(ref.segments) == len(segments)
    assert ref.length_m.sum() == pytest.approx(segments.length_m.sum())
    assert (ref.segments.length_m <= 5.0 + 1e-9).all()
    inner = np.ones(len(segments), dtype=bool)
    inner[ref.offset[1:] - 1] = False
    i = np.flatnonzero(inner)
    turn = np.einsum("ij,ij->i", ref.segments.direction[i], ref.segments.direction[i + 1])
    assert (turn > np.cos(np.radians(30.0))).all()


def test_garching_is_matched_better_than_by_the_original(garching):
    found = run(garching.map, garching.roads)
    covered_once(garching.map, found.matches)
    s = match_statistics(found.references, 1.5, 0.8)
    assert s.rate >= 0.90
    assert s.rate_by_length >= 0.94
    assert s.self_scored_precision >= 0.80
    old = run(garching.map, garching.roads_2016).references
    assert match_statistics(old, 1.5, 0.8).rate < s.rate


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
    assert a.keys() == b.keys()
    assert all(a[k] == pytest.approx(b[k], abs=1e-6) for k in a)


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_ways_reversed_give_the_same_matches_the_other_way_round(garching, seed):
    expected = metres_by_way(run(garching.map, garching.roads).matches)
    rng = np.random.default_rng(seed)
    flip = {w[0]: bool(rng.integers(2)) for w in ways_of(garching.roads)}
    turned = from_ways(
        [(i, n[::-1], p[::-1], t) if flip[i] else (i, n, p, t) for i, n, p, t in ways_of(garching.roads)]
    )
    got = metres_by_way(run(garching.map, turned).matches)
    got = {(i, w, -d if flip.get(w) else d): m for (i, w, d), m in got.items()}
    assert expected.keys() == got.keys()
    assert all(expected[k] == pytest.approx(got[k], abs=1e-6) for k in expected)


def test_ways_split_give_the_same_matches(garching):
    expected = metres_by_way(run(garching.map, garching.roads).matches)
    parts, origin = [], {0: 0}
    for i, n, p, t in ways_of(garching.roads):
        at = len(n) // 2
        for k, part in enumerate((slice(0, at + 1), slice(at, None)) if at else (slice(None),)):
            parts.append((i * 2 + k, n[part], p[part], t))
            origin[i * 2 + k] = i
    merged: dict[tuple[int, int, int], float] = {}
    for (i, w, d), m in metres_by_way(run(garching.map, from_ways(parts)).matches).items():
        merged[i, origin[w], d] = merged.get((i, origin[w], d), 0.0) + m
    assert differing_metres(expected, merged) == pytest.approx(0.0, abs=1.0)


def test_nodes_densified_give_nearly_the_same_matches(garching):
    """Cuts move by up to a segment's length, and with them a few ends of matches."""
    expected = metres_by_way(run(garching.map, garching.roads).matches)
    dense = []
    for i, _, p, t in ways_of(garching.roads):
        line = np.asarray(shapely.segmentize(shapely.linestrings(p), 1.7).coords)
        dense.append((i, line, t))
    _, number = np.unique(np.concatenate([d[1] for d in dense]).round(6), axis=0, return_inverse=True)
    ends = np.cumsum([0, *(len(d[1]) for d in dense)])
    ways = [
        (i, number.ravel()[a:b], p, t) for (i, p, t), a, b in zip(dense, ends[:-1], ends[1:], strict=True)
    ]
    got = metres_by_way(run(garching.map, from_ways(ways)).matches)
    assert differing_metres(expected, got) < 0.02 * sum(expected.values())


@settings(max_examples=30, deadline=None)
@given(
    st.lists(
        st.lists(st.tuples(st.floats(-20, 120), st.floats(-15, 15)), min_size=0, max_size=8),
        max_size=6,
    )
)
def test_no_drawing_of_roads_breaks_the_cover(lines):
    built, *_ = straight()
    m = run(built, roads(lines)).matches
    covered_once(built, m)
    hit = m.decision == "match"
    assert ((m.score[hit] >= 0) & (m.score[hit] <= 1)).all()
    assert np.isfinite(m.way_s_from_m[hit]).all()


def test_lanelets_without_length_get_a_row():
    draft = MapDraft()
    two_way_road(draft, X)
    built = draft.build()
    squeezed = built.xyz_m.copy()
    squeezed[:, 0] = 5.0
    m = run(lanelet_map(built.document, squeezed), roads([X])).matches
    assert m.decision.tolist() == ["none", "none"]


@given(
    st.tuples(st.floats(-50, 50), st.floats(-50, 50)), st.floats(0.1, 5.0), st.floats(0, 6.28),
    st.floats(0.5, 6), st.floats(0, 6), st.floats(0, 1), st.floats(-12, 12), st.floats(-12, 12),
)  # fmt: skip
def test_the_buffer_is_the_twelve_gon_it_is_said_to_be(a, length, heading, width, past, corner, px, py):
    a = np.array(a)
    u = np.array([np.cos(heading), np.sin(heading)])
    v = np.array([-u[1], u[0]])
    h = 1 - corner / 2
    right = [(length, -width), (length + past * h, -width * h), (length + past, -width * (1 - corner))]
    left = [(s, -t) for s, t in right[::-1]]
    ring = [*right, *left, *((length - s, t) for s, t in [*right[::-1], *left[::-1]][::-1])]
    ring = shapely.convex_hull(shapely.multipoints([a + s * u + t * v for s, t in ring]))
    p = a + px * u + py * v
    if abs(shapely.distance(shapely.boundary(ring), shapely.points(p))) < 1e-6:
        return
    b = a + length * u
    got = inside(p[None], a[None], b[None], BufferShape(width, past, corner))
    assert bool(got[0]) is bool(shapely.contains(ring, shapely.points(p)))


def test_statistics_leave_short_references_out():
    r = References(
        np.arange(4), np.array([1.0, 10.0, 20.0, 70.0]), np.array([True, True, False, True]),
        np.array([0.9, 0.7, np.nan, 0.9]), np.full(4, 2.5), np.ones(4, dtype=np.int64),
    )  # fmt: skip
    s = match_statistics(r, 1.5, 0.8)
    assert (s.references, s.matched) == (3, 2)
    assert s.rate == pytest.approx(2 / 3)
    assert s.rate_by_length == pytest.approx(0.8)
    assert s.self_scored_precision == pytest.approx(0.5)
    assert s.mean_score == pytest.approx(0.8)
    empty = match_statistics(
        References(
            *(
                c[:0]
                for c in (r.reference, r.length_m, r.matched, r.score, r.buffer_half_width_m, r.candidates)
            )
        ),
        1.5,
        0.8,
    )
    assert empty.rate is None
    assert empty.mean_score is None
