"""Drives with known truth, made of arrays alone: roads of a town, a SLAM that drifts, a GNSS with a lever arm."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from flexmap_tasks.geometry.se2 import rotated
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import GnssTrack, Trajectory

HERE = dataclasses.replace(Projection.at(9.0, 48.0), grid_scale_factor=1.0)
START_NS = 1_700_000_000_000_000_000
LEVER_M = (2.0, 0.5)
OFFSET_S = 0.2
BLOCK_M = 150.0


class Driven(NamedTuple):
    """slam, gnss : as recorded; xyz, along : true place of every pose, and its way since the start."""

    slam: Trajectory
    gnss: GnssTrack
    xyz: np.ndarray
    along: np.ndarray


@dataclass(frozen=True)
class Noise:
    """SLAM: metres and radians over 3 m, metres SLAM is short of; GNSS: white and slow (50 m) metres per axis."""

    place_m: float = 0.01
    yaw_rad: float = 8e-4
    scale: float = 1.003
    up_m: float = 0.02
    white_m: float = 0.02
    slow_m: float = 0.0


class Bias(NamedTuple):
    """GNSS off by a constant between two places of the way."""

    start_m: float
    stop_m: float
    east_m: float
    north_m: float


def town(length_m: float, rng: np.random.Generator) -> np.ndarray:
    """A way over a grid of blocks, never straight back, corners rounded, a vertex every half metre."""
    blocks = int(length_m / BLOCK_M) + 2
    turn = rng.choice([0, 0, 1, -1], blocks)
    heading = np.cumsum(turn) * np.pi / 2
    size = BLOCK_M * np.column_stack([np.cos(heading), np.sin(heading)])
    corners = np.concatenate([[[0, 0]], np.cumsum(size, axis=0)])
    along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    even = np.arange(0, along[-1], 0.5)
    road = np.column_stack([np.interp(even, along, c) for c in corners.T])
    out: np.ndarray = gaussian_filter1d(road, 12, axis=0, mode="nearest")[: int(2 * length_m)]
    return out


def driven(
    length_m: float = 3000.0,
    seed: int = 0,
    noise: Noise = Noise(),
    gaps: tuple[tuple[float, float], ...] = (),
    biases: tuple[Bias, ...] = (),
    slam_s: float = 0.2,
    gnss_s: float = 0.1,
    way: Callable[[float, np.random.Generator], np.ndarray] | None = None,
) -> Driven:
    """One drive at about 9 m/s through a town or along another way; GNSS stamps are `OFFSET_S` early."""
    rng = np.random.default_rng(seed)
    road = (way or town)(length_m, rng)
    arc = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(road, axis=0).T))])
    heading = np.unwrap(np.arctan2(*np.gradient(road, axis=0).T[::-1]))
    time = np.arange(0, arc[-1] / 9.0, 0.1)
    driven_m = np.maximum.accumulate(9.0 * time + 12 * np.sin(time / 6))

    def pose(at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        s = np.clip(np.interp(at, time, driven_m), 0, arc[-1])
        xyz = np.column_stack([*(np.interp(s, arc, c) for c in road.T), 4 * np.sin(s / 250)])
        return xyz, np.interp(s, arc, heading), s

    slam_t = np.arange(0, time[-1] - 1, slam_s)
    xyz, yaw, s = pose(slam_t)
    gnss_t = np.arange(0.53, time[-1] - 2, gnss_s)
    return Driven(
        _slam(xyz, yaw, slam_t, noise, rng), _gnss(*pose(gnss_t), gnss_t, noise, gaps, biases, rng), xyz, s
    )


def _slam(
    xyz: np.ndarray, yaw: np.ndarray, at: np.ndarray, noise: Noise, rng: np.random.Generator
) -> Trajectory:
    step = rotated(np.diff(xyz[:, :2], axis=0), -yaw[:-1])
    root = np.sqrt(np.hypot(*step.T) / 3)[:, None]
    step = step / noise.scale + rng.normal(size=step.shape) * noise.place_m * root
    slip = rng.normal(size=len(step)) * noise.yaw_rad * root[:, 0]
    turn = np.concatenate([[0], np.cumsum(np.diff(yaw) + slip)])
    xy = np.concatenate([[[0, 0]], np.cumsum(rotated(step, turn[:-1]), axis=0)])
    drift = np.concatenate([[0], np.cumsum(rng.normal(size=len(step)) * noise.up_m * root[:, 0])])
    zero = np.zeros(len(turn))
    return Trajectory(
        np.column_stack([xy, xyz[:, 2] + drift - 3.0]),
        np.column_stack([zero, zero, np.sin(turn / 2), np.cos(turn / 2)]),
        START_NS + (at * 1e9).astype(np.int64),
    )


def _gnss(
    body: np.ndarray,
    yaw: np.ndarray,
    along: np.ndarray,
    at: np.ndarray,
    noise: Noise,
    gaps: tuple[tuple[float, float], ...],
    biases: tuple[Bias, ...],
    rng: np.random.Generator,
) -> GnssTrack:
    antenna = body.copy()
    antenna[:, :2] += rotated(np.tile(LEVER_M, (len(body), 1)), yaw)
    white = rng.normal(size=antenna.shape)
    antenna += white * (noise.white_m, noise.white_m, 2 * noise.white_m)
    keep = float(np.exp(-np.median(np.diff(along)) / 50.0))
    drive = rng.normal(size=(len(body), 2)) * noise.slow_m * np.sqrt(1 - keep**2)
    antenna[:, :2] += lfilter([1.0], [1.0, -keep], drive, axis=0)
    for bias in biases:
        antenna[(along > bias.start_m) & (along < bias.stop_m), :2] += (bias.east_m, bias.north_m)
    seen = np.ones(len(body), bool)
    for start, stop in gaps:
        seen &= (along <= start) | (along >= stop)
    kept = np.flatnonzero(seen)
    return GnssTrack(
        antenna[kept], np.full((len(kept), 3), np.nan), np.zeros(len(kept), np.int64), kept,
        np.concatenate([[True], np.diff(kept) == 1]), START_NS + ((at[kept] - OFFSET_S) * 1e9).astype(np.int64),
    )  # fmt: skip


def untimed(drive: Driven) -> Driven:
    """The same drive as text files would have it."""
    return drive._replace(
        slam=dataclasses.replace(drive.slam, stamp_ns=None),
        gnss=dataclasses.replace(drive.gnss, stamp_ns=None),
    )


def rmse(values: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt((values**2).mean()))
