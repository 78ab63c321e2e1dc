import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matching_maps import MapDraft, offset_line, two_way_road, with_other_ids

from flexmap_tasks.config import CollapseParams
from flexmap_tasks.geometry.chains import chains, reciprocated
from flexmap_tasks.matching.collapse import collapse

PARAMS = CollapseParams()
X = [(float(x), 0.0) for x in range(0, 101, 20)]


def by_line(value):
    m = value.members
    return {
        int(c): [
            (int(i), int(d), int(k))
            for i, d, k in zip(
                m.lanelet_id[m.centerline == c],
                m.direction[m.centerline == c],
                m.lane[m.centerline == c],
                strict=True,
            )
        ]
        for c in np.unique(m.centerline)
    }


def test_both_directions_become_one_line_in_the_middle_of_the_road():
    draft = MapDraft()
    forward, backward = two_way_road(draft, X)
    line = collapse(draft.build(), PARAMS)
    assert by_line(line) == {0: [(backward, -1, 0), (forward, 1, 0)]}
    assert np.allclose(line.xy_m[:, 1], 0.0)
    assert np.allclose(line.xy_m[[0, -1]], [[0, 0], [100, 0]])


def test_lanes_are_counted_from_the_middle_outwards():
    draft = MapDraft()
    forward, backward = two_way_road(draft, X)
    outer = draft.lanelet(offset_line(X, -3.5), offset_line(X, -7.0))
    line = collapse(draft.build(), PARAMS)
    assert by_line(line) == {0: [(backward, -1, 0), (forward, 1, 0), (outer, 1, 1)]}
    assert np.allclose(line.xy_m[:, 1], -1.75)


def test_left_hand_traffic_mirrors_right_hand_traffic():
    draft = MapDraft()
    near = draft.lanelet(offset_line(X, 3.5), X)
    oncoming = draft.lanelet(offset_line(X, -3.5)[::-1], X[::-1])
    outer = draft.lanelet(offset_line(X, 7.0), offset_line(X, 3.5))
    built = draft.build()
    line = collapse(built, CollapseParams(driving_side="left"))
    assert by_line(line) == {0: [(outer, 1, 1), (near, 1, 0), (oncoming, -1, 0)]}
    assert len(collapse(built, PARAMS)) == 2, "on the right, lanes that share their kerb are two roads"


@pytest.mark.parametrize("subtype", ["walkway", "crosswalk", "road_shoulder", "bicycle_lane"])
def test_only_lanes_count(subtype):
    draft = MapDraft()
    two_way_road(draft, X)
    draft.lanelet(offset_line(X, -3.5), offset_line(X, -5.0), subtype)
    line = collapse(draft.build(), PARAMS)
    assert len(line) == 1
    assert len(line.members) == 2
    assert np.allclose(line.xy_m[:, 1], 0.0)


def test_lanelets_that_follow_each_other_share_a_node():
    draft = MapDraft()
    two_way_road(draft, X)
    two_way_road(draft, [(100.0, 0.0), (150.0, 0.0)])
    line = collapse(draft.build(), PARAMS)
    ends = line.offset[:-1], line.offset[1:] - 1
    assert len(line) == 2
    assert line.node[ends[1][0]] == line.node[ends[0][1]]
    assert (line.xy_m[ends[1][0]] == line.xy_m[ends[0][1]]).all()
    assert len(np.unique(line.node)) == len(line.node) - 1


@pytest.mark.parametrize(("limit_m", "same_point"), [(1.0, False), (2.0, True)])
def test_connected_ends_become_one_point_only_within_the_limit(limit_m, same_point):
    draft = MapDraft()
    two_way_road(draft, X)
    # Behind 100 m only the forward lane goes on: its middle lies 1.75 m beside the road's.
    draft.lanelet([(100.0, 0.0), (150.0, 0.0)], [(100.0, -3.5), (150.0, -3.5)])
    line = collapse(draft.build(), CollapseParams(connect_distance_m=limit_m))
    a, b = line.offset[1] - 1, line.offset[1]
    assert line.node[a] == line.node[b]
    assert bool((line.xy_m[a] == line.xy_m[b]).all()) is same_point


def test_an_empty_selection_gives_no_line():
    draft = MapDraft()
    draft.lanelet(X, offset_line(X, -2.0), "walkway")
    line = collapse(draft.build(), PARAMS)
    assert len(line) == 0
    assert len(line.members) == 0


def test_garching_collapses_like_the_original(garching):
    line = collapse(garching.map, PARAMS)
    sizes = np.bincount(np.bincount(line.members.centerline))
    assert len(line) == 233
    assert sizes.tolist() == [0, 34, 199]


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_ids_and_order_of_the_file_do_not_matter(garching, seed):
    expected = collapse(garching.map, PARAMS)
    shuffled, back = with_other_ids(garching.map, seed)
    got = collapse(shuffled, PARAMS)
    assert (got.offset == expected.offset).all()
    assert (got.xy_m == expected.xy_m).all()
    assert (got.node == expected.node).all()
    assert [back[i] for i in got.members.lanelet_id.tolist()] == expected.members.lanelet_id.tolist()
    assert (got.members.direction == expected.members.direction).all()
    assert (got.members.lane == expected.members.lane).all()


@given(st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_chains_hold_every_item_once_and_follow_the_joints(n, seed):
    rng = np.random.default_rng(seed)
    ends = rng.permutation(2 * n)
    joined = ends[: 2 * int(rng.integers(0, n + 1))]
    partner = np.full(2 * n, -1, dtype=np.int64)
    partner[joined[::2]], partner[joined[1::2]] = joined[1::2], joined[::2]
    offset, item, backwards = chains(partner)
    assert sorted(item.tolist()) == list(range(n))
    leave, enter = item * 2 + ~backwards, item * 2 + backwards
    inner = np.ones(n, dtype=bool)
    inner[offset[1:] - 1] = False
    assert (partner[leave[:-1][inner[:-1]]] == enter[1:][inner[:-1]]).all()
    # What is left open at a chain's ends is open, or closes a ring.
    first, last = enter[offset[:-1]], leave[offset[1:] - 1]
    assert ((partner[first] == -1) | (partner[first] == last)).all()


def test_a_joint_needs_both_sides():
    assert reciprocated(np.array([2, -1, 0, 0])).tolist() == [2, -1, 0, -1]
