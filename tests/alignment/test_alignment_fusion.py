"""Several drives through one area: where one had no GNSS another takes over, and a wrong one is left out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from flexmap_tasks.alignment.align_drive import align_drive
from flexmap_tasks.alignment.fuse_drives import fuse_drives
from flexmap_tasks.alignment.pose_graph import pose_graph, pose_graph_warp
from flexmap_tasks.config import PoseGraphParams
from flexmap_tasks.geometry.se2 import rotated
from flexmap_tasks.model.fusion import AlignedDrive
from flexmap_tasks.model.pose_graph import PoseGraph
from flexmap_tasks.model.tracks import GnssFixes, GnssTrack, Trajectory
from tests import drives
from tests.drives import rmse

PARAMS = PoseGraphParams()
LENGTH_M, SEED, OUTAGE_M = 1800.0, 5, (800.0, 1100.0)
DRIFTING = drives.Noise(place_m=0.03, yaw_rad=1.5e-3)


def localised(
    seed: int, way: tuple[float, float] = (0.0, LENGTH_M), shift_m: float = 0.0
) -> tuple[Trajectory, GnssTrack]:
    """Another drive along a part of the way, its poses within 3 cm of the map's drifted SLAM, with a GNSS of its own."""
    rng = np.random.default_rng(seed)
    first = drives.driven(LENGTH_M, SEED, DRIFTING)
    rows = np.flatnonzero((first.along >= way[0]) & (first.along <= way[1]))
    stamp = first.slam.stamp_ns[rows]
    wander = (
        gaussian_filter1d(rng.normal(size=(len(rows), 3)), 20, axis=0) * 0.03 * np.sqrt(40 * np.sqrt(np.pi))
    )
    slam = Trajectory(first.slam.xyz_m[rows] + wander, first.slam.quaternion[rows], stamp)
    fixes = np.flatnonzero((first.gnss.stamp_ns >= stamp[0]) & (first.gnss.stamp_ns <= stamp[-1]))
    noise = rng.normal(size=(len(fixes), 3)) * 0.02
    xyz = first.gnss.xyz_m[fixes] + noise + (shift_m, 0, 0)
    columns = {f: getattr(first.gnss, f)[fixes] for f in ("sigma_m", "status", "row", "observed", "stamp_ns")}
    return slam, GnssTrack(xyz_m=xyz, **columns)


def aligned(seed: int, way: tuple[float, float] = (0.0, LENGTH_M), shift_m: float = 0.0) -> AlignedDrive:
    slam, gnss = localised(seed, way, shift_m)
    return AlignedDrive(pose_graph(slam, gnss, drives.HERE, None, None, PARAMS), "", len(slam), len(gnss))


@pytest.fixture(scope="module")
def main() -> tuple[drives.Driven, PoseGraph]:
    drive = drives.driven(LENGTH_M, SEED, DRIFTING, gaps=(OUTAGE_M,))
    return drive, pose_graph(drive.slam, drive.gnss, drives.HERE, None, None, PARAMS)


@pytest.fixture(scope="module")
def cover() -> AlignedDrive:
    return aligned(11, (600.0, 1300.0))


@pytest.fixture(scope="module")
def wrong() -> AlignedDrive:
    return aligned(12, shift_m=3.0)


def errors_m(drive: drives.Driven, graph: PoseGraph, way: tuple[float, float]) -> np.ndarray:
    inside = (drive.along > way[0]) & (drive.along < way[1])
    moved = pose_graph_warp(graph, PARAMS).apply(drive.slam.xyz_m[inside])
    return np.hypot(*(moved - drive.xyz[inside])[:, :2].T)


def test_another_drive_takes_over_in_an_outage(main, cover) -> None:
    drive, graph = main
    fused = fuse_drives(graph, {"cover": cover})
    before, after = (rmse(errors_m(drive, g, OUTAGE_M)) for g in (graph, fused.graph))
    elsewhere = [rmse(errors_m(drive, g, (0.0, 700.0))) for g in (graph, fused.graph)]
    # lever arm and clock of 700 m are told apart to 0.15 m: that is what is left
    assert after < 0.15
    assert after < before / 2
    assert elsewhere[1] < elsewhere[0] + 0.01
    assert all(np.isfinite(getattr(fused.graph.nodes, f)).all() for f in type(graph.nodes).__slots__)
    assert fused.drives.used.all()
    assert fused.drives.weight.sum() == pytest.approx(1.0)
    assert fused.drives.common_places[1] == len(cover.graph.nodes)


def test_predicted_deviation_falls_with_the_error(main, cover) -> None:
    drive, graph = main
    nodes = fuse_drives(graph, {"cover": cover}).graph.nodes
    own = slice(0, len(graph.nodes))
    inside = (drive.along[nodes.row[own]] > OUTAGE_M[0]) & (drive.along[nodes.row[own]] < OUTAGE_M[1])
    predicted = rmse(np.hypot(*nodes.sigma_m[own][inside, :2].T))
    error = rmse(np.hypot(*(nodes.xyz_m[own] - drive.xyz[nodes.row[own]])[inside, :2].T))
    assert predicted < rmse(np.hypot(*graph.nodes.sigma_m[inside, :2].T)) / 2
    assert 0.33 < predicted / error < 3


def test_a_wrong_drive_is_left_out_and_changes_nothing(main, cover, wrong) -> None:
    graph = main[1]
    without, fused = (
        fuse_drives(graph, {"cover": cover}),
        fuse_drives(graph, {"wrong": wrong, "cover": cover}),
    )
    assert fused.drives.drive.tolist() == ["", "cover", "wrong"]
    assert fused.drives.used.tolist() == [True, True, False]
    assert fused.drives.disagreement_m[2] == pytest.approx(3.0, abs=0.1)
    assert "disagrees with the other drives by" in fused.drives.reason[2]
    assert fused.drives.weight[2] == 0.0
    assert fused.graph.nodes.xyz_m.tobytes() == without.graph.nodes.xyz_m.tobytes()


def test_a_lone_map_drive_stays_as_it_is(main) -> None:
    graph = main[1]
    stands = AlignedDrive(None, "cannot be aligned: stands", 5, 0)
    fused = fuse_drives(graph, {"stands": stands})
    assert np.abs(fused.graph.nodes.xyz_m - graph.nodes.xyz_m).max() < 1e-9
    assert fused.drives.reason[1] == "cannot be aligned: stands"
    assert fused.drives.used.tolist() == [True, False]


def test_a_drive_beyond_the_maps_own_extends_it(main) -> None:
    """The map's own drive ends early; the other goes on from where nothing is in common."""
    drive, graph = main
    nodes = graph.nodes
    early = nodes.row < np.searchsorted(drive.along, 700.0)
    kept = dataclasses.replace(
        graph,
        nodes=type(nodes)(*(getattr(nodes, f)[early] for f in type(nodes).__slots__)),
    )
    beyond = aligned(13, (780.0, 1500.0))
    fused = fuse_drives(kept, {"beyond": beyond})
    assert fused.drives.used.all()
    assert np.isnan(fused.drives.disagreement_m[1]) or fused.drives.common_places[1] > 0
    before, after = (rmse(errors_m(drive, g, (900.0, 1400.0))) for g in (kept, fused.graph))
    assert after < 0.25 < before


def test_a_drive_in_another_slam_frame_is_left_out(main) -> None:
    graph = main[1]
    slam, gnss = localised(14, (0.0, 900.0))
    turned = rotated(slam.xyz_m[:, :2], 2.0) + np.array([5000.0, 0.0])
    other = dataclasses.replace(slam, xyz_m=np.column_stack([turned, slam.xyz_m[:, 2]]))
    alone = AlignedDrive(pose_graph(other, gnss, drives.HERE, None, None, PARAMS), "", len(slam), len(gnss))
    table = fuse_drives(graph, {"other": alone}).drives
    assert not table.used[1]
    assert "not localised in the frame of the map's SLAM" in table.reason[1]


def test_heights_of_a_drive_without_altitude_follow_the_others(main, cover) -> None:
    drive, graph = main
    slam, gnss = localised(15, (600.0, 1300.0))
    flat = dataclasses.replace(gnss, xyz_m=np.column_stack([gnss.xyz_m[:, :2], np.full(len(gnss), np.nan)]))
    level = AlignedDrive(pose_graph(slam, flat, drives.HERE, None, None, PARAMS), "", len(slam), len(gnss))
    nodes = fuse_drives(graph, {"level": level}).graph.nodes
    assert np.isfinite(nodes.xyz_m).all()
    rows = nodes.row[len(graph.nodes) :] + np.searchsorted(drive.along, 600.0)
    assert np.abs(nodes.xyz_m[len(graph.nodes) :, 2] - drive.xyz[rows, 2]).max() < 1.0


def test_a_drive_that_cannot_be_aligned_is_no_error() -> None:
    slam, _ = localised(16, (0.0, 300.0))
    n = 10
    nowhere = GnssFixes(
        lon_deg=np.full(n, 9.0), lat_deg=np.full(n, 48.0), alt_m=np.full(n, np.nan),
        sigma_east_m=np.full(n, np.nan), sigma_north_m=np.full(n, np.nan), sigma_up_m=np.full(n, np.nan),
        status=np.full(n, -1), stamp_ns=None,
    )  # fmt: skip
    tried = align_drive(slam, nowhere, drives.HERE, PARAMS)
    assert tried.graph is None
    assert "none of 10 fixes has a position" in tried.reason
