"""The truth is true: what is written can be taken back to it by other means."""

from __future__ import annotations

from itertools import pairwise

import lanelet2
import numpy as np
import pytest
import shapely

from flexmap_tasks.formats.osm_xml_write import write_osm_xml
from flexmap_tasks.geometry.utm import grid_factors, height_factor, to_utm
from flexmap_tasks.simulate.generate import simulate
from flexmap_tasks.simulate.truth_matches import match_tables
from flexmap_tasks.simulate.truth_roads import change_table, lane_table, way_table


def locals_of(simulation):
    tags = simulation.hd_map.document.nodes.tags
    return np.column_stack([tags.column(k).astype(float) for k in ("local_x", "local_y", "ele")])


def rigid(source, target):
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    u, _, v = np.linalg.svd(a.T @ b)
    turn = (u @ v).T
    assert np.linalg.det(turn) > 0
    return lambda xy: (xy - source.mean(axis=0)) @ turn.T + target.mean(axis=0)


def test_without_noise_a_rigid_motion_and_the_grid_scale_explain_everything(exact):
    fixes = exact.frame.geodetic(exact.gnss.antenna_m + exact.gnss.error_m)
    epsg = exact.frame.epsg
    scale = grid_factors(fixes[0, 0], fixes[0, 1], epsg)[1] * height_factor(fixes[0, 2])
    truth = to_utm(exact.frame.geodetic(exact.slam.true_xyz_m)[:, :2], epsg)
    motion = rigid(exact.slam.xyz_m[:, :2] * scale, truth)
    assert np.abs(motion(exact.slam.xyz_m[:, :2] * scale) - truth).max() < 1e-3
    nodes = to_utm(exact.frame.geodetic(exact.hd_map.town_xyz_m)[:, :2], epsg)
    assert np.abs(motion(locals_of(exact)[:, :2] * scale) - nodes).max() < 1e-3


def test_the_fixes_without_noise_lie_on_the_true_path(exact):
    path = shapely.LineString(exact.drive.xyz_m[:, :2])
    at = shapely.points(exact.gnss.antenna_m[:, :2] + exact.gnss.error_m[:, :2])
    assert shapely.distance(path, at).max() < 1e-3


def test_undoing_the_drift_leads_from_the_map_to_the_truth_of_its_nodes(noisy):
    back = noisy.slam.to_town(locals_of(noisy))
    assert np.abs(back - noisy.hd_map.town_xyz_m).max() < 1e-3


def test_the_map_drifts_with_the_track(noisy):
    """In a loop-closed map the vehicle's pose lies where its lane is drawn, up to SLAM's own noise."""
    if noisy.world.slam.loop_closure != "smoothed":
        pytest.skip("a map with jumps or open loops does not agree with itself")
    off = noisy.slam.to_town(noisy.slam.xyz_m) - noisy.slam.true_xyz_m
    assert np.sqrt((off[:, :2] ** 2).sum(axis=1).mean()) < 0.06


def test_the_drift_is_more_than_a_rigid_motion(noisy):
    motion = rigid(noisy.slam.xyz_m[:, :2], noisy.slam.true_xyz_m[:, :2])
    off = motion(noisy.slam.xyz_m[:, :2]) - noisy.slam.true_xyz_m[:, :2]
    assert 0.1 < np.sqrt((off**2).sum(axis=1).mean()) < 10.0


@pytest.fixture
def loaded(noisy, tmp_path):
    path = tmp_path / "map.osm"
    path.write_bytes(write_osm_xml(noisy.hd_map.document))
    projector = lanelet2.projection.UtmProjector(lanelet2.io.Origin(47.85, 10.336))
    return noisy, *lanelet2.io.loadRobust(str(path), projector)


def test_lanelet2_loads_the_map_and_drives_the_route_through_it(loaded):
    simulation, lanelet_map, errors = loaded
    assert not list(errors)
    rules = lanelet2.traffic_rules.create(
        lanelet2.traffic_rules.Locations.Germany, lanelet2.traffic_rules.Participants.Vehicle
    )
    graph = lanelet2.routing.RoutingGraph(lanelet_map, rules)
    assert not list(graph.checkValidity(False))
    driven = []
    for strip in simulation.drive.strips:
        pieces = [d for d in simulation.hd_map.lanelets if d.strip == strip]
        driven += [d.id for d in sorted(pieces, key=lambda d: d.first)]
    layer = lanelet_map.laneletLayer
    broken = [
        (a, b) for a, b in pairwise(driven)
        if b not in {f.id for f in graph.following(layer[a])}
    ]  # fmt: skip
    assert not broken[:5]


def test_lanelet2_sees_every_bound_on_its_side_and_every_lane_wide_enough(loaded):
    simulation, lanelet_map, _ = loaded
    for drawn in simulation.hd_map.lanelets:
        lanelet = lanelet_map.laneletLayer[drawn.id]
        assert lanelet.leftBound.id == drawn.left_way
        assert lanelet.rightBound.id == drawn.right_way
        if drawn.kind != "lane":
            continue
        left = shapely.LineString([(p.x, p.y) for p in lanelet.leftBound])
        right = np.array([(p.x, p.y) for p in lanelet.rightBound])
        assert shapely.distance(left, shapely.points(right)).min() > 2.0
        line = np.array([(p.x, p.y) for p in lanelet.leftBound])
        ahead = line[1] - line[0]
        across = right[0] - line[0]
        assert ahead[0] * across[1] - ahead[1] * across[0] < 0, "the right bound lies to the right"


def geometry_of_ways(simulation):
    document = simulation.osm.document
    xy = simulation.frame.local(document.nodes.lonlat_deg)
    row = {int(i): k for k, i in enumerate(document.nodes.id)}
    ways = document.ways
    return {
        int(way): shapely.LineString([xy[row[int(r)]] for r in ways.ref[a:b]])
        for way, a, b in zip(ways.id, ways.offset[:-1], ways.offset[1:], strict=True)
    }


def centrelines(simulation):
    lanes = simulation.lanes
    return {
        d.id: shapely.LineString(lanes.centreline(lanes.strips[d.strip])[d.first : d.last + 1, :2])
        for d in simulation.hd_map.lanelets
        if d.strip >= 0
    }


def test_matches_cover_every_lane_once(noisy):
    matches, _ = match_tables(noisy.lanes, noisy.hd_map, noisy.osm)
    wanted = {d.id for d in noisy.hd_map.lanelets if d.kind in ("lane", "bus", "turn", "fragment")}
    assert set(matches["lanelet_id"].tolist()) == wanted
    length = np.zeros(max(wanted) + 1)
    np.add.at(length, matches["lanelet_id"], matches["s_to_m"] - matches["s_from_m"])
    assert np.allclose(length[matches["lanelet_id"]], matches["lanelet_length_m"], atol=1e-6)
    assert (matches["s_to_m"] > matches["s_from_m"]).all()
    assert set(matches["class"]) <= {"link", "junction", "stub", "none"}
    none = matches["class"] == "none"
    assert (matches["way_id"][none] == 0).all()
    assert (matches["way_id"][~none] > 0).all()
    assert all(matches["reason"][none])


def test_without_noise_the_matched_way_runs_beside_the_lane_in_the_direction_that_is_said(exact):
    """Judged by geometry alone: places at equal share of the piece, and the headings there."""
    ways, lines = geometry_of_ways(exact), centrelines(exact)
    matches, _ = match_tables(exact.lanes, exact.hd_map, exact.osm)
    roads = exact.network.roads
    links = np.flatnonzero(np.isin(matches["class"], ["link", "stub"]))
    assert len(links) > 40
    for k in links:
        line, way = lines[int(matches["lanelet_id"][k])], ways[int(matches["way_id"][k])]
        forward = matches["direction"][k] > 0
        for share in (0.05, 0.5, 0.95):
            s = matches["s_from_m"][k] + share * (matches["s_to_m"][k] - matches["s_from_m"][k])
            along = share if forward else 1 - share
            w = matches["way_s_from_m"][k] + along * (matches["way_s_to_m"][k] - matches["way_s_from_m"][k])
            step = 0.2 if forward else -0.2
            here, there = line.interpolate(s), way.interpolate(w)
            assert here.distance(there) < roads[int(matches["road"][k])].width_m / 2 + 1.5
            a = np.array(line.interpolate(s + 0.2).coords[0]) - np.array(here.coords[0])
            b = np.array(way.interpolate(max(w + step, 0.0)).coords[0]) - np.array(there.coords[0])
            if np.hypot(*a) > 0.1 and np.hypot(*b) > 0.1:
                assert a @ b / (np.hypot(*a) * np.hypot(*b)) > 0.8


def test_without_noise_osm_offers_the_true_values(exact):
    _, tags = match_tables(exact.lanes, exact.hd_map, exact.osm)
    assert (tags["value"] == tags["osm_value"]).all()
    speeds = set(tags["value"][tags["key"] == "speed_limit"])
    assert len(speeds) > 1
    assert all(v.isdecimal() for v in speeds)


def test_omitted_and_wrong_tags_and_missing_roads_are_in_the_truth(small_town):
    bad = simulate(small_town.changed(osm={"omit_share": 0.3, "wrong_share": 0.3, "missing_share": 0.3}))
    matches, tags = match_tables(bad.lanes, bad.hd_map, bad.osm)
    assert "missing_in_osm" in set(matches["reason"])
    known = tags["way_id"] > 0
    assert ((tags["osm_value"] == "") & known & (tags["key"] == "road_name")).any()
    wrong = (tags["osm_value"] != tags["value"]) & (tags["osm_value"] != "") & (tags["key"] == "speed_limit")
    assert wrong.any()
    document = bad.osm.document.ways
    said = dict(zip(document.id.tolist(), document.tags.column("maxspeed"), strict=True))
    rows = np.flatnonzero(known & (tags["key"] == "speed_limit"))
    assert all((said[int(tags["way_id"][k])] or "") == tags["osm_value"][k] for k in rows)


def test_lane_counts_are_those_of_the_roads(exact):
    table = lane_table(exact.lanes, exact.hd_map, exact.osm)
    drawn = exact.world.hd_map.missing_lane_share == 0
    assert drawn
    assert (table["lanes_osm"] == table["lanes_forward"] + table["lanes_backward"]).all()
    assert (table["lanes_drawn"] == table["lanes_osm"]).all()


def test_the_table_of_ways_covers_every_way_and_says_what_is_drawn(noisy):
    table = way_table(noisy.lanes, noisy.hd_map, noisy.osm)
    document = noisy.osm.document.ways
    assert set(table["way_id"].tolist()) == set(document.id.tolist())
    matches, _ = match_tables(noisy.lanes, noisy.hd_map, noisy.osm)
    matched = set(matches["way_id"][matches["class"] == "link"].tolist())
    assert matched <= set(table["way_id"][table["drawn"]].tolist())
    assert (~table["drawn"]).any()


def test_the_later_extract_differs_as_the_truth_says(small_town):
    town = simulate(small_town.changed(osm={"later_date": True, "changed_share": 0.2, "missing_share": 0.1}))
    before, after = town.osm.document.ways, town.osm_later.document.ways
    changes = change_table(town.osm_later)
    kinds = dict.fromkeys(("new", "gone", "tag", "geometry"), frozenset())
    for kind in kinds:
        kinds[kind] = set(changes["way_id"][changes["kind"] == kind].tolist())
        assert kinds[kind], kind
    assert set(after.id.tolist()) - set(before.id.tolist()) == kinds["new"]
    assert set(before.id.tolist()) - set(after.id.tolist()) == kinds["gone"]
    tags = [{int(i): d.tags.of_element(k) for k, i in enumerate(d.id)} for d in (before, after)]
    both = tags[0].keys() & tags[1].keys()
    assert {i for i in both if tags[0][i] != tags[1][i]} == kinds["tag"]
    nodes = [
        dict(zip(d.nodes.id.tolist(), map(tuple, d.nodes.lonlat_deg), strict=True))
        for d in (town.osm.document, town.osm_later.document)
    ]
    moved = {i for i in nodes[0].keys() & nodes[1].keys() if nodes[0][i] != nodes[1][i]}
    bent = {
        int(i)
        for k, i in enumerate(after.id)
        if moved & set(after.ref[after.offset[k] : after.offset[k + 1]].tolist())
    }
    assert bent == kinds["geometry"]
