"""Errors of trajectories, judged by evo."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from flexmap_tasks.errors import InputError
from flexmap_tasks.evaluation.summary import statistics
from flexmap_tasks.evaluation.trajectory_truth import (
    in_step,
    pose_errors,
    relative_errors,
    true_trajectory,
)
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import Trajectory
from flexmap_tasks.model.truth import TruePoses

evo_metrics = pytest.importorskip("evo.core.metrics")
evo_trajectory = pytest.importorskip("evo.core.trajectory")
HERE = Projection.at(11.6, 48.2)


def drive(seed: int, count: int = 60) -> tuple[Trajectory, Trajectory]:
    chance = np.random.default_rng(seed)
    yaw = np.cumsum(chance.normal(0, 0.1, count))
    xyz = np.column_stack(
        [np.cumsum(np.cos(yaw)), np.cumsum(np.sin(yaw)), chance.normal(0, 0.1, count).cumsum()]
    )
    true = Trajectory(xyz, Rotation.from_euler("Z", yaw[:, None]).as_quat(), np.arange(count) * 10**8)
    wobble = Rotation.from_rotvec(chance.normal(0, 0.05, (count, 3)))
    turned = (Rotation.from_quat(true.quaternion) * wobble).as_quat()
    return Trajectory(xyz + chance.normal(0, 0.3, (count, 3)), turned, true.stamp_ns), true


def as_evo(track: Trajectory) -> object:
    return evo_trajectory.PoseTrajectory3D(
        positions_xyz=track.xyz_m, orientations_quat_wxyz=np.roll(track.quaternion, 1, axis=1),
        timestamps=np.asarray(track.stamp_ns) * 1e-9,
    )  # fmt: skip


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 10_000))
def test_absolute_pose_error_is_evos(seed: int) -> None:
    estimate, true = drive(seed)
    judge = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    judge.process_data((as_evo(true), as_evo(estimate)))
    ours = statistics(pose_errors(estimate, true, np.zeros(len(true))).spatial_m)
    for name in ("mean", "std", "rmse", "median", "max"):
        assert ours[name] == pytest.approx(judge.get_all_statistics()[name], abs=1e-9)


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 10_000), st.sampled_from([1, 5, 17]))
def test_relative_pose_error_is_evos(seed: int, every: int) -> None:
    estimate, true = drive(seed)
    shift, turn = relative_errors(estimate, true, every)
    for ours, relation in ((shift, "translation_part"), (turn, "rotation_angle_deg")):
        judge = evo_metrics.RPE(
            evo_metrics.PoseRelation[relation], delta=every, delta_unit=evo_metrics.Unit.frames
        )
        judge.process_data((as_evo(true), as_evo(estimate)))
        assert ours == pytest.approx(judge.error, abs=1e-6)


def poses(count: int) -> TruePoses:
    lonlat = HERE.to_lonlat_deg(np.column_stack([np.arange(count) * 3.0, np.zeros(count)]))
    flags = np.zeros(count, dtype=bool)
    zero = np.zeros(count)
    return TruePoses(np.arange(count) * 10, lonlat, zero + 500, zero, zero, flags, flags, flags)


def test_along_and_across() -> None:
    truth = poses(4)
    true = true_trajectory(truth, HERE)
    assert true.xyz_m == pytest.approx(
        np.column_stack([np.arange(4) * 3.0, np.zeros(4), np.full(4, 500)]), abs=1e-6
    )
    moved = Trajectory(true.xyz_m + np.array([1, 2, -3]), true.quaternion, true.stamp_ns)
    for yaw, along, across in ((0, 1, 2), (np.pi / 2, 2, -1), (np.pi, -1, -2)):
        errors = pose_errors(moved, true, np.full(4, yaw))
        assert errors.along_m == pytest.approx(along)
        assert errors.across_m == pytest.approx(across)
        assert errors.planar_m == pytest.approx(5**0.5)
        assert errors.up_m == pytest.approx(-3)


def test_poses_are_taken_by_stamp_or_by_row() -> None:
    truth = poses(5)
    xyz = np.arange(18.0).reshape(6, 3)
    mixed = Trajectory(xyz, np.tile([0.0, 0, 0, 1], (6, 1)), np.array([40, 30, 99, 20, 10, 0]))
    assert in_step(mixed, truth).xyz_m[:, 0].tolist() == [15, 12, 9, 3, 0]
    plain = Trajectory(xyz[:5], np.tile([0.0, 0, 0, 1], (5, 1)), None)
    assert in_step(plain, truth).xyz_m is not None
    for other in (
        Trajectory(xyz, mixed.quaternion, None),
        Trajectory(xyz, mixed.quaternion, np.arange(6) * 10 + 5),
    ):
        with pytest.raises(InputError, match="truth of this drive"):
            in_step(other, truth)
