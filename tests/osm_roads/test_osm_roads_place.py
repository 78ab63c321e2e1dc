"""Roads in the map frame, and extracts of the wrong place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyproj
import pytest

from flexmap_tasks.config import OsmRoadsParams
from flexmap_tasks.errors import CoverageError
from flexmap_tasks.ingest.osm_roads import ingest_osm_roads
from flexmap_tasks.matching.place_roads import place_roads
from flexmap_tasks.model.alignment import RigidMotion, Warp
from flexmap_tasks.model.arrays import Floats, strings
from flexmap_tasks.model.maps import RoadNetwork
from flexmap_tasks.model.osm import Tags
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import GnssTrack

ORIGIN = Projection.at(11.669, 48.264)


def network(*lines: list[tuple[float, float]]) -> RoadNetwork:
    sizes = [len(line) for line in lines]
    n = len(lines)
    return RoadNetwork(
        np.arange(1, n + 1), np.ones(n, np.int64), strings([""] * n),
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64), np.arange(sum(sizes)),
        np.array([p for line in lines for p in line], dtype=float).reshape(-1, 2), Tags.of([{}] * n),
    )  # fmt: skip


def track(xy_m: Floats) -> GnssTrack:
    n = len(xy_m)
    return GnssTrack(
        np.column_stack([xy_m, np.zeros(n)]), np.full((n, 3), np.nan), np.zeros(n, np.int64),
        np.arange(n), np.ones(n, dtype=bool), None,
    )  # fmt: skip


STREET = network([(11.668, 48.264), (11.672, 48.264)])
DRIVE = track(np.column_stack([np.linspace(0, 200, 50), np.zeros(50)]))


def test_metres_from_the_origin() -> None:
    placed = place_roads(STREET, ORIGIN, DRIVE, None)
    to_utm = pyproj.Transformer.from_crs(4326, 32632, always_xy=True)
    easting, northing = to_utm.transform(*STREET.lonlat_deg.T)
    expected = np.column_stack([easting - ORIGIN.origin_easting_m, northing - ORIGIN.origin_northing_m])
    assert np.abs(placed.xy_m - expected).max() < 1e-6
    assert placed.network is STREET


def test_a_warp_is_undone() -> None:
    turn = 0.3
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    warp = Warp(RigidMotion(rotation, np.array([5.0, -7.0]), 1.001, 1.0, 0.0), None)
    placed = place_roads(STREET, ORIGIN, DRIVE, warp)
    back = warp.apply(np.column_stack([placed.xy_m, np.zeros(2)]))[:, :2]
    assert np.abs(back - place_roads(STREET, ORIGIN, DRIVE, None).xy_m).max() < 1e-9


@pytest.mark.parametrize(
    "roads",
    [
        network([(10.0, 48.264), (10.01, 48.264)]),
        network([(48.264, 11.669), (48.264, 11.67)]),
        network([(-170.0, -80.0), (-170.1, -80.0)]),
        network([(11.669, 48.27), (11.675, 48.27)]),
    ],
)
def test_roads_of_another_place_are_refused_with_both_boxes(roads: RoadNetwork) -> None:
    with pytest.raises(CoverageError) as caught:
        place_roads(roads, ORIGIN, DRIVE, None)
    assert "lat" in str(caught.value)
    assert f"lon {roads.lonlat_deg[:, 0].min():.4f}" in str(caught.value)


def test_an_extract_without_roads_is_refused() -> None:
    with pytest.raises(CoverageError, match="no road"):
        place_roads(network(), ORIGIN, DRIVE, None)


def test_half_of_the_track_is_the_limit_however_long_the_vehicle_stood() -> None:
    far = np.column_stack([np.linspace(0, 200, 50), np.full(50, 500.0)])
    standing = np.tile([[0.0, 500.0]], (5000, 1))
    assert (
        len(place_roads(STREET, ORIGIN, track(np.concatenate([DRIVE.xyz_m[:, :2], standing])), None).xy_m)
        == 2
    )
    with pytest.raises(CoverageError, match="does not cover"):
        place_roads(STREET, ORIGIN, track(np.concatenate([DRIVE.xyz_m[:20, :2], far])), None)


def test_garching_is_where_garching_is(shared_data: Path) -> None:
    path = shared_data / "garching/osm_2023.osm"
    roads = ingest_osm_roads(Source(path.name, path), OsmRoadsParams())
    fixes = np.loadtxt(shared_data / "garching/route_1_GPS.txt", usecols=(0, 1))
    here = Projection.at(float(fixes[0, 1]), float(fixes[0, 0]))
    driven = track(here.to_xy_m(np.ascontiguousarray(fixes[:, ::-1])))
    assert place_roads(roads, here, driven, None).xy_m.shape == (len(roads.node_id), 2)
    town = shared_data / "osm/liechtenstein.osm.pbf"
    with pytest.raises(CoverageError, match="0% of it"):
        place_roads(ingest_osm_roads(Source(town.name, town), OsmRoadsParams()), here, driven, None)
