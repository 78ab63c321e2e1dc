"""The GNSS track as a line that was really driven: standstill and scatter removed, gaps known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flexmap_tasks.geometry.breaks import SHORT_RUN_M
from flexmap_tasks.geometry.polyline import arc_length_m, smooth_through, steps_m
from flexmap_tasks.geometry.se2 import wrapped
from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings, strings
from flexmap_tasks.model.tracks import STATUS_NONE, GnssTrack

SPACING_M = 0.5
"""Fixes nearer than this to the last one kept say nothing new about the way: standstill, or a slow crawl."""

MAX_TURN_RAD_PER_M = 1.0
"""No car turns faster: five times the curvature of a turning circle of 10 m."""

MAX_SIGMA_M = 3.0
"""A fix that calls itself worse than this is left out."""


class GnssLine(NamedTuple):
    """The fixes that were kept, as a line.

    fix : (k,) rows of the GnssTrack; xy_m : (k, 2); along_m : (k,) arc length
    seen : (k,) whether the step to each fix was driven as drawn
    """

    fix: Ints
    xy_m: Floats
    along_m: Floats
    seen: Bools

    def at(self, along_m: Floats) -> Floats:
        """(n, 2) places at arc lengths, smooth through the fixes."""
        return smooth_through(along_m, self.along_m, self.xy_m)

    def heading_at(self, along_m: Floats, reach_m: float = 3.0) -> Floats:
        """(n,) direction of travel at arc lengths, over a step of twice `reach_m`."""
        step = self.at(along_m + reach_m) - self.at(along_m - reach_m)
        heading: Floats = np.arctan2(step[:, 1], step[:, 0])
        return heading

    def seen_at(self, along_m: Floats) -> Bools:
        """(n,) whether arc lengths lie on steps that were observed."""
        step = np.clip(np.searchsorted(self.along_m, along_m, side="left"), 1, len(self.xy_m) - 1)
        return self.seen[step]


def driven_line(gnss: GnssTrack, excluded: Bools | None = None) -> tuple[GnssLine, Strings]:
    """The line through the fixes that can be trusted, and for every fix why it is not on it ("" if it is).

    excluded : (n,) fixes that something else has ruled out; they leave a gap
    """
    reason = _reasons(gnss)
    if excluded is not None:
        reason[excluded & (reason == "")] = "withheld"
    gap_before = ~gnss.observed | (reason != "")
    gaps = np.cumsum(gap_before)
    index = np.flatnonzero(reason == "")
    if len(index) == 0:
        return GnssLine(index, np.empty((0, 2)), np.empty(0), np.empty(0, bool)), reason
    kept = index[_thinned(gnss.xyz_m[index, :2], gaps[index])]
    reason[np.setdiff1d(index, kept)] = "standstill or nearer than the spacing"
    kept = _without_scatter(gnss, kept, gaps, reason)
    kept = _without_short_runs(gnss, kept, gaps, reason)
    xy_m = gnss.xyz_m[kept, :2]
    seen = np.concatenate([[False], np.diff(gaps[kept]) == 0])
    return GnssLine(kept, xy_m, arc_length_m(xy_m), seen), reason


def _reasons(gnss: GnssTrack) -> Strings:
    reason = strings([""] * len(gnss))
    isolated = ~gnss.observed & np.concatenate([~gnss.observed[1:], [True]])
    reason[isolated] = "between two jumps or outages"
    sigma = np.maximum(gnss.sigma_m[:, 0], gnss.sigma_m[:, 1])
    reason[np.isfinite(sigma) & (sigma > MAX_SIGMA_M)] = f"sigma over {MAX_SIGMA_M:g} m"
    reason[gnss.status == STATUS_NONE] = "no fix"
    return reason


def _thinned(xy_m: Floats, gaps: Ints) -> Ints:
    keep, last, run = [0], xy_m[0].tolist(), int(gaps[0])
    for k, ((x, y), gap) in enumerate(zip(xy_m.tolist(), gaps.tolist(), strict=True)):
        if gap != run or (x - last[0]) ** 2 + (y - last[1]) ** 2 >= SPACING_M**2:
            if k:
                keep.append(k)
            last, run = (x, y), gap
    return np.array(keep)


def _without_scatter(gnss: GnssTrack, kept: Ints, gaps: Ints, reason: Strings) -> Ints:
    """Fixes around which the line turns faster than a car can, removed until none is left."""
    for _ in range(5):
        step = np.diff(gnss.xyz_m[kept, :2], axis=0)
        length = np.hypot(step[:, 0], step[:, 1])
        heading = np.arctan2(step[:, 1], step[:, 0])
        turn = np.abs(wrapped(np.diff(heading)))
        inside = np.diff(gaps[kept]) == 0
        wild = (turn > MAX_TURN_RAD_PER_M * np.maximum(length[:-1], length[1:])) & inside[:-1] & inside[1:]
        if not wild.any():
            break
        bad = np.flatnonzero(wild) + 1
        reason[kept[bad]] = "scatter: turns faster than a car"
        kept = np.delete(kept, bad)
    return kept


def _without_short_runs(gnss: GnssTrack, kept: Ints, gaps: Ints, reason: Strings) -> Ints:
    """What is left between two gaps and leads nowhere is scatter around them."""
    _, run = np.unique(gaps[kept], return_inverse=True)
    step = steps_m(gnss.xyz_m[kept, :2])
    length = np.bincount(run, np.concatenate([[0.0], np.where(np.diff(run) == 0, step, 0.0)]))
    short = length < SHORT_RUN_M
    short[[0, -1]] = False
    reason[kept[short[run]]] = "short run between two jumps or outages"
    return kept[~short[run]]
