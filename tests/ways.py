"""Ways of many shapes to drive along, and what a recording may have lost of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from scipy.ndimage import gaussian_filter1d

from flexmap_tasks.geometry.se2 import rotated
from flexmap_tasks.model.tracks import GnssTrack, Trajectory
from tests.drives import Driven, driven

Way = Callable[[float, np.random.Generator], np.ndarray]
Track = TypeVar("Track", Trajectory, GnssTrack)
FIRST_FIX_S, FIX_S, POSE_S = 0.53, 0.1, 0.2


def rounded(corners: np.ndarray, length_m: float, radius: float = 12.0) -> np.ndarray:
    """(n, 2) every half metre along straight lines between corners (k, 2), their corners smoothed."""
    along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    even = np.arange(0, along[-1], 0.5)
    road = np.column_stack([np.interp(even, along, c) for c in corners.T])
    return np.asarray(gaussian_filter1d(road, radius, axis=0, mode="nearest")[: int(2 * length_m)])


def irregular(length_m: float, rng: np.random.Generator) -> np.ndarray:
    """Streets of any length that meet at any angle."""
    count = int(length_m / 60) + 2
    heading = np.cumsum(rng.choice([0, 0, 1, -1], count) * rng.uniform(0.3, 1.9, count))
    size = rng.uniform(60, 300, count)[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    return rounded(np.concatenate([[[0, 0]], np.cumsum(size, axis=0)]), length_m)


def winding(length_m: float, rng: np.random.Generator) -> np.ndarray:
    """A country road."""
    heading = np.cumsum(0.06 * gaussian_filter1d(rng.normal(size=int(2 * length_m) + 10), 80))
    return np.cumsum(0.5 * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)[: int(2 * length_m)]


def uneven(length_m: float, rng: np.random.Generator) -> np.ndarray:
    """Turns taken at random in one town whose blocks are 80 to 220 m: drives of other seeds use the same streets."""
    lines = [np.cumsum(np.random.default_rng(99 + k).uniform(80, 220, 60)) for k in (0, 1)]
    place, heading = rng.integers(20, 40, 2), int(rng.integers(0, 4))
    corners, way = [[lines[0][place[0]], lines[1][place[1]]]], 0.0
    while way < length_m + 300:
        turned = (heading + int(rng.choice([0, 0, 1, 3]))) % 4
        ahead = place + np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])[turned]
        if not ((ahead >= 0) & (ahead < 60)).all():
            heading = (heading + 1) % 4
            continue
        place, heading = ahead, turned
        corners.append([lines[0][place[0]], lines[1][place[1]]])
        way += float(np.hypot(*np.subtract(corners[-1], corners[-2])))
    return rounded(np.array(corners, float), length_m)


def out_and_back(length_m: float, rng: np.random.Generator) -> np.ndarray:
    """A country road to its end, a U-turn to the left, and back on the other lane."""
    out = winding(length_m / 2, rng)
    step = np.gradient(out, axis=0)
    ahead = step / np.hypot(*step.T)[:, None]
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    tip = out[-1] + 6 * ahead[-1] + 2 * left[-1]
    return rounded(np.concatenate([out, [tip], (out + 4 * left)[::-1]]), length_m, 4.0)


def laps(length_m: float, _: np.random.Generator) -> np.ndarray:
    """One block, again and again."""
    block = np.array([[0, 0], [180, 0], [220, 140], [60, 200], [-20, 90]], float)
    return rounded(np.tile(block, (int(length_m / 500) + 2, 1)), length_m)


def eight(length_m: float, _: np.random.Generator) -> np.ndarray:
    """A figure of eight whose two rounds differ."""
    t = np.linspace(0, 2 * np.pi, 60)[:-1]
    size = np.where(t < np.pi, 1.0, 1.4)
    corners = size[:, None] * np.column_stack([200 * np.sin(t), 100 * np.sin(2 * t)])
    return rounded(np.tile(corners, (int(length_m / 800) + 2, 1)), length_m)


def straight(length_m: float, _: np.random.Generator) -> np.ndarray:
    """A straight road."""
    return np.arange(0, length_m, 0.5)[:, None] * np.array([0.8, 0.6])


def fix_along_m(drive: Driven) -> np.ndarray:
    """(n,) true way of every fix of a whole drive."""
    at = FIRST_FIX_S + FIX_S * drive.gnss.row
    return np.asarray(np.interp(at, POSE_S * np.arange(len(drive.along)), drive.along))


def rows(track: Track, at: np.ndarray) -> Track:
    """Some rows of a track."""
    columns = {f.name: getattr(track, f.name) for f in dataclasses.fields(track)}
    return type(track)(**{name: None if c is None else c[at] for name, c in columns.items()})


def cut(drive: Driven, slam_m: tuple[float, float], gnss_m: tuple[float, float]) -> Driven:
    """What lies between two places of the way, of either track."""
    pose = np.flatnonzero((drive.along >= slam_m[0]) & (drive.along <= slam_m[1]))
    fix = fix_along_m(drive)
    kept = np.flatnonzero((fix >= gnss_m[0]) & (fix <= gnss_m[1]))
    return Driven(rows(drive.slam, pose), rows(drive.gnss, kept), drive.xyz[pose], drive.along[pose])


def backwards(drive: Driven) -> Driven:
    """The rows of the GNSS file in reverse order."""
    gnss = rows(drive.gnss, np.arange(len(drive.gnss))[::-1])
    observed = np.concatenate([[True], gnss.observed[:-1]])
    return drive._replace(gnss=dataclasses.replace(gnss, observed=observed, row=drive.gnss.row))


def turned(drive: Driven, angle: float, shift_m: tuple[float, float]) -> Driven:
    """SLAM that begins elsewhere and in another direction."""
    slam = drive.slam
    yaw = 2 * np.arctan2(slam.quaternion[:, 2], slam.quaternion[:, 3]) + angle
    zero = np.zeros(len(yaw))
    xy = rotated(slam.xyz_m[:, :2], angle) + shift_m
    turn = np.column_stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)])
    moved = dataclasses.replace(slam, xyz_m=np.column_stack([xy, slam.xyz_m[:, 2]]), quaternion=turn)
    return drive._replace(slam=moved)


def apart(length_m: float, share: float) -> dict[str, tuple[tuple[float, float], tuple[float, float]]]:
    """What SLAM and GNSS have of a way when they share so much of the shorter track."""
    own = length_m / (2 - share)
    start = (1 - share) * length_m / 2
    whole, early, late = (0.0, length_m), (0.0, own), (length_m - own, length_m)
    inner = (start, start + share * length_m)
    return {
        "SLAM early": (early, late),
        "SLAM late": (late, early),
        "SLAM within": (inner, whole),
        "GNSS within": (whole, inner),
    }


def along(way: Way, length_m: float, seed: int, **how: object) -> Driven:
    """A drive along a way."""
    return driven(length_m, seed, way=way, **how)  # type: ignore[arg-type]
