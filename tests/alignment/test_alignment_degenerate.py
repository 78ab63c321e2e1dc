"""Drives that determine no alignment end in one clear line; poor ones that do are kept."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TypeVar

import numpy as np
import pytest

from flexmap_tasks.alignment.plausible import refuse_steep
from flexmap_tasks.alignment.pose_graph import pose_graph
from flexmap_tasks.config import PoseGraphParams
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.model.pose_graph import PoseGraph
from flexmap_tasks.model.tracks import STATUS_NONE, GnssTrack, Trajectory
from tests import drives
from tests.drives import HERE, Driven, driven, untimed

HOUR_NS = 3600 * 10**9
Track = TypeVar("Track", Trajectory, GnssTrack)


def adjusted(drive: Driven) -> PoseGraph:
    return pose_graph(drive.slam, drive.gnss, HERE, None, None, PoseGraphParams())


@pytest.fixture(scope="module")
def town() -> Driven:
    return driven(1500.0)


def rows(track: Track, at: np.ndarray) -> Track:
    columns = {f.name: getattr(track, f.name) for f in dataclasses.fields(track)}
    return type(track)(**{name: None if c is None else c[at] for name, c in columns.items()})


def places(track: Track, xyz_m: np.ndarray) -> Track:
    return dataclasses.replace(track, xyz_m=xyz_m)


def still(track: Track, noise_m: float) -> Track:
    return places(track, np.random.default_rng(1).normal(size=track.xyz_m.shape) * noise_m)


def camera(slam: Trajectory) -> Trajectory:
    x, y, z = slam.xyz_m.T
    return places(slam, np.column_stack([-y, -z, x]))


def elsewhere(drive: Driven, seed: int) -> Driven:
    return drive._replace(gnss=driven(1500.0, seed=seed).gnss)


def an_hour_later(drive: Driven) -> Driven:
    return drive._replace(gnss=dataclasses.replace(drive.gnss, stamp_ns=drive.gnss.stamp_ns + HOUR_NS))


DEGENERATE: dict[str, tuple[Callable[[Driven], Driven], str]] = {
    "SLAM stands still": (lambda d: d._replace(slam=still(d.slam, 0.01)), "SLAM trajectory: stands still"),
    "GNSS stands still": (lambda d: d._replace(gnss=still(d.gnss, 0.02)), "GNSS track: 1 usable fixes"),
    "GNSS stands still and scatters": (
        lambda d: d._replace(gnss=still(d.gnss, 1.0)), "GNSS track: stands still",
    ),
    "no valid fix": (
        lambda d: d._replace(gnss=dataclasses.replace(d.gnss, status=np.full(len(d.gnss), STATUS_NONE))),
        "GNSS track: 0 usable fixes",
    ),
    "two fixes": (lambda d: d._replace(gnss=rows(d.gnss, np.array([100, 800]))), "GNSS track: 2 usable fixes"),
    "another drive": (lambda d: elsewhere(d, 5), "cannot be one drive: a tenth"),
    "another drive, no time": (lambda d: untimed(elsewhere(d, 5)), "do not fit by their shapes: only"),
    "another drive at another time": (
        lambda d: an_hour_later(elsewhere(d, 11)), "share too little to be sure by their shapes",
    ),
    "left-handed": (lambda d: d._replace(slam=places(d.slam, d.slam.xyz_m * (1, -1, 1))), "cannot be one drive"),
    "camera axes": (lambda d: d._replace(slam=camera(d.slam)), "z must point up. Camera axes"),
}  # fmt: skip


@pytest.mark.parametrize("case", DEGENERATE)
def test_a_degenerate_drive_is_one_clear_line(town: Driven, case: str) -> None:
    spoil, line = DEGENERATE[case]
    with pytest.raises(AlignmentError, match=line) as refused:
        adjusted(spoil(town))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("timed", [True, False])
def test_a_straight_drive_does_not_say_where_along_it(monkeypatch: pytest.MonkeyPatch, timed: bool) -> None:
    def road(length_m: float, _: np.random.Generator) -> np.ndarray:
        return np.arange(0, length_m, 0.5)[:, None] * (0.8, 0.6)

    monkeypatch.setattr(drives, "town", road)
    straight = driven(600.0)
    with pytest.raises(AlignmentError, match="where along its way"):
        adjusted(straight if timed else untimed(straight))


def test_clocks_an_hour_apart_are_aligned_by_shape(town: Driven) -> None:
    graph = adjusted(an_hour_later(town))
    assert not graph.figures.timed
    assert np.hypot(*(graph.nodes.xyz_m - town.xyz[graph.nodes.row])[:, :2].T).max() < 1.5


POOR, LONG_OUTAGES = drives.Noise(place_m=0.02, yaw_rad=2e-3), ((500, 1000), (1300, 2000))


@pytest.mark.parametrize("timed", [True, False])
def test_a_poor_drive_with_long_outages_is_kept(timed: bool) -> None:
    drive = driven(3000.0, seed=6, noise=POOR, gaps=LONG_OUTAGES)
    graph = adjusted(drive if timed else untimed(drive))
    sigma = np.sqrt((graph.nodes.sigma_m[:, :2] ** 2).mean(axis=1))
    error = np.hypot(*(graph.nodes.xyz_m - drive.xyz[graph.nodes.row])[:, :2].T)
    assert (error < 6 * sigma + 0.1).all()


def test_the_steepest_road_is_no_camera() -> None:
    along = np.arange(0.0, 300.0, 0.5)
    refuse_steep(np.column_stack([along, 0 * along, 0.4 * along]))
    with pytest.raises(AlignmentError, match="z must point up"):
        refuse_steep(np.column_stack([0.4 * along, 0 * along, along]))
