"""Drives of `tests.drives` with a third dimension of known truth: hills, a SLAM that tilts, altitudes with faults."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from flexmap_tasks.geometry.turns import yaw_rad
from tests.drives import LEVER_M, OFFSET_S, START_NS, Driven


@dataclass(frozen=True)
class Up:
    """hill_m : standard deviation of heights, over about `hill_length_m`

    SLAM: tilt_rad : whole frame, about x and y; walk_rad : roll and pitch drift over 3 m; up_m : height over 3 m;
    level_rad : roll and pitch that gravity holds, wandering over 50 m, instead of a drift
    altitudes: white_m, slow_m (over 400 m), lever_up_m; steps : (start, stop, metres) off as a whole
    gaps : (start, stop) without; resolution_m : rounded to; stated : whether sigmas are given
    """

    hill_m: float = 8.0
    hill_length_m: float = 300.0
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    walk_rad: float = 2e-4
    up_m: float = 0.01
    level_rad: float = 0.0
    white_m: float = 0.03
    slow_m: float = 0.0
    lever_up_m: float = 1.4
    steps: tuple[tuple[float, float, float], ...] = ()
    gaps: tuple[tuple[float, float], ...] = ()
    outliers: float = 0.0
    resolution_m: float = 0.0
    stated: bool = False
    slam_jumps: tuple[tuple[float, float], ...] = field(default=())


def climbed(drive: Driven, up: Up, seed: int = 0, base_m: float = 480.0) -> Driven:
    """The drive over hills. Its truth holds for the poses; the way is that of the plane."""
    rng = np.random.default_rng(seed + 2000)
    along, road = _road(drive, up, seed, base_m)
    slope = np.gradient(road, along)
    rise, z = np.interp(drive.along, along, slope), np.interp(drive.along, along, road)
    yaw = yaw_rad(drive.slam.quaternion)
    xyz = np.column_stack([drive.xyz[:, :2], z])

    step = np.diff(drive.slam.xyz_m[:, :2], axis=0)
    root = np.sqrt(np.hypot(*step.T) / 3)
    tilt = _tilt(up, root, np.hypot(*step.T), rng)  # slope that SLAM has too much, along its own axes
    middle = (tilt[1:] + tilt[:-1]) / 2
    dz = np.diff(z) + (middle * step).sum(axis=1) + rng.normal(size=len(step)) * up.up_m * root
    slam_z = np.concatenate([[0.0], np.cumsum(dz)])
    for at, jump in up.slam_jumps:
        slam_z[drive.along > at] += jump
    pitch = -np.arctan(rise)
    true_in_slam = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, 0 * yaw]))
    off = Rotation.from_rotvec(np.column_stack([tilt[:, 1], -tilt[:, 0], 0 * yaw]))
    slam = dataclasses.replace(
        drive.slam, xyz_m=np.column_stack([drive.slam.xyz_m[:, :2], slam_z]), quaternion=(off * true_in_slam).as_quat()
    )  # fmt: skip
    return drive._replace(slam=slam, xyz=xyz, gnss=_altitudes(drive, up, along, road, slope, rng))


def ground_m(xy: np.ndarray, up: Up, seed: int = 0, base_m: float = 480.0) -> np.ndarray:
    """(n,) true height of (n, 2) places: that of a road does not depend on when it is driven."""
    rng = np.random.default_rng(seed + 1000)
    wave, phase = rng.normal(size=(200, 2)) / up.hill_length_m, rng.uniform(0, 2 * np.pi, 200)
    waves = (np.cos(xy @ w + p) for w, p in zip(wave, phase, strict=True))
    return np.asarray(base_m + sum(waves) * np.sqrt(2 / 200) * up.hill_m)


def _road(drive: Driven, up: Up, seed: int, base_m: float) -> tuple[np.ndarray, np.ndarray]:
    along = np.arange(0.0, drive.along[-1] + 1.0, 1.0)
    keep = np.concatenate([[True], np.diff(drive.along) > 0])
    xy = np.column_stack([np.interp(along, drive.along[keep], drive.xyz[keep, k]) for k in (0, 1)])
    return along, ground_m(xy, up, seed, base_m)


def _tilt(up: Up, root: np.ndarray, step: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    if up.level_rad:
        keep = np.exp(-np.median(step) / 50.0)
        noise = rng.normal(size=(len(step) + 1, 2)) * up.level_rad * np.sqrt(1 - keep**2)
        return np.array(up.tilt_rad) + lfilter([1.0], [1.0, -keep], noise, axis=0)
    walk = np.cumsum(rng.normal(size=(len(step), 2)) * up.walk_rad * root[:, None], axis=0)
    return np.array(up.tilt_rad) + np.concatenate([[[0.0, 0.0]], walk])


def _altitudes(drive, up, along, road, slope, rng):
    gnss = drive.gnss
    at = (gnss.stamp_ns - START_NS) * 1e-9 + OFFSET_S
    s = np.interp(at, (drive.slam.stamp_ns - START_NS) * 1e-9, drive.along)
    rise = np.interp(s, along, slope)
    level = 1 / np.sqrt(1 + rise**2)
    z = np.interp(s, along, road) + LEVER_M[0] * rise * level + up.lever_up_m * level
    keep = float(np.exp(-np.median(np.diff(s)) / 400.0))
    slow = lfilter([1.0], [1.0, -keep], rng.normal(size=len(s)) * np.sqrt(1 - keep**2)) * up.slow_m
    z = z + slow + rng.normal(size=len(s)) * up.white_m
    wild = rng.uniform(size=len(s)) < up.outliers
    z[wild] += rng.normal(size=int(wild.sum())) * 8.0
    for start, stop, off in up.steps:
        z[(s >= start) & (s < stop)] += off
    if up.resolution_m:
        z = np.round(z / up.resolution_m) * up.resolution_m
    for start, stop in up.gaps:
        z[(s >= start) & (s < stop)] = np.nan
    sigma = gnss.sigma_m.copy()
    if up.stated:
        sigma[:, 2] = np.hypot(up.white_m, up.slow_m)
    return dataclasses.replace(gnss, xyz_m=np.column_stack([gnss.xyz_m[:, :2], z]), sigma_m=sigma)
