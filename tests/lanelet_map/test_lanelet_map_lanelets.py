"""Lanelets of a map, against the lanelet2 library and against laws."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from flexmap_tasks.geometry import lanelets as kernels
from flexmap_tasks.ingest.lanelet_map import ingest_lanelet_map
from flexmap_tasks.model import lanelets as model
from flexmap_tasks.model.maps import LaneletMap
from flexmap_tasks.model.source import Source

MAPS = ("garching/lanelet2_route_1.osm", "lanelet2/mapping_example.osm", "lanelet2/sample_map_planning.osm")


@pytest.fixture(scope="module", params=MAPS)
def both(request: pytest.FixtureRequest, shared_data: Path) -> tuple[LaneletMap, Any]:
    """A map as we read it and as the lanelet2 library does."""
    lanelet2 = pytest.importorskip("lanelet2", reason="the lanelet2 wheel is not installed")
    path = shared_data / request.param
    ours = ingest_lanelet_map(Source(request.param, path))
    lon, lat = ours.document.nodes.lonlat_deg[0]
    theirs, _ = lanelet2.io.loadRobust(
        str(path), lanelet2.projection.UtmProjector(lanelet2.io.Origin(lat, lon))
    )
    return ours, theirs


def test_bounds_are_turned_as_the_library_turns_them(both: tuple[LaneletMap, Any]) -> None:
    ours, theirs = both
    lanelets, ways = model.lanelets_of(ours), ours.document.ways
    found = {
        row[0]: row[1:]
        for row in zip(
            lanelets.id.tolist(), ways.id[lanelets.left_way].tolist(), ways.id[lanelets.right_way].tolist(),
            lanelets.left_inverted.tolist(), lanelets.right_inverted.tolist(), strict=True,
        )
    }  # fmt: skip
    wanted = {
        ll.id: (ll.leftBound.id, ll.rightBound.id, ll.leftBound.inverted(), ll.rightBound.inverted())
        for ll in theirs.laneletLayer
    }
    assert found == wanted


def test_one_way_as_the_rules_say(both: tuple[LaneletMap, Any]) -> None:
    lanelet2 = pytest.importorskip("lanelet2")
    ours, theirs = both
    locations, participants = lanelet2.traffic_rules.Locations, lanelet2.traffic_rules.Participants
    rules = lanelet2.traffic_rules.create(locations.Germany, participants.Vehicle)
    lanelets = model.lanelets_of(ours)
    found = dict(zip(lanelets.id.tolist(), lanelets.one_way.tolist(), strict=True))
    assert found == {ll.id: rules.isOneWay(ll) for ll in theirs.laneletLayer}


def test_who_follows_and_who_lies_beside(both: tuple[LaneletMap, Any]) -> None:
    lanelet2 = pytest.importorskip("lanelet2")
    ours, theirs = both
    lanelets = model.lanelets_of(ours)
    ids, geometry = lanelets.id, lanelet2.geometry
    everything = list(theirs.laneletLayer)
    pairs = {(int(ids[a]), int(ids[b])) for a, b in model.follow_pairs(ours, lanelets)}
    assert pairs == {(a.id, b.id) for a in everything for b in everything if geometry.follows(a, b)}
    beside = model.adjacency(lanelets)
    for same in (True, False):
        rows = beside.on_left & (beside.same_direction == same)
        found = {
            (int(ids[a]), int(ids[b]))
            for a, b in zip(beside.lanelet[rows], beside.neighbour[rows], strict=True)
        }
        wanted = {
            (a.id, b.id)
            for a in everything
            for b in everything
            if a.id != b.id and geometry.leftOf(b if same else b.invert(), a)
        }
        assert found == wanted


def test_centrelines_run_in_the_middle(both: tuple[LaneletMap, Any]) -> None:
    ours, theirs = both
    lanelets = model.lanelets_of(ours)
    lines = model.centrelines(ours, lanelets)
    assert len(lines) == len(lanelets)
    ends = ours.xyz_m[model.end_nodes(ours, lanelets)]
    first, last = lines.xyz_m[lines.offset[:-1]], lines.xyz_m[lines.offset[1:] - 1]
    np.testing.assert_allclose(first, (ends[:, 0] + ends[:, 1]) / 2)
    np.testing.assert_allclose(last, (ends[:, 2] + ends[:, 3]) / 2)
    ours_m = model.lengths_m(lines)
    ratio = [
        shapely.LineString([(p.x, p.y) for p in theirs.laneletLayer[int(i)].centerline]).length
        for i in lanelets.id
    ] / ours_m
    assert 0.97 < np.median(ratio) < 1.03


def test_order_of_lanelets_changes_no_bit(both: tuple[LaneletMap, Any]) -> None:
    ours, _ = both
    lanelets = model.lanelets_of(ours)
    left, right = (model.bound_polylines(ours, lanelets, side) for side in ("left", "right"))
    whole = model.centrelines(ours, lanelets)
    for i in (0, len(lanelets) // 2, len(lanelets) - 1):
        pieces = [p.xyz_m[p.offset[i] : p.offset[i + 1]] for p in (left, right)]
        _, alone = kernels.centrelines(
            np.array([0, len(pieces[0])]), pieces[0], np.array([0, len(pieces[1])]), pieces[1]
        )
        assert np.array_equal(alone, whole.xyz_m[whole.offset[i] : whole.offset[i + 1]])


LINE = arrays(np.float64, st.tuples(st.integers(2, 6), st.just(3)), elements=st.integers(-50, 50).map(float))


@given(st.lists(st.tuples(LINE, LINE), min_size=1, max_size=4))
@settings(deadline=None)
def test_centreline_of_any_two_bounds(bounds: list[tuple[np.ndarray, np.ndarray]]) -> None:
    sides = [[b[i] for b in bounds] for i in (0, 1)]
    offset = [kernels.offsets(np.array([len(x) for x in side])) for side in sides]
    out, xyz = kernels.centrelines(offset[0], np.concatenate(sides[0]), offset[1], np.concatenate(sides[1]))
    assert np.isfinite(xyz).all()
    for i, (left, right) in enumerate(bounds):
        line = xyz[out[i] : out[i + 1]]
        assert 2 <= len(line) <= len(left) + len(right) - 2
        np.testing.assert_allclose(line[0], (left[0] + right[0]) / 2)
        np.testing.assert_allclose(line[-1], (left[-1] + right[-1]) / 2)


@given(LINE, st.floats(-3, 3), st.floats(-60, 60), st.floats(-60, 60))
def test_sides_turn_with_the_line(line: np.ndarray, turn: float, x: float, y: float) -> None:
    line, point = line * [1, 1, 0], np.array([[x, y, 0.0]])
    ends = np.array([0, len(line)])
    mirrored = [1.0, -1.0, 1.0]
    a, b = kernels.sides(ends, line, point)[0], kernels.sides(ends, line * mirrored, point * mirrored)[0]
    straight = len(np.unique(line[:, :2], axis=0)) == len(line) == 2
    if straight:
        run, to = line[1] - line[0], point[0] - line[0]
        cross = run[0] * to[1] - run[1] * to[0]
        if abs(cross) > 1e-6:
            assert a == np.sign(cross)
            assert b == -a
    if a == 0:
        assert b == 0
