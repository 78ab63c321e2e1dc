"""Laws of a plane moved by poses, on drives made up at random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexmap_tasks.model.alignment import Extent, RigidMotion, Warp
from flexmap_tasks.model.bend import Bend

seeds = st.integers(0, 2**32 - 1)
FEW = settings(max_examples=5, deadline=None)


def bent(seed: int, poses: int = 80, drift_m: float = 0.03) -> Warp:
    """A winding drive whose poses are corrected by a drifting shift and turn, 300 m away and turned by 40 degrees."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.normal(0, 0.08, poses))
    source = np.cumsum(3.0 * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    turn = 0.7 + np.cumsum(rng.normal(0, 2e-4, poses))
    shift = np.cumsum(rng.normal(0, drift_m, (poses, 2)), axis=0)
    cos, sin = np.cos(0.7), np.sin(0.7)
    target = source @ np.array([[cos, sin], [-sin, cos]]) + [300.0, -40.0] + shift
    one = np.ones(poses)
    bend = Bend.level(
        source, target, turn, one, np.cumsum(rng.normal(0, 0.01, poses)), 0.05 * one, 0.002 * one, 8 * one
    )
    motion = RigidMotion(np.array([[cos, -sin], [sin, cos]]), np.array([300.0, -40.0]), 1.0, 1.0, 0.0)
    return Warp(motion, None, bend=bend)


def around(seed: int, warp: Warp, reach_m: float, n: int = 100) -> np.ndarray:
    assert warp.bend is not None
    rng = np.random.default_rng(seed)
    place = warp.bend.source_xy_m[rng.integers(0, len(warp.bend), n)]
    return np.column_stack([place + rng.uniform(-reach_m, reach_m, (n, 2)), rng.uniform(-5, 5, n)])


@FEW
@given(seeds)
def test_never_folds_and_has_a_way_back(seed: int) -> None:
    warp = bent(seed)
    xyz = around(seed, warp, 60.0)
    assert (np.linalg.det(warp.jacobian(xyz)) > 0.8).all()
    assert np.abs(warp.inverse().apply(warp.apply(xyz)) - xyz).max() < 1e-8


@FEW
@given(seeds, st.sampled_from([1.0, 100.0, 3000.0]))
def test_is_continuous_near_and_far(seed: int, reach_m: float) -> None:
    warp = bent(seed)
    xyz = around(seed, warp, reach_m, 30)
    step = np.random.default_rng(seed).normal(size=xyz.shape) * [1e-3, 1e-3, 0.0]
    assert np.abs(warp.apply(xyz + step) - warp.apply(xyz)).max() < 1.2 * np.abs(step).sum(axis=1).max()
    assert np.abs(warp.sigma_m(xyz + step) - warp.sigma_m(xyz)).max() < 1e-3


@FEW
@given(seeds)
def test_poses_of_one_motion_move_all_the_plane_by_it(seed: int) -> None:
    one = bent(seed).bend
    assert one is not None
    turn = np.full(len(one), 0.7)
    cos, sin = np.cos(0.7), np.sin(0.7)
    target = one.source_xy_m @ np.array([[cos, sin], [-sin, cos]]) + [300.0, -40.0]
    same = Bend.level(
        one.source_xy_m, target, turn, one.stretch, 0 * turn, one.sigma_m, one.sigma_turn_rad, one.blend_m
    )
    warp = Warp(bent(seed).motion, None, bend=same)
    xyz = around(seed, warp, 1000.0, 30)
    moved = warp.apply(xyz)
    assert np.abs(moved[:, :2] - warp.motion.apply_xy(xyz)).max() < 1e-8
    assert np.array_equal(moved[:, 2], xyz[:, 2])


@FEW
@given(seeds, st.integers(1, 100))
def test_a_part_and_any_order_give_the_same_bits(seed: int, n: int) -> None:
    warp = bent(seed)
    xyz = around(seed, warp, 40.0)
    order = np.random.default_rng(seed).permutation(len(xyz))
    whole = warp.apply(xyz)
    assert np.array_equal(warp.apply(xyz[:n]), whole[:n])
    assert np.array_equal(warp.apply(xyz[order]), whole[order])
    extent = Extent.of(xyz[:n])
    assert extent is not None
    assert np.array_equal(warp.restrict(extent).apply(xyz[:n]), whole[:n])


def test_uncertainty_grows_away_from_the_poses() -> None:
    warp = bent(3)
    assert warp.bend is not None
    end = warp.bend.source_xy_m[-1]
    out = end - warp.bend.source_xy_m[-20]
    away = np.array([0.0, 5.0, 20.0, 60.0, 200.0, 1000.0, 5000.0])
    xyz = np.column_stack([end + away[:, None] * out / np.hypot(*out), 0 * away])
    sigma = warp.sigma_m(xyz)
    assert (np.diff(sigma) > 0).all()
    assert sigma[0] == pytest.approx(0.055, abs=0.02)
    assert sigma[-1] == pytest.approx(0.002 * 5000 / np.sqrt(2), rel=0.1)


def test_what_is_not_a_place_stays_so() -> None:
    warp = bent(4)
    xyz = np.array([[np.nan, 0, 1], [0, np.inf, 1], [1e12, 0, 1], [0, 0, np.nan]])
    moved = warp.apply(xyz)
    assert np.isnan(moved[:3]).all()
    assert np.isfinite(moved[3, :2]).all()
    assert np.isnan(moved[3, 2])
    assert np.isnan(warp.apply(xyz[:3])).all()
    assert warp.apply(np.empty((0, 3))).shape == (0, 3)


def test_a_point_with_a_time_follows_the_pass_that_saw_it() -> None:
    """Two passes of one street whose corrections are 10 cm apart."""
    there = np.column_stack([np.arange(0, 90, 3.0), np.zeros(30)])
    source = np.concatenate([there, there[::-1]])
    off = np.repeat([0.05, -0.05], 30)
    one, stamp = np.ones(60), np.arange(60) * 10**8
    target = source + np.column_stack([0 * off, off])
    bend = Bend.level(source, target, 0 * off, one, off, 0.02 * one, 0.001 * one, 8 * one, stamp)
    warp = Warp(RigidMotion(np.eye(2), np.zeros(2), 1.0, 1.0, 0.0), None, bend=bend)
    xyz = np.column_stack([np.linspace(20, 70, 11), np.full(11, 4.0), np.full(11, 1.0)])
    first = (xyz[:, 0] / 3.0 * 1e8).astype(np.int64)
    second = 59 * 10**8 - first
    for stamps, expected in ((first, 0.05), (second, -0.05), (first * 0 - 1, 0.0)):
        moved = warp.apply_at(xyz, stamps)
        assert np.abs(moved - xyz - [0.0, expected, expected]).max() < 5e-3
    assert np.array_equal(warp.apply_at(xyz, first * 0 - 1), warp.apply(xyz))
    before, after = (
        warp.apply_at(xyz, np.full(11, -(10**18)) + 10**18),
        warp.apply_at(xyz, np.full(11, 10**18)),
    )
    assert np.allclose(before[:, 1] - xyz[:, 1], 0.05)
    assert np.allclose(after[:, 1] - xyz[:, 1], -0.05)
    assert warp.restrict(Extent(0, 0, 10, 10)).bend.stamp_ns is None  # type: ignore[union-attr]


STILL = RigidMotion(np.eye(2), np.zeros(2), 1.0, 1.0, 0.0)


def straight(poses: int = 40, **changed: np.ndarray) -> Bend:
    """A drive along x at height 100 that is corrected by nothing but what is given."""
    source = np.column_stack([3.0 * np.arange(poses), np.zeros(poses)])
    zero, one = np.zeros(poses), np.ones(poses)
    level = Bend.level(
        source, source, zero, one, zero, 0.02 * one, 0.001 * one, 8 * one,
        np.arange(poses, dtype=np.int64), source_z_m=100 * one,
    )  # fmt: skip
    return replace(level, **changed)


@pytest.mark.parametrize("by_time", [False, True])
def test_what_stands_by_the_road_leans_as_the_pose_does(by_time: bool) -> None:
    """Roll and pitch turn a traffic light, a facade and the ground about the pose, by the small angle's own motion."""
    tilt, turn = np.array([0.01, -0.02]), np.full(40, np.pi / 2)
    bend = straight(
        tilt_xy_rad=np.tile(tilt, (40, 1)),
        turn_rad=turn,
        stretch_up=np.full(40, 1.01),
        lift_m=np.full(40, 0.3),
    )
    bend = replace(bend, target_xy_m=np.column_stack([-bend.source_xy_m[:, 1], bend.source_xy_m[:, 0]]))
    warp = Warp(STILL, None, bend=bend)
    xyz = np.array([[60.0, 0.0, 100.0], [60.0, 0.0, 106.0], [60.0, 10.0, 100.0], [60.0, 10.0, 130.0]])
    moved = warp.apply_at(xyz, np.full(4, 20)) if by_time else warp.apply(xyz)
    # at right angles to the way: a roll lifts what lies beside it; a quarter turn brings x to y
    above = xyz[:, 2] - 100
    along = xyz[:, :2] - above[:, None] * tilt
    place = np.column_stack([-along[:, 1], along[:, 0]])
    # the tilt is the same at all poses here, but their heights are: a slope along x does not lift the road itself
    up = 100.3 + 1.01 * above + tilt[1] * xyz[:, 1]
    assert np.abs(moved[:, :2] - place).max() < 1e-9
    assert (
        np.abs(moved[:, 2] - up).max() < 0.011 * 8
    )  # poses before lift, those behind lower: blended to nothing
    if by_time:
        assert np.abs(moved[:, 2] - up).max() < 1e-9


def test_a_height_that_no_map_knows_does_not_lean() -> None:
    bend = straight(tilt_xy_rad=np.tile([0.01, 0.02], (40, 1)))
    warp = Warp(STILL, None, bend=bend)
    moved = warp.apply(np.array([[60.0, 0.0, np.nan], [60.0, 0.0, 100.0]]))
    assert np.abs(moved[:, :2] - [60.0, 0.0]).max() < 1e-9
    assert np.isnan(moved[0, 2])
    assert np.abs(warp.inverse().apply(moved)[:, :2] - [60.0, 0.0]).max() < 1e-9
    drawn = warp.apply_drawn(np.array([[60.0, 0.0, 0.0]]))
    assert np.abs(drawn[:, :2] - [60.0, 0.0]).max() < 1e-9


def test_passes_over_and_under_a_bridge_keep_their_own_heights() -> None:
    """Two roads cross at right angles 6 m apart in height; SLAM has the upper 40 cm too low, the lower 20 cm too high."""
    way = 3.0 * np.arange(-20, 21)
    zero, one = np.zeros(41), np.ones(41)
    source = np.concatenate([np.column_stack([way, zero]), np.column_stack([zero, way])])
    z, lift = np.concatenate([zero + 6.0, zero]), np.concatenate([zero + 0.4, zero - 0.2])
    both = np.concatenate([one, one])
    bend = Bend.level(source, source, 0 * both, both, lift, 0.02 * both, 0.001 * both, 8 * both, source_z_m=z)
    warp = Warp(STILL, None, bend=bend)
    lanes = np.linspace(-3.5, 3.5, 5)
    for road, height, right in ((0, 6.0, 0.4), (1, 0.0, -0.2)):
        xyz = np.array([[a, b, height] for a in np.linspace(-40, 40, 41) for b in lanes])
        if road == 1:
            xyz = xyz[:, [1, 0, 2]]
        wrong = np.abs(warp.apply(xyz)[:, 2] - xyz[:, 2] - right)
        assert wrong.max() < 0.10  # the mean of both passes would be off by 30 cm
        assert np.sqrt((wrong**2).mean()) < 0.05
    top = np.array([[0.0, 0.0, 6.0], [0.0, 0.0, 0.0]])
    assert np.abs(warp.inverse().apply(warp.apply(top)) - top).max() < 1e-8


def test_deviation_of_heights_grows_away_from_the_poses() -> None:
    one = np.ones(40)
    warp = Warp(STILL, None, bend=straight(sigma_up_m=0.05 * one, sigma_tilt_rad=0.002 * one))
    xyz = np.column_stack([np.full(4, 60.0), [0.0, 10.0, 50.0, 400.0], np.full(4, 100.0)])
    sigma = warp.sigma_up_m(xyz)
    assert sigma[0] == pytest.approx(0.05, abs=0.01)
    assert (np.diff(sigma) > 0).all()
    assert sigma[-1] == pytest.approx(0.002 * 400 / np.sqrt(2), rel=0.1)
    assert np.isnan(Warp(STILL, None, bend=straight()).sigma_up_m(xyz)).all()
