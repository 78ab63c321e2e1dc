"""A rigid start without luck: any rotation, any start, partly overlapping tracks."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from flexmap_tasks.alignment.gnss_line import GnssLine
from flexmap_tasks.geometry.monotone import associate
from flexmap_tasks.geometry.polyline import arc_length_m
from flexmap_tasks.geometry.rigid import PlanarFit, fit_planar_motion
from flexmap_tasks.geometry.se2 import rotated, wrapped
from flexmap_tasks.model.arrays import Floats

SAMPLE_M, WINDOW = 5.0, 60
"""Pieces of 300 m are compared: long enough to have a shape, short enough to have little drift."""

NEAR_M, ALIKE_RAD = 10.0, 0.6
"""A pose supports a hypothesis when the line runs this near, in this direction."""

LINE_M = 1.0
"""Spacing of the line's samples in the association."""

CAUCHY_M = 1.0
"""Misfit at which a pose counts half in the rigid fit."""

_ROUNDS = 6


def rigid_start(slam_xy_m: Floats, line: GnssLine) -> tuple[PlanarFit, Floats]:
    """The motion that most of the drive agrees with, and the arc length of the line at every pose.

    Every piece of the SLAM track is laid on every piece of the line by its shape alone; the motion that
    the most poses support wins and is refined with a monotone association of the whole drive.
    slam_xy_m : (n, 2)
    """
    fit = _best_of(_hypotheses(slam_xy_m, line), slam_xy_m, line)
    along = np.arange(0.0, line.along_m[-1] + LINE_M / 2, LINE_M)
    samples, heading, seen = line.at(along), line.heading_at(along), line.seen_at(along)
    for _ in range(_ROUNDS):
        moved = slam_xy_m @ fit.rotation.T + fit.translation
        place = associate(moved, track_heading(moved), samples, heading, seen)
        target = samples[place]
        weight = np.where(seen[place], 1.0, 1e-6)
        for _ in range(5):
            gap = np.hypot(*(target - slam_xy_m @ fit.rotation.T - fit.translation).T)
            fit = fit_planar_motion(slam_xy_m, target, weight / (1.0 + (gap / CAUCHY_M) ** 2))
    return fit, along[place]


def track_heading(xy_m: Floats) -> Floats:
    """(n,) direction of travel by the neighbours of every pose."""
    step = np.gradient(xy_m, axis=0)
    heading: Floats = np.arctan2(step[:, 1], step[:, 0])
    return heading


def _even(xy_m: Floats, along: Floats) -> Floats:
    wanted = np.arange(0.0, along[-1], SAMPLE_M)
    return np.column_stack([np.interp(wanted, along, column) for column in xy_m.T])


def _hypotheses(slam_xy_m: Floats, line: GnssLine) -> list[tuple[float, Floats]]:
    """Angle and translation of every good pair of pieces, by the correlation of their shapes."""
    slam, gnss = _even(slam_xy_m, arc_length_m(slam_xy_m)), _even(line.xy_m, line.along_m)
    window = max(min(WINDOW, len(slam) // 2, len(gnss) // 2), 3)
    a, b = (np.lib.stride_tricks.sliding_window_view(t @ (1, 1j), window) for t in (slam, gnss))
    a = a[:: max(window // 3, 1)]
    mean_a, mean_b = a.mean(axis=1), b.mean(axis=1)
    a, b = a - mean_a[:, None], b - mean_b[:, None]
    product = a.conj() @ b.T
    left = (np.abs(a) ** 2).sum(axis=1)[:, None] + (np.abs(b) ** 2).sum(axis=1) - 2 * np.abs(product)
    out = []
    for k in range(len(a)):
        best = _separate_minima(left[k], window // 4, 4)
        for j in best:
            angle = float(np.angle(product[k, j]))
            shift = mean_b[j] - mean_a[k] * np.exp(1j * angle)
            out.append((angle, np.array([shift.real, shift.imag])))
    return out


def _separate_minima(values: Floats, apart: int, count: int) -> list[int]:
    found: list[int] = []
    for j in np.argsort(values, kind="stable")[: 50 * count].tolist():
        if all(abs(j - other) > apart for other in found):
            found.append(j)
        if len(found) == count:
            break
    return found


def _best_of(hypotheses: list[tuple[float, Floats]], slam_xy_m: Floats, line: GnssLine) -> PlanarFit:
    slam, gnss = _even(slam_xy_m, arc_length_m(slam_xy_m)), _even(line.xy_m, line.along_m)
    tree, gnss_heading, slam_heading = cKDTree(gnss), track_heading(gnss), track_heading(slam)
    best, support = (0.0, np.zeros(2)), -1.0
    for angle, shift in hypotheses:
        gap, near = tree.query(rotated(slam, angle) + shift, distance_upper_bound=5 * NEAR_M)
        reached = np.isfinite(gap)
        turn = wrapped(slam_heading[reached] + angle - gnss_heading[near[reached]])
        score = (np.exp(-((gap[reached] / NEAR_M) ** 2)) * (np.abs(turn) < ALIKE_RAD)).sum()
        if score > support:
            best, support = (angle, shift), float(score)
    c, s = np.cos(best[0]), np.sin(best[0])
    return PlanarFit(np.array([[c, -s], [s, c]]), best[1], 1.0, np.nan)
