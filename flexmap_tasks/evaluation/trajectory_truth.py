"""Error of a trajectory against the truth: absolute and relative pose error, along and across the track."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from flexmap_tasks.errors import InputError
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import Trajectory
from flexmap_tasks.model.truth import TruePoses


@dataclass(frozen=True, slots=True, eq=False)
class PoseErrors:
    """Errors of n poses in metres, estimate minus truth.

    along_m, across_m : (n,) in the true direction of driving and to its left; up_m : (n,)
    """

    along_m: Floats
    across_m: Floats
    up_m: Floats

    @property
    def planar_m(self) -> Floats:
        """(n,) distance in the plane."""
        return np.hypot(self.along_m, self.across_m)

    @property
    def spatial_m(self) -> Floats:
        """(n,) distance in space: the absolute pose error without any alignment."""
        return np.sqrt(self.along_m**2 + self.across_m**2 + self.up_m**2)


def true_trajectory(truth: TruePoses, projection: Projection) -> Trajectory:
    """The true poses in the map frame; yaw and pitch as the truth has them, no roll."""
    xyz_m = np.column_stack([projection.to_xy_m(truth.lonlat_deg), truth.ele_m])
    angles = np.column_stack([truth.yaw_rad, truth.pitch_rad, np.zeros(len(truth))])
    return Trajectory(xyz_m, Rotation.from_euler("ZYX", angles).as_quat(), truth.stamp_ns)


def in_step(estimate: Trajectory, truth: TruePoses) -> Trajectory:
    """The estimated poses that the truth knows, in its order: by stamp, or by row where there are none.

    Raises InputError when the two are not of one recording.
    """
    if estimate.stamp_ns is None:
        rows = np.arange(len(truth))
        fits = len(estimate) == len(truth)
    else:
        order = np.argsort(estimate.stamp_ns, kind="stable")
        at = np.searchsorted(estimate.stamp_ns[order], truth.stamp_ns)
        rows = order[np.minimum(at, len(order) - 1)] if len(order) else np.zeros(len(truth), dtype=np.int64)
        fits = bool(len(order)) and bool((estimate.stamp_ns[rows] == truth.stamp_ns).all())
    if not fits:
        rule = f"its {len(truth)} poses are not the {len(estimate)} of the trajectory; give the truth of this drive"
        raise InputError("truth", rule)
    return Trajectory(estimate.xyz_m[rows], estimate.quaternion[rows], truth.stamp_ns)


def pose_errors(estimate: Trajectory, truth: Trajectory, yaw_rad: Floats) -> PoseErrors:
    """Errors of poses in step with the truth; yaw_rad (n,) is the true direction of driving."""
    gap = estimate.xyz_m - truth.xyz_m
    ahead, left = np.cos(yaw_rad), np.sin(yaw_rad)
    return PoseErrors(gap[:, 0] * ahead + gap[:, 1] * left, gap[:, 1] * ahead - gap[:, 0] * left, gap[:, 2])


def relative_errors(estimate: Trajectory, truth: Trajectory, every: int) -> tuple[Floats, Floats]:
    """Relative pose error over steps of `every` poses, one after the other: metres and degrees.

    E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j) with truth Q and estimate P (Sturm et al. 2012, eq. 2).
    """
    i = np.arange(0, len(truth) - every, every)
    j = i + every
    turn, shift = zip(*(_step(track, i, j) for track in (truth, estimate)), strict=True)
    back = turn[0].inv()
    return np.linalg.norm(back.apply(shift[1] - shift[0]), axis=1), np.degrees((back * turn[1]).magnitude())


def _step(track: Trajectory, i: np.ndarray, j: np.ndarray) -> tuple[Rotation, Floats]:
    """Rotation and translation from pose i to pose j, in the body frame of i."""
    start = Rotation.from_quat(track.quaternion[i])
    shift: Floats = start.inv().apply(track.xyz_m[j] - track.xyz_m[i])
    return start.inv() * Rotation.from_quat(track.quaternion[j]), shift
