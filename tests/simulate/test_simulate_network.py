"""Towns have what the settings ask for, and lanes that fit together."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from flexmap_tasks.errors import ConfigError
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.drive import make_drive
from flexmap_tasks.simulate.generate import simulate
from flexmap_tasks.simulate.lanes import make_lanes
from flexmap_tasks.simulate.network import make_network
from flexmap_tasks.simulate.roads import Network
from flexmap_tasks.simulate.world import World

GRID = {"layout": "grid", "blocks_x": 4, "blocks_y": 4}
ROLES = {
    "roundabouts": "roundabout", "islands": "island", "dual_carriageways": "dual", "slip_lanes": "slip",
    "frontage_roads": "frontage", "overpasses": "overpass", "cul_de_sacs": "cul_de_sac",
    "parking_aisles": "parking_aisle",
}  # fmt: skip


@pytest.mark.parametrize("feature", sorted(ROLES))
def test_each_feature_is_built_as_often_as_asked(feature):
    town = make_network(World(network={**GRID, feature: 2}))
    found = [r for r in town.roads if r.role == ROLES[feature]]
    if feature in ("islands", "dual_carriageways"):
        assert len({r.pair for r in found}) == 2
        assert all(r.backward == 0 for r in found)
    elif feature == "roundabouts":
        assert len({r.start for r in found}) == len(found) >= 6, "rings of one-way arcs"
    else:
        assert len(found) == 2


def test_other_features():
    town = make_network(World(network={**GRID, "one_way_pairs": 1, "living_streets": 2, "bus_lanes": 1,
                                       "bicycle_lanes": 2, "signals": 2, "crosswalks": 1, "tag_changes": 3}))  # fmt: skip
    assert sum(r.backward == 0 for r in town.roads) >= 4
    assert sum(r.highway == "living_street" for r in town.roads) == 2
    assert sum(r.bus for r in town.roads) == 1
    assert sum(r.bicycle for r in town.roads) == 2
    assert sum(bool(r.changes) for r in town.roads) == 3
    assert len(town.signal_nodes) == 2
    assert len(town.crosswalk_nodes) == 1


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    layout=st.sampled_from(["grid", "radial", "organic", "motorway"]),
    side=st.sampled_from(["right", "left"]),
)
def test_every_town_has_lanes_that_fit_together(seed, layout, side):
    plan = {"layout": layout, "blocks_x": 3, "blocks_y": 3, "block_m": 140.0, "roundabouts": 2, "islands": 1,
            "slip_lanes": 1, "dual_carriageways": 1, "overpasses": 1, "cul_de_sacs": 1}  # fmt: skip
    world = World(seed=seed, driving_side=side, network=plan)
    lanes = make_lanes(make_network(world), 5.0, shoulders=False)
    for k, strip in enumerate(lanes.strips):
        assert len(strip.left) == len(strip.right) >= 2
        assert np.isfinite(lanes.xyz[strip.left]).all()
        for other in lanes.followers[k]:
            after = lanes.strips[other]
            assert after.left[0] == strip.left[-1]
            assert after.right[0] == strip.right[-1]
    for road, rows in lanes.road_strips.items():
        line = lanes.network.roads[road]
        cut = lines.cut(line.xyz, lanes.trims[road, False], line.length_m - lanes.trims[road, True])
        middle = shapely.LineString(cut[:, :2])
        for k in rows:
            strip = lanes.strips[k]
            ahead = lanes.centreline(strip)
            there = ahead[len(ahead) // 2, :2]
            on_line = np.array(middle.interpolate(middle.project(shapely.Point(there))).coords[0])
            along = lines.tangents(ahead)[len(ahead) // 2]
            to_left = along[0] * (there - on_line)[1] - along[1] * (there - on_line)[0]
            if line.backward and line.forward == line.backward:
                assert to_left * lanes.network.side < 0, "lanes keep to their side of a two-way road"


def test_bridges_clear_the_roads_below():
    town = make_network(World(network={**GRID, "overpasses": 2, "relief_m": 3.0}))
    for bridge in (r for r in town.roads if r.level):
        crossed = 0
        for other in (r for r in town.roads if r.role == "underpass"):
            here = shapely.LineString(bridge.xyz[:, :2]).intersection(shapely.LineString(other.xyz[:, :2]))
            if here.geom_type == "Point":
                crossed += 1
                above, below = (
                    np.interp(shapely.LineString(r.xyz[:, :2]).project(here), lines.along(r.xyz), r.xyz[:, 2])
                    for r in (bridge, other)
                )
                assert above - below > 4.5
        assert crossed == 1


def test_motorways_have_ramps_and_a_drive_that_uses_them():
    town = simulate(World(network={"layout": "motorway", "blocks_x": 2, "blocks_y": 1, "main_lanes": 2}))
    roads = town.network.roads
    assert sum(r.role == "ramp" for r in roads) == 8
    driven = {town.lanes.strips[k].road for k in town.drive.strips}
    assert any(roads[i].role == "ramp" for i in driven)


def test_a_town_without_a_loop_is_refused():
    world = World(network={"layout": "grid", "blocks_x": 3, "blocks_y": 3})
    network = make_network(world)
    one = Network(network.node_xyz, network.roads[:1], 1)
    with pytest.raises(ConfigError, match="no loop"):
        make_drive(world, make_lanes(one, 5.0, shoulders=False))


def test_settings_are_strict():
    with pytest.raises(ValidationError, match="Extra inputs"):
        World(network={"blocks": 3})
    with pytest.raises(ValidationError, match="topology_file"):
        World(network={"layout": "osm"})
    with pytest.raises(ValidationError):
        World(gnss={"rate_hz": float("nan")})
