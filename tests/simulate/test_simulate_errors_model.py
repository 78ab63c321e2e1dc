"""GNSS and SLAM are as wrong as the settings say, and no more."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from flexmap_tasks.simulate.generate import simulate
from flexmap_tasks.simulate.gnss import stated_altitudes


def gnss(world, **settings):
    return simulate(world.changed(gnss=settings)).gnss


@pytest.fixture
def long_town(small_town):
    return small_town.changed(drive={"length_m": 4000.0}, gnss={"outages": 0, "slow_time_s": 5.0})


def test_honest_covariances_fit_the_errors(long_town):
    fixes = gnss(long_town, float_share=0.3, single_share=0.1)
    assert set(fixes.mode) == {"rtk_fix", "rtk_float", "single"}
    for mode in ("rtk_fix", "rtk_float"):
        rows = fixes.mode == mode
        score = fixes.error_m[rows] / fixes.sigma_m[rows]
        assert 0.6 < np.sqrt((score**2).mean()) < 1.5


def test_optimistic_covariances_are_five_times_too_small(long_town):
    honest, optimistic = gnss(long_town), gnss(long_town, covariance="optimistic")
    assert np.array_equal(honest.error_m, optimistic.error_m)
    assert np.allclose(optimistic.sigma_m, honest.sigma_m / 5)


def test_wrong_covariances_do_not_follow_the_errors(long_town):
    fixes = gnss(long_town, covariance="wrong", float_share=0.3)
    spread = np.abs(fixes.error_m[:, 0])
    assert abs(np.corrcoef(np.log(fixes.sigma_m[:, 0]), spread)[0, 1]) < 0.1
    assert np.isnan(gnss(long_town, covariance="unknown").sigma_m).all()


def test_multipath_is_a_constant_offset_over_its_stretch(long_town):
    plain, bent = gnss(long_town), gnss(long_town, multipath_stretches=1, multipath_offset_m=1.2)
    off = bent.error_m - plain.error_m
    assert np.allclose(np.hypot(*off[bent.multipath, :2].T), 1.2)
    assert np.ptp(off[bent.multipath], axis=0).max() < 1e-9
    assert not off[~bent.multipath].any()
    assert bent.multipath.any()


def test_altitudes_step_are_rounded_or_missing(long_town):
    plain, off = gnss(long_town), gnss(long_town, altitude_steps=2, altitude_step_m=7.0)
    up = off.error_m - plain.error_m
    assert not up[:, :2].any()
    assert np.allclose(np.abs(up[up[:, 2] != 0.0, 2]), 7.0)
    assert 0.02 < (up[:, 2] != 0.0).mean() < 0.3
    altitude = np.array([480.26, 479.9])
    for settings, stated in (
        ({}, altitude),
        ({"altitude_resolution_m": 0.5}, [480.5, 480.0]),
        ({"altitude": "zero"}, [0.0, 0.0]),
        ({"altitude": "none"}, [np.nan, np.nan]),
    ):
        world = long_town.changed(gnss=settings)
        assert np.allclose(stated_altitudes(world, altitude), stated, equal_nan=True)


def test_outages_are_silent_or_say_that_there_is_no_fix(long_town):
    silent = gnss(long_town, outages=2, outage_length_m=100.0)
    loud = gnss(long_town, outages=2, outage_length_m=100.0, outage_messages=True)
    assert len(silent.time_s) < len(loud.time_s) == len(gnss(long_town).time_s)
    assert not silent.outage.any()
    assert (loud.status[loud.outage] == -1).all()
    assert (loud.status[~loud.outage] >= 0).all()


def test_jumps_doubles_drops_and_the_clock(long_town):
    plain = gnss(long_town)
    jumpy = gnss(long_town, jumps=5, jump_m=8.0)
    assert (np.hypot(*(jumpy.error_m - plain.error_m)[:, :2].T) > 7.9).sum() == jumpy.jump.sum() == 5
    doubled = gnss(long_town, doubled_share=0.2)
    assert 1.1 < len(doubled.time_s) / len(plain.time_s) < 1.3
    assert 0.7 < len(gnss(long_town, dropped_share=0.2).time_s) / len(plain.time_s) < 0.9
    late = gnss(long_town, clock_offset_s=0.2)
    assert np.allclose(late.stamp_s - late.time_s, 0.2)
    assert np.array_equal(late.antenna_m, plain.antenna_m)


def test_the_antenna_sits_where_the_lever_arm_says(long_town):
    plain, arm = gnss(long_town), gnss(long_town, lever_arm_m=(2.0, 0.5, 1.5))
    off = arm.antenna_m - plain.antenna_m
    assert np.allclose(np.linalg.norm(off, axis=1), np.linalg.norm([2.0, 0.5, 1.5]))
    town = simulate(long_town)
    yaw = town.drive.at(plain.time_s)[1]
    forward = off[:, 0] * np.cos(yaw) + off[:, 1] * np.sin(yaw)
    left = -off[:, 0] * np.sin(yaw) + off[:, 1] * np.cos(yaw)
    assert np.abs(forward - 2.0).max() < 0.2, "pitch moves it a little"
    assert np.allclose(left, 0.5)


def test_standstills_stand(long_town):
    town = simulate(long_town.changed(drive={"stops_per_km": 3.0}))
    assert town.gnss.stand.sum() > 100
    xyz, *_ = town.drive.at(town.gnss.time_s[town.gnss.stand])
    assert len(np.unique(xyz.round(6), axis=0)) == len(town.drive.stands_s)


def disagreement(town):
    """Distance between errors of poses that pass one place at two times."""
    bare = (
        (town.slam.xyz_m - town.slam.start_m) @ town.slam.rotation + town.slam.origin_m - town.slam.true_xyz_m
    )
    tree = cKDTree(town.slam.true_xyz_m[:, :2])
    pairs = np.array(sorted(tree.query_pairs(4.0)))
    pairs = pairs[np.abs(np.diff(town.slam.s_m[pairs], axis=1))[:, 0] > 80.0]
    assert len(pairs) > 20
    return np.hypot(*(bare[pairs[:, 0]] - bare[pairs[:, 1]])[:, :2].T)


def test_closed_loops_agree_with_themselves_and_open_ones_do_not(long_town):
    noise = {"position_noise_m": 0.0, "yaw_walk_mrad_per_sqrt_m": 0.6}
    closed = disagreement(simulate(long_town.changed(slam={**noise, "loop_closure": "smoothed"})))
    opened = disagreement(simulate(long_town.changed(slam={**noise, "loop_closure": "none"})))
    assert np.median(closed) < 0.1
    assert np.median(opened) > 3 * np.median(closed)


def test_jumps_at_loop_closures_show_as_steps(long_town):
    noise = {"position_noise_m": 0.0, "yaw_walk_mrad_per_sqrt_m": 0.6, "keyframe_m": 0.5}
    steps = {}
    for closure in ("jumps", "none"):
        slam = simulate(long_town.changed(slam={**noise, "loop_closure": closure})).slam
        true = np.linalg.norm(np.diff(slam.true_xyz_m, axis=0), axis=1)
        steps[closure] = np.abs(np.linalg.norm(np.diff(slam.xyz_m, axis=0), axis=1) - true).max()
    assert steps["jumps"] > 5 * steps["none"]


def test_the_first_frame_has_the_heading_place_and_tilt_that_are_asked_for(small_town):
    settings = {"start_yaw_deg": 70.0, "start_offset_m": (100.0, -20.0, 5.0), "tilt_pitch_deg": 2.0}
    town = simulate(small_town.noiseless().changed(slam=settings))
    assert np.allclose(town.slam.xyz_m[0], [100.0, -20.0, 5.0])
    assert np.allclose(np.linalg.det(town.slam.rotation), 1.0)
    assert np.degrees(np.arccos(town.slam.rotation[2, 2])) == pytest.approx(2.0)
    level = simulate(small_town.noiseless().changed(slam={"start_yaw_deg": 70.0})).slam
    ahead = level.xyz_m[np.searchsorted(level.s_m, 8.0)] - level.xyz_m[0]
    assert np.degrees(np.arctan2(ahead[1], ahead[0])) == pytest.approx(70.0, abs=3.0)


def test_one_noise_never_stirs_another(small_town):
    a, b = simulate(small_town), simulate(small_town.changed(osm={"field_sigma_m": 5.0}))
    assert np.array_equal(a.slam.xyz_m, b.slam.xyz_m)
    assert np.array_equal(a.gnss.error_m, b.gnss.error_m)
    assert np.array_equal(a.hd_map.town_xyz_m, b.hd_map.town_xyz_m)
    c = simulate(small_town.changed(gnss={"white_sigma_m": 0.5}))
    assert np.array_equal(a.slam.xyz_m, c.slam.xyz_m)


def test_the_osm_field_has_the_sigma_that_is_asked_for(small_town):
    base = small_town.noiseless().changed(network={"blocks_x": 8, "blocks_y": 8})
    exact, off = simulate(base).osm, simulate(base.changed(osm={"field_sigma_m": 3.0})).osm
    frame = simulate(base).frame
    shift = frame.local(off.document.nodes.lonlat_deg) - frame.local(exact.document.nodes.lonlat_deg)
    assert 2.2 < shift.std(axis=0).mean() < 3.8
