"""Real maps for the matching tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyproj
import pytest
from scipy.interpolate import LinearNDInterpolator

from flexmap_tasks.config import OsmRoadsParams
from flexmap_tasks.ingest.lanelet_map import ingest_lanelet_map
from flexmap_tasks.ingest.osm_roads import ingest_osm_roads
from flexmap_tasks.model.maps import LaneletMap, PlacedRoads
from flexmap_tasks.model.source import Source

ORIGIN_M = (698073.91706, 5349128.20088)
"""First fix of the route in UTM 32N."""


@dataclass(frozen=True)
class Garching:
    map: LaneletMap
    roads: PlacedRoads
    roads_2016: PlacedRoads


@pytest.fixture(scope="session")
def garching(shared_data) -> Garching:
    """The route's map, moved by the published rigid motion and ten control points, and its roads.

    Built here from the published figures, so that these tests judge matching and nothing before it.
    """
    folder = shared_data / "garching"
    raw = ingest_lanelet_map(Source("map", folder / "lanelet2_route_1.osm"))
    angle = np.deg2rad(-5.609090)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    xy = raw.xyz_m[:, :2] @ rotation.T + (1.063620, -1.176658)
    pairs = np.genfromtxt(folder / "control_points_peer.csv", delimiter=",", skip_header=1)
    target, source = pairs[:, 1:3], pairs[:, 3:5]
    low, high = xy.min(axis=0) - 100, xy.max(axis=0) + 100
    corners = np.array([low, (low[0], high[1]), high, (high[0], low[1])])
    nearest = np.argmin(np.linalg.norm(corners[:, None] - source, axis=2), axis=1)
    shift = np.vstack([target - source, (target - source)[nearest]])
    moved = xy + LinearNDInterpolator(np.vstack([source, corners]), shift)(xy)
    placed = LaneletMap(raw.document, np.column_stack([moved, raw.xyz_m[:, 2]]), raw.findings)
    utm = pyproj.Transformer.from_crs(4326, 32632, always_xy=True)

    def roads(year: int) -> PlacedRoads:
        network = ingest_osm_roads(Source("roads", folder / f"osm_{year}.osm"), OsmRoadsParams())
        return PlacedRoads(network, np.column_stack(utm.transform(*network.lonlat_deg.T)) - ORIGIN_M)

    return Garching(placed, roads(2023), roads(2016))
