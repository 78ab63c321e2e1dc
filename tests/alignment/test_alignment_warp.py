"""Laws of the warp: hits its points, is undone by its inverse, and is the same in parts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexmap_tasks.alignment.align_track import align_track
from flexmap_tasks.alignment.rubber_sheet import rigid_warp, rubber_sheet
from flexmap_tasks.config import RubberSheetParams
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.geometry.turns import yaw_rad
from flexmap_tasks.model.alignment import ControlPoints, Extent, RigidMotion, Warp
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.tracks import Trajectory

ANGLE = 0.4
MOTION = RigidMotion(
    np.array([[np.cos(ANGLE), -np.sin(ANGLE)], [np.sin(ANGLE), np.cos(ANGLE)]]),
    np.array([100.0, -50.0]),
    1.0003,
    0.99,
    1.0,
)


def track(n: int = 50) -> Trajectory:
    along = np.linspace(0, 2 * np.pi, n)
    xyz = np.column_stack([300 * np.cos(along), 200 * np.sin(along), along])
    heading = np.arctan2(200 * np.cos(along), -300 * np.sin(along))
    return Trajectory(
        xyz, np.column_stack([0 * along, 0 * along, np.sin(heading / 2), np.cos(heading / 2)]), None
    )


def pairs(seed: int, n: int = 12, shift_m: float = 4.0) -> ControlPoints:
    rng = np.random.default_rng(seed)
    cells = rng.permutation(36)[:n]
    source = np.column_stack([cells % 6, cells // 6]) * 90.0 - 270.0 + rng.uniform(-15, 15, (n, 2))
    source = MOTION.apply_xy(source)
    return ControlPoints(
        strings(f"p{k}" for k in range(n)), source, source + rng.uniform(-shift_m, shift_m, (n, 2)),
        np.full(n, 0.1), np.ones(n, bool), strings([""] * n),
    )  # fmt: skip


def sheet(points: ControlPoints) -> Warp:
    return rubber_sheet(points, MOTION, track(), None, None, RubberSheetParams())


def places(seed: int, n: int = 4000, reach: float = 3000.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-reach, reach, (n, 3))


seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_sheet_hits_every_control_point(seed: int) -> None:
    points = pairs(seed)
    source = np.column_stack([MOTION.inverse().apply_xy(points.source_xy_m), np.zeros(len(points))])
    assert np.abs(sheet(points).apply(source)[:, :2] - points.target_xy_m).max() < 1e-9


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_inverse_undoes_everywhere(seed: int) -> None:
    warp, xyz = sheet(pairs(seed)), places(seed)
    assert np.abs(warp.inverse().apply(warp.apply(xyz)) - xyz).max() < 1e-7
    assert np.abs(warp.apply(warp.inverse().apply(xyz)) - xyz).max() < 1e-7


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_order_of_control_points_is_irrelevant(seed: int) -> None:
    points = pairs(seed)
    other = points.take(np.random.default_rng(seed).permutation(len(points)))
    assert np.array_equal(sheet(points).apply(places(seed)), sheet(other).apply(places(seed)))


@settings(max_examples=25, deadline=None)
@given(seeds, st.floats(-900, 900), st.floats(-900, 900), st.floats(1, 600))
def test_restricted_warp_is_the_whole_inside_its_box(seed: int, x: float, y: float, size: float) -> None:
    warp = sheet(pairs(seed))
    part = warp.restrict(Extent(x, y, x + size, y + size))
    inside = np.random.default_rng(seed).uniform(0, size, (500, 3)) + np.array([x, y, 0])
    assert np.array_equal(part.apply(inside), warp.apply(inside))
    assert np.array_equal(part.apply(inside), warp.restrict(Extent(x, y, x + size, y + size)).apply(inside))


def test_moved_point_leaves_far_parts_of_the_warp_as_they_are() -> None:
    points = pairs(7, n=30)
    k = int(points.source_xy_m[:, 0].argmax())
    points.target_xy_m[k] += 0.5
    before, after = sheet(pairs(7, n=30)), sheet(points)
    # the far side of the track, seen from the moved point
    far = MOTION.inverse().apply_xy(points.source_xy_m[[int(points.source_xy_m[:, 0].argmin())]])[0]
    box = Extent(far[0] - 5, far[1] - 5, far[0] + 5, far[1] + 5)
    one, two = before.restrict(box).sheet, after.restrict(box).sheet
    assert one is not None
    assert two is not None
    for name in ("source_xy_m", "target_xy_m", "triangles", "outside_shift_m"):
        assert np.array_equal(getattr(one, name), getattr(two, name))
    near = MOTION.inverse().apply_xy(points.source_xy_m[[k]])[0]
    here = Extent(near[0] - 5, near[1] - 5, near[0] + 5, near[1] + 5)
    changed = before.restrict(here).sheet, after.restrict(here).sheet
    assert not np.array_equal(changed[0].target_xy_m, changed[1].target_xy_m)


@pytest.mark.parametrize("points", [10, 1000, 200_000])
def test_how_many_points_are_moved_at_once_changes_nothing(points: int) -> None:
    warp, xyz = sheet(pairs(3)), places(1, 200_000, 900.0)
    assert np.array_equal(warp.apply(xyz[:points]), warp.apply(xyz)[:points])


def test_warp_is_continuous_across_all_its_edges() -> None:
    warp, xyz = sheet(pairs(5)), places(2, 50_000, 2500.0)
    step = np.random.default_rng(3).normal(size=xyz.shape) * 1e-4
    step[:, 2] = 0
    assert np.abs(warp.apply(xyz + step) - warp.apply(xyz) - step).max() < 2e-4


def test_height_is_kept_and_nan_stays_nan() -> None:
    warp = sheet(pairs(5))
    out = warp.apply(np.array([[np.nan, 1.0, 2.0], [3.0, 4.0, np.nan]]))
    assert np.isnan(out[0, :2]).all()
    assert out[0, 2] == 2.0
    assert np.isfinite(out[1, :2]).all()
    assert np.isnan(out[1, 2])


def test_rigid_warp_is_the_motion() -> None:
    warp, xyz = rigid_warp(MOTION), places(4)
    assert np.array_equal(warp.apply(xyz)[:, :2], MOTION.apply_xy(xyz))
    assert np.abs(warp.inverse().apply(warp.apply(xyz)) - xyz).max() < 1e-9


def test_aligned_track_turns_with_the_plane() -> None:
    slam, warp = track(400), sheet(pairs(11, shift_m=1.0))
    out = align_track(slam, warp)
    assert np.array_equal(out.xyz_m, warp.apply(slam.xyz_m))
    driven = np.diff(out.xyz_m[:, :2], axis=0)
    turn = np.arctan2(driven[:, 1], driven[:, 0]) - yaw_rad(out.quaternion)[:-1]
    assert np.abs((turn + np.pi) % (2 * np.pi) - np.pi).max() < 0.08
    assert np.allclose(np.linalg.norm(out.quaternion, axis=1), 1.0)


def test_folded_sheet_names_its_points() -> None:
    points = pairs(2)
    a, b = 0, int(np.argsort(np.hypot(*(points.source_xy_m - points.source_xy_m[0]).T))[1])
    points.target_xy_m[[a, b]] = points.target_xy_m[[b, a]]
    with pytest.raises(AlignmentError, match=r"fold over.*p\d+") as caught:
        sheet(points)
    assert f"p{a}" in str(caught.value) or f"p{b}" in str(caught.value)


def test_points_that_are_not_used_do_not_count() -> None:
    points = pairs(6)
    points.used[3] = False
    rest = points.take(np.flatnonzero(points.used))
    assert np.array_equal(sheet(points).apply(places(6)), sheet(rest).apply(places(6)))


def test_extent_of_points() -> None:
    assert Extent.of(np.array([[1.0, 2, 9], [np.nan, 5, 9], [-1, 4, 9]])) == Extent(-1, 2, 1, 4)
    assert Extent.of(np.full((3, 3), np.nan)) is None
