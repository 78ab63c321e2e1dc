"""Scans of a simulated drive through the whole pipeline: every point lies where the world has it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from flexmap_tasks.alignment.pose_graph import pose_graph, pose_graph_warp
from flexmap_tasks.alignment.project import project_utm
from flexmap_tasks.config import (
    FlexMapConfig,
    GnssParams,
    PointCloudParams,
    PoseGraphParams,
    ProjectionParams,
    ScanParams,
    ScanTilesParams,
    SlamParams,
)
from flexmap_tasks.engine.execute import Outcome
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.formats.artifacts import decode
from flexmap_tasks.formats.pcd import read_pcd
from flexmap_tasks.georeferencing.cloud import warp_tile
from flexmap_tasks.ingest.gnss import ingest_gnss
from flexmap_tasks.ingest.scans import ingest_scans
from flexmap_tasks.ingest.slam import ingest_slam
from flexmap_tasks.model.clouds import PointCloud
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.source import Source
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.simulate.generate import Simulation, simulate
from flexmap_tasks.simulate.scans import make_scans
from flexmap_tasks.simulate.truth import stamps_ns
from flexmap_tasks.simulate.world import World
from flexmap_tasks.simulate.write import write_world
from flexmap_tasks.store.store import ArtifactFiles, Store

WORLD = World().changed(
    network={"blocks_x": 2, "blocks_y": 1},
    drive={"length_m": 250, "stops_per_km": 4},
    cloud={"points": 100, "scans": True, "scan_rate_hz": 2.0, "scan_points": 1500},
)


class Truth(NamedTuple):
    """Where every measured point was, by the moment it was seen (stamp, time in the sweep, ring)."""

    moment: np.ndarray
    town_m: np.ndarray


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("town")
    write_world(WORLD, folder)
    return folder


@pytest.fixture(scope="module")
def world() -> Simulation:
    return simulate(WORLD)


@pytest.fixture(scope="module")
def truth(world: Simulation) -> Truth:
    return truth_of(world)


def truth_of(world: Simulation) -> Truth:
    """The measured points placed by the true poses at their own time."""
    places, moments = [], []
    for begin, points in make_scans(world.world, world.network, sorted(world.hd_map.roads), world.drive):
        at, yaw, pitch, _ = world.drive.at(begin + points["time"].astype(float))
        turn = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, np.zeros(len(yaw))]))
        places.append(at + turn.apply(np.column_stack([points[a] for a in "xyz"])))
        stamp = stamps_ns(world.world, np.array([begin]))[0] * 1e-9
        moments.append(np.column_stack([stamp + points["time"], points["time"], points["ring"]]))
    moment, town_m = np.concatenate(moments), np.concatenate(places)
    first, last = world.slam.time_s[[0, -1]] + world.world.drive.start_ns * 1e-9
    seen = (moment[:, 0] >= first - 1e-6) & (moment[:, 0] <= last + 1e-6)
    rows = np.flatnonzero(seen)[_order(*moment[seen].T)]
    return Truth(moment[rows], town_m[rows])


def _order(stamp_s: np.ndarray, time: np.ndarray, ring: np.ndarray) -> np.ndarray:
    return np.lexsort((ring, time, np.round(stamp_s - time.astype(float), 3)))


def whole(clouds: list[PointCloud]) -> PointCloud:
    """All points in the order they were seen."""
    names = list(clouds[0].fields)
    fields = {n: np.concatenate([c.fields[n] for c in clouds]) for n in names}
    cloud = PointCloud(np.concatenate([c.xyz_m for c in clouds]), fields)
    return cloud.take(_order(fields["stamp_s"], fields["time"], fields["ring"]))


def released(store: Store, outcomes: Mapping[str, Outcome]) -> PointCloud:
    files = ArtifactFiles(store, outcomes["merge_tile"].artifact)
    return whole([read_pcd(Source(name, files.local(name))) for name in files.names()])


def rmse(offset_m: np.ndarray) -> float:
    return float(np.sqrt((offset_m**2).sum(axis=1).mean()))


def test_a_georeferenced_cloud_of_scans_lies_where_the_world_does(
    town: Path, world: Simulation, truth: Truth, tmp_path: Path
) -> None:
    recording = {"file": town / "recording.mcap"}
    config = FlexMapConfig.model_validate(
        {"map": "town", "gnss": recording, "slam": recording, "point_cloud": recording,
         "evaluation": {"held_out_block_m": 0}}
    )  # fmt: skip
    store = Store.open(tmp_path / "store")
    outcomes = run_local(store, map_update(config))
    cloud = released(store, outcomes)
    assert outcomes["projector_file"].artifact.names() == ["map_projector_info.yaml"]
    assert list(cloud.fields) == ["intensity", "ring", "time", "stamp_s"]
    np.testing.assert_allclose(cloud.fields["stamp_s"], truth.moment[:, 0], atol=2e-6)
    np.testing.assert_array_equal(cloud.fields["ring"], truth.moment[:, 2])
    files = ArtifactFiles(store, outcomes["project_utm"].artifact.field("projected", "projection"))
    projection: Projection = decode(Projection, files, "projection")
    geodetic = world.frame.geodetic(truth.town_m)
    expected_m = np.column_stack([projection.to_xy_m(geodetic[:, :2]), geodetic[:, 2]])
    assert rmse(cloud.xyz_m[:, :2] - expected_m[:, :2]) < 0.08
    assert rmse(cloud.xyz_m[:, 2:] - expected_m[:, 2:]) < 0.10


def test_the_motion_during_a_sweep_is_undone(town: Path, world: Simulation, truth: Truth) -> None:
    source = Source("recording.mcap", town / "recording.mcap")
    slam = ingest_slam(source, SlamParams())
    expected_m, errors = world.slam.to_slam(truth.town_m), {}
    for point_time in ("auto", "none"):
        params = ScanTilesParams(
            tiles=PointCloudParams(), scans=ScanParams(point_time=point_time), poses=SlamParams()
        )
        tiles = ingest_scans(source, slam, source, params)
        assert tiles.findings.code.tolist()[0] == "cloud-of-scans"
        clouds = list(tiles.tiles.values())
        if point_time == "none":  # all points of a sweep have its stamp
            for cloud in clouds:
                cloud.fields["stamp_s"] += cloud.fields["time"].astype(float)
        cloud = whole(clouds)
        assert len(cloud) == len(expected_m)
        errors[point_time] = rmse(cloud.xyz_m - expected_m)
    assert errors["auto"] < 0.08
    assert errors["none"] > 10 * errors["auto"]


def test_every_pass_is_corrected_as_its_own_poses_were(tmp_path: Path) -> None:
    """A SLAM that does not close its loops sees one street twice, some decimetres apart; by place the two are mixed."""
    world_ = WORLD.changed(
        drive={"length_m": 900},
        slam={"loop_closure": "none"},
        cloud={"scan_rate_hz": 0.5, "scan_points": 500},
    )
    write_world(world_, tmp_path)
    town_, source = simulate(world_), Source("recording.mcap", tmp_path / "recording.mcap")
    slam = ingest_slam(source, SlamParams())
    projected = project_utm(ingest_gnss(source, GnssParams()), ProjectionParams())
    adjusted = pose_graph(slam, projected.gnss_track, projected.projection, None, None, PoseGraphParams())
    warp = pose_graph_warp(adjusted, PoseGraphParams(), slam)
    params = ScanTilesParams(tiles=PointCloudParams(), scans=ScanParams(), poses=SlamParams())
    tiles = ingest_scans(source, slam, source, params).tiles
    by_time = whole([p for t in tiles.values() for p in warp_tile(t, warp, None, params.tiles).values()])
    by_place = warp.apply(whole(list(tiles.values())).xyz_m)
    truth_ = truth_of(town_)
    geodetic = town_.frame.geodetic(truth_.town_m)
    expected_m = np.column_stack([projected.projection.to_xy_m(geodetic[:, :2]), geodetic[:, 2]])
    assert rmse(by_time.xyz_m[:, :2] - expected_m[:, :2]) < 0.12
    assert rmse(by_time.xyz_m[:, 2:] - expected_m[:, 2:]) < 0.2
    assert rmse(by_place[:, :2] - expected_m[:, :2]) > 2 * rmse(by_time.xyz_m[:, :2] - expected_m[:, :2])
