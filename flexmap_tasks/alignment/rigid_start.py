"""A rigid start without luck: any rotation, any start, partly overlapping tracks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from flexmap_tasks.alignment.gnss_line import GnssLine
from flexmap_tasks.geometry.monotone import associate
from flexmap_tasks.geometry.polyline import arc_length_m
from flexmap_tasks.geometry.rigid import PlanarFit, fit_planar_motion
from flexmap_tasks.geometry.se2 import rotated, wrapped
from flexmap_tasks.model.arrays import Bools, Floats, Ints

SAMPLE_M, WINDOW = 5.0, 60
"""Pieces of 300 m are compared: long enough to have a shape, short enough to have little drift."""

NEAR_M, ALIKE_RAD = 10.0, 0.6
"""A pose supports a hypothesis when the line runs this near, in this direction."""

LINE_M, COARSE_M, BAND_M = 1.0, 6.0, 60.0
"""Spacing of the line's samples, of the first coarse ones, and how far a second look leaves the first."""

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
    coarse = _Samples.of(line, COARSE_M)
    thin = np.arange(0, len(slam_xy_m), max(int(COARSE_M / max(_spacing(slam_xy_m), 1e-6)), 1))
    for _ in range(2):
        place = coarse.associated(slam_xy_m[thin], fit, None)
        fit = _refined(fit, slam_xy_m[thin], coarse, place)
    fine = _Samples.of(line, LINE_M)
    along = np.interp(np.arange(len(slam_xy_m)), thin, coarse.along_m[place])
    for _ in range(_ROUNDS):
        place = fine.associated(slam_xy_m, fit, along)
        fit, along = _refined(fit, slam_xy_m, fine, place), fine.along_m[place]
    return fit, along


class _Samples(NamedTuple):
    """The line at even spacing."""

    along_m: Floats
    xy_m: Floats
    heading: Floats
    seen: Bools

    @classmethod
    def of(cls, line: GnssLine, spacing_m: float) -> _Samples:
        along = np.arange(0.0, line.along_m[-1] + spacing_m / 2, spacing_m)
        return cls(along, line.at(along), line.heading_at(along), line.seen_at(along))

    def associated(self, slam_xy_m: Floats, fit: PlanarFit, near_m: Floats | None) -> Ints:
        """The sample of every pose; within `BAND_M` of an arc length when one is given."""
        moved = slam_xy_m @ fit.rotation.T + fit.translation
        first, width = None, None
        if near_m is not None:
            lowest = np.minimum(near_m, np.minimum.accumulate(near_m[::-1])[::-1]) - BAND_M
            first = np.searchsorted(self.along_m, np.maximum(lowest, 0.0))
            width = min(int(2 * BAND_M / (self.along_m[1] - self.along_m[0])), len(self.along_m))
        return associate(moved, track_heading(moved), self.xy_m, self.heading, self.seen, first, width)


def _refined(fit: PlanarFit, slam_xy_m: Floats, samples: _Samples, place: Ints) -> PlanarFit:
    """The rigid fit again, every pose weighted by its misfit."""
    target, seen = samples.xy_m[place], np.where(samples.seen[place], 1.0, 1e-6)
    for _ in range(5):
        gap = np.hypot(*(target - slam_xy_m @ fit.rotation.T - fit.translation).T)
        fit = fit_planar_motion(slam_xy_m, target, seen / (1.0 + (gap / CAUCHY_M) ** 2))
    return fit


def _spacing(xy_m: Floats) -> float:
    return float(np.median(np.hypot(*np.diff(xy_m, axis=0).T)))


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
        found = tree.query(rotated(slam, angle) + shift, distance_upper_bound=5 * NEAR_M)
        gap, near = np.asarray(found[0]), np.asarray(found[1])
        reached = np.isfinite(gap)
        turn = wrapped(slam_heading[reached] + angle - gnss_heading[near[reached]])
        score = (np.exp(-((gap[reached] / NEAR_M) ** 2)) * (np.abs(turn) < ALIKE_RAD)).sum()
        if score > support:
            best, support = (angle, shift), float(score)
    c, s = np.cos(best[0]), np.sin(best[0])
    return PlanarFit(np.array([[c, -s], [s, c]]), best[1], 1.0, np.nan)
