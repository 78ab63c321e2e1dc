"""The pose graph on drives with known truth, and on the real route."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy import sparse
from scipy.ndimage import gaussian_filter1d

from flexmap_tasks.alignment.align_track import align_track
from flexmap_tasks.alignment.heldout import heldout
from flexmap_tasks.alignment.pose_graph import antenna_track, pose_graph, pose_graph_warp
from flexmap_tasks.alignment.project import project_utm
from flexmap_tasks.alignment.tried_points import solved_drive, tried
from flexmap_tasks.config import (
    GnssParams,
    GraphHeldOutParams,
    PoseGraphParams,
    ProjectionParams,
    SlamParams,
)
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.evaluation.deviation import deviation
from flexmap_tasks.formats.artifacts import encode
from flexmap_tasks.geometry.normal_equations import factor, inverse_on_pattern
from flexmap_tasks.geometry.polyline import nearest_on_polyline
from flexmap_tasks.geometry.se2 import rotated
from flexmap_tasks.ingest.gnss import ingest_gnss
from flexmap_tasks.ingest.slam import ingest_slam
from flexmap_tasks.model.alignment import ControlPoints, Extent, RigidMotion
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import GnssTrack, Trajectory
from tests import drives
from tests.drives import rmse

HERE = dataclasses.replace(Projection.at(9.0, 48.0), grid_scale_factor=1.0)
START_NS = 1_700_000_000_000_000_000


class Driven(NamedTuple):
    slam: Trajectory
    gnss: GnssTrack
    xyz: np.ndarray
    along: np.ndarray


def driven(seed: int = 0, *, gap: tuple = (0, 0), bias: tuple = (0, 0), offset_s: float = 0.2) -> Driven:
    """Two rounds through a town, seen by a SLAM that drifts and a GNSS with a lever arm of 2.0, 0.5 m."""
    rng = np.random.default_rng(seed)
    corners = np.array([[0, 0], [300, 0], [300, 200], [0, 200], [0, 0], [300, 0], [300, -200], [550, -200],
                        [550, 200], [300, 200]], float)  # fmt: skip
    along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    even = np.arange(0, along[-1], 0.5)
    road = gaussian_filter1d(
        np.column_stack([np.interp(even, along, c) for c in corners.T]), 12, axis=0, mode="nearest"
    )
    arc = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(road, axis=0).T))])
    heading = np.unwrap(np.arctan2(*np.gradient(road, axis=0).T[::-1]))
    time = np.linspace(0, arc[-1] / 9.0, 4000)
    way = 9.0 * time + 12 * np.sin(time / 6)

    def pose(at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        s = np.clip(np.interp(at, time, way), 0, arc[-1])
        xyz = np.column_stack([*(np.interp(s, arc, c) for c in road.T), 4 * np.sin(s / 250)])
        return xyz, np.interp(s, arc, heading), s

    slam_t = np.arange(0, time[-1] - 1, 0.2)
    xyz, yaw, s = pose(slam_t)
    step = rotated(np.diff(xyz[:, :2], axis=0), -yaw[:-1])
    root = np.sqrt(np.hypot(*step.T) / 3)[:, None]
    step = step / 1.003 + rng.normal(size=step.shape) * 0.01 * root
    turn = np.concatenate([[0], np.cumsum(np.diff(yaw) + rng.normal(size=len(step)) * 8e-4 * root[:, 0])])
    slam_xy = np.concatenate([[[0, 0]], np.cumsum(rotated(step, turn[:-1]), axis=0)])
    drift = np.concatenate([[0], np.cumsum(rng.normal(size=len(step)) * 0.02 * root[:, 0])])
    zero = np.zeros(len(turn))
    slam = Trajectory(
        np.column_stack([slam_xy, xyz[:, 2] + drift - 3.0]),
        np.column_stack([zero, zero, np.sin(turn / 2), np.cos(turn / 2)]),
        START_NS + (slam_t * 1e9).astype(np.int64),
    )
    gnss_t = np.arange(0.53, time[-1] - 2, 0.2)
    body, gnss_yaw, gnss_s = pose(gnss_t)
    antenna = body.copy()
    antenna[:, :2] += rotated(np.tile([2.0, 0.5], (len(body), 1)), gnss_yaw)
    antenna += rng.normal(size=antenna.shape) * (0.02, 0.02, 0.04)
    antenna[(gnss_s > bias[0]) & (gnss_s < bias[1]), :2] += 0.85
    kept = np.flatnonzero(~((gnss_s > gap[0]) & (gnss_s < gap[1])))
    gnss = GnssTrack(
        antenna[kept], np.full((len(kept), 3), np.nan), np.zeros(len(kept), np.int64), kept,
        np.concatenate([[True], np.diff(kept) == 1]), START_NS + ((gnss_t[kept] - offset_s) * 1e9).astype(np.int64),
    )  # fmt: skip
    return Driven(slam, gnss, xyz, s)


def untimed(drive: Driven) -> Driven:
    return drive._replace(
        slam=dataclasses.replace(drive.slam, stamp_ns=None),
        gnss=dataclasses.replace(drive.gnss, stamp_ns=None),
    )


def solved(drive: Driven):
    return pose_graph(drive.slam, drive.gnss, HERE, None, None, PoseGraphParams())


def error(drive: Driven, graph) -> np.ndarray:
    return np.hypot(*(graph.nodes.xyz_m - drive.xyz[graph.nodes.row])[:, :2].T)


@pytest.fixture(scope="module")
def plain():
    drive = driven()
    return drive, solved(drive)


def test_inverse_on_the_pattern_is_the_inverse() -> None:
    half = sparse.random(80, 80, 0.04, random_state=1) + sparse.diags(np.full(80, 3.0)) + sparse.eye(80, k=1)
    matrix = (half.T @ half).tocsc()
    exact, pattern = np.linalg.inv(matrix.toarray()), matrix.toarray() != 0
    assert np.abs((inverse_on_pattern(factor(matrix)).toarray() - exact)[pattern]).max() < 1e-12


def test_timed_drive_is_recovered(plain) -> None:
    drive, graph = plain
    assert graph.figures.timed
    assert rmse(error(drive, graph)) < 0.06
    assert rmse(graph.nodes.xyz_m[:, 2] - drive.xyz[graph.nodes.row, 2]) < 0.10
    assert graph.figures.clock_offset_s == pytest.approx(0.2, abs=0.01)
    assert graph.figures.lever_left_m == pytest.approx(0.5, abs=0.05)
    assert graph.figures.lever_forward_m == pytest.approx(2.0, abs=0.15)
    assert graph.figures.scale == pytest.approx(1.003, abs=1e-3)


def test_predicted_deviation_is_honest(plain) -> None:
    drive, graph = plain
    predicted = np.hypot(*graph.nodes.sigma_m[:, :2].T)
    assert 0.33 < rmse(predicted) / rmse(error(drive, graph)) < 2.5


def test_gap_and_outage_are_bridged() -> None:
    for gap, limit in (((700, 800), 0.10), ((900, 1180), 0.40)):
        drive = driven(gap=gap)
        graph = solved(drive)
        inside = (drive.along > gap[0]) & (drive.along < gap[1])
        assert rmse(error(drive, graph)[inside[graph.nodes.row]]) < limit


@pytest.mark.parametrize(
    ("timed", "place", "gap"),
    [
        (True, (800, 900), ()),
        (True, (1385, 1480), ()),
        (True, (700, 800), ((550, 700),)),
        (True, (0, 60), ()),
        (False, (1385, 1480), ()),
        (False, (0, 60), ()),
    ],
)
def test_multipath_stretch_is_switched_off(timed: bool, place: tuple, gap: tuple) -> None:
    drive = drives.driven(1500, 3, gaps=gap, biases=(drives.Bias(*place, 0.85, 0.85),))
    graph = solved(drive if timed else drives.untimed(drive))
    way = np.interp(0.53 + 0.1 * drive.gnss.row, 0.2 * np.arange(len(drive.along)), drive.along)
    false = (way > place[0]) & (way < place[1])
    off = graph.gnss_use.reason == "multipath: a stretch that stands off as a whole"
    line = graph.gnss_use.used | off
    assert off[false & line].mean() > 0.85  # stretches begin and end at cells of 5 m
    assert off[~false & line].mean() < 0.03
    if timed and not gap and place[0] > 0 and place[1] < 1400:
        inside = (drive.along > place[0]) & (drive.along < place[1])
        assert rmse(error(drive, graph)[inside[graph.nodes.row]]) < 0.20


@pytest.mark.parametrize("seed", [1, 2])
def test_honest_gnss_is_kept(seed: int) -> None:
    noise = drives.Noise(place_m=0.03, yaw_rad=1.5e-3, slow_m=0.03)
    for drive in (drives.driven(1500, seed, noise), drives.untimed(drives.driven(1500, seed, noise))):
        assert not any("multipath" in reason for reason in solved(drive).gnss_use.reason)


def test_clock_and_lever_are_told_apart_in_sharp_corners() -> None:
    figures = solved(drives.driven(2500, 5)).figures
    assert figures.lever_forward_m == pytest.approx(2.0, abs=0.1)
    assert figures.clock_offset_s == pytest.approx(0.2, abs=0.01)


def test_untimed_drive_lies_on_the_line(plain) -> None:
    drive = untimed(plain[0])
    graph = solved(drive)
    assert not graph.figures.timed
    antenna = antenna_track(graph).xyz_m[:, :2]
    gap = nearest_on_polyline(antenna[5:-5], drive.gnss.xyz_m[:, :2]).distance_m
    assert rmse(gap) < 0.06


@pytest.mark.parametrize("timed", [True, False])
def test_where_and_how_the_slam_frame_starts_is_irrelevant(plain, timed: bool) -> None:
    drive = plain[0] if timed else untimed(plain[0])
    xy = rotated(drive.slam.xyz_m[:, :2], 2.2) + np.array([5000.0, -1000.0])
    yaw = 2 * np.arctan2(drive.slam.quaternion[:, 2], drive.slam.quaternion[:, 3]) + 2.2
    zero = np.zeros(len(yaw))
    moved = Trajectory(
        np.column_stack([xy, drive.slam.xyz_m[:, 2]]),
        np.column_stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)]), drive.slam.stamp_ns,
    )  # fmt: skip
    one, two = solved(drive), solved(drive._replace(slam=moved))
    assert np.abs(one.nodes.xyz_m - two.nodes.xyz_m).max() < 1e-3


def test_warp_of_the_graph(plain) -> None:
    drive, graph = plain
    warp = pose_graph_warp(graph, PoseGraphParams())
    xyz = np.random.default_rng(0).uniform(-600, 1200, (3000, 3))
    there = warp.apply(xyz)
    assert np.abs(warp.inverse().apply(there) - xyz).max() < 1e-6
    box = Extent(80.0, -20.0, 140.0, 30.0)
    inside = np.random.default_rng(1).uniform(0, 1, (500, 3)) * (60, 50, 5) + np.array([80, -20, 0])
    part = warp.restrict(box)
    assert np.array_equal(part.apply(inside), warp.apply(inside))
    step = np.array([1e-3, 0.0, 0.0])
    assert np.abs(warp.apply(xyz + step) - there - step).max() < 1e-3
    assert (np.linalg.det(warp.jacobian(xyz)) > 0.5).all()
    assert np.isfinite(warp.sigma_m(xyz)).all()
    assert len(align_track(drive.slam, warp)) == len(drive.slam)


def test_what_the_last_bits_say_does_not_reach_the_warp(plain) -> None:
    graph, rng = plain[1], np.random.default_rng(1)
    nodes = graph.nodes
    other = dataclasses.replace(nodes, xyz_m=nodes.xyz_m + rng.uniform(-1e-11, 1e-11, nodes.xyz_m.shape))
    one, two = (
        pose_graph_warp(dataclasses.replace(graph, nodes=n), PoseGraphParams()) for n in (nodes, other)
    )
    assert one.bend is not None
    assert two.bend is not None
    for name in ("target_xy_m", "turn_rad", "lift_m", "sigma_m"):
        assert np.array_equal(getattr(one.bend, name), getattr(two.bend, name))
    assert np.abs(one.bend.target_xy_m - nodes.xyz_m[:, :2]).max() < 1e-4


def test_same_input_same_bits(plain) -> None:
    drive, graph = plain
    again = solved(drive)
    assert np.array_equal(graph.nodes.xyz_m, again.nodes.xyz_m)
    assert np.array_equal(graph.nodes.sigma_m, again.nodes.sigma_m, equal_nan=True)


@pytest.mark.parametrize("what", ["slam", "gnss", "short"])
def test_degenerate_drives_are_refused(plain, what: str) -> None:
    drive = untimed(plain[0])
    slam, gnss = drive.slam, drive.gnss
    still = np.random.default_rng(0).normal(size=(50, 3)) * 0.01
    if what == "slam":
        slam = Trajectory(still, np.tile([0.0, 0, 0, 1], (50, 1)), None)
    else:
        rows = np.arange(2) if what == "short" else np.arange(50)
        xyz = gnss.xyz_m[rows] if what == "short" else still
        gnss = GnssTrack(xyz, gnss.sigma_m[rows], gnss.status[rows], rows, np.ones(len(rows), bool), None)
    with pytest.raises(AlignmentError, match="needed"):
        pose_graph(slam, gnss, HERE, None, None, PoseGraphParams())


def test_a_drive_without_altitudes_can_be_stored(plain) -> None:
    drive = plain[0]
    flat = np.column_stack([drive.gnss.xyz_m[:, :2], np.full(len(drive.gnss), np.nan)])
    graph = solved(drive._replace(gnss=dataclasses.replace(drive.gnss, xyz_m=flat)))
    assert graph.figures.noise_altitude is None
    assert b'"noise_climb_m": null' in dict(encode(graph.figures, "figures"))["figures.json"]


def test_garching_route(shared_data: Path) -> None:
    folder = shared_data / "garching"
    slam = ingest_slam(Source("slam", folder / "route1_pose_kitti.txt"), SlamParams())
    fixes = ingest_gnss(Source("gnss", folder / "route_1_GPS.txt"), GnssParams())
    projected = project_utm(fixes, ProjectionParams())
    gnss, projection = projected.gnss_track, projected.projection
    graph = pose_graph(slam, gnss, projection, None, None, PoseGraphParams())
    off = deviation(antenna_track(graph).xyz_m, gnss)
    assert off.distance_m.mean() <= 0.40
    assert rmse(off.distance_m[off.valid]) <= 0.065
    assert graph.figures.lever_left_m == pytest.approx(0.49, abs=0.05)
    assert graph.figures.lever_forward_m == pytest.approx(2.06, abs=0.25)
    judged = heldout(slam, gnss, projection, GraphHeldOutParams(block_m=50.0))
    assert len(judged) > 1100
    assert rmse(judged.distance_m) <= 0.10


def test_places_off_the_earth_become_nan(plain) -> None:
    warp = pose_graph_warp(plain[1], PoseGraphParams())
    out = warp.apply(np.array([[np.nan, 0.0, 0.0], [1e300, 0.0, 0.0], [-np.inf, 1.0, 0.0], [5.0, 5.0, 1.0]]))
    assert np.isnan(out[:3, 0]).all()
    assert np.isfinite(out[3]).all()


def paired(drive: Driven, gap: slice, sigma_m: float = 0.05) -> tuple[ControlPoints, RigidMotion]:
    """Places of the drive where they belong, given after a turned start."""
    start = RigidMotion(np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([7.0, -3.0]), 1.0, 1.0, 0.0)
    rows = np.arange(len(drive.slam))[gap]
    n = len(rows)
    points = ControlPoints(
        strings(f"p{i}" for i in range(n)), start.apply_xy(drive.slam.xyz_m[rows, :2]), drive.xyz[rows, :2],
        np.full(n, sigma_m), np.ones(n, bool), strings([""] * n),
    )  # fmt: skip
    return points, start


def test_points_that_are_tried_do_what_a_run_does() -> None:
    drive = driven(1, gap=(900, 1150))
    points, start = paired(drive, slice(400, 900, 80))
    found = tried(solved_drive(drive.slam, drive.gnss, HERE, PoseGraphParams()), points, start)
    graph = pose_graph(drive.slam, drive.gnss, HERE, points, start, PoseGraphParams())
    run = pose_graph_warp(graph, PoseGraphParams()).apply(drive.slam.xyz_m)
    assert np.hypot(*(found.warp.apply(drive.slam.xyz_m) - run)[:, :2].T).max() < 0.03
    assert np.hypot(*(found.antenna_m - antenna_track(graph).xyz_m[:, :2]).T).max() < 0.03
    assert found.residual_m.max() < 0.1


def test_a_point_left_out_is_judged_by_all_others() -> None:
    drive = driven(1, gap=(900, 1150))
    points, start = paired(drive, slice(400, 900, 80))
    target = points.target_xy_m.copy()
    target[3] += (0.6, -0.4)
    points = dataclasses.replace(points, target_xy_m=target)
    base = solved_drive(drive.slam, drive.gnss, HERE, PoseGraphParams())
    found = tried(base, points, start)
    assert found.left_out_m.argmax() == 3
    without = dataclasses.replace(points, used=np.arange(len(points)) != 3)
    assert tried(base, without, start).residual_m[3] == pytest.approx(found.left_out_m[3], abs=0.05)
    assert len(tried(base, points.take(np.zeros(0, int)), start).residual_m) == 0
