"""A drive without time laid on the GNSS line, around pieces that are known to belong together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import median

from flexmap_tasks.alignment.gnss_line import GnssLine
from flexmap_tasks.alignment.local_motions import LocalMotions
from flexmap_tasks.alignment.outages import continued, guided
from flexmap_tasks.geometry.colinear import Seeds
from flexmap_tasks.geometry.monotone import associate
from flexmap_tasks.geometry.rigid import PlanarFit, fit_planar_motion
from flexmap_tasks.geometry.turns import track_heading
from flexmap_tasks.model.arrays import Bools, Floats, Ints

LINE_M, BAND_M = 1.0, 60.0
"""Spacing of the line's samples, and how far the association may leave what the pieces say."""

MISFITS_M = (20.0, 8.0, 3.0, 1.0, 1.0)
"""Misfit at which a pose counts half, round by round: behind an outage the first guess may be tens of metres off."""

TWIST_NEAR_M = 8.0
"""Poses no further from their place on the line are asked how often they have turned around."""

TRIED, SUPPORT_M = 40, 10.0
"""Stations whose motion is tried for the whole drive, and how near a pose supports one."""

CAUCHY, LEAST_M = 2.385, 0.1
"""Misfit at which a pose counts half in the rigid fit of the whole drive, in usual misfits (Holland and Welsch 1977),
and the least that is usual."""

_FIT_ROUNDS = 20


class Samples(NamedTuple):
    """The line at even spacing."""

    line: GnssLine
    along_m: Floats
    xy_m: Floats
    heading: Floats
    seen: Bools

    @classmethod
    def of(cls, line: GnssLine) -> Samples:
        """Samples of a line."""
        along = np.arange(0.0, line.along_m[-1] + LINE_M / 2, LINE_M)
        return cls(line, along, line.at(along), line.heading_at(along), line.seen_at(along))

    def associated(self, xy_m: Floats, near_m: Floats) -> Ints:
        """The sample of every place (n, 2), within `BAND_M` of an arc length (n,)."""
        lowest = np.minimum.accumulate(near_m[::-1])[::-1] - BAND_M
        first = np.searchsorted(self.along_m, np.clip(lowest, 0.0, self.along_m[-1] - LINE_M))
        width = min(int(2 * BAND_M / LINE_M), len(self.along_m))
        return associate(xy_m, track_heading(xy_m), self.xy_m, self.heading, self.seen, first, width)


class Laid(NamedTuple):
    """A drive laid on a line.

    along_m : (n,) place of every pose; inside : (n,) poses beside the line; moved_m : (m, 2), place : (m,) theirs
    """

    motions: LocalMotions
    samples: Samples
    along_m: Floats
    inside: Bools
    moved_m: Floats
    place: Ints

    def twisted(self) -> float:
        """Share of the poses that have turned once more around than the line, since where most of them have not."""
        place, seen = self.place, self.samples.seen
        near = seen[place] & (np.hypot(*(self.moved_m - self.samples.xy_m[place]).T) < TWIST_NEAR_M)
        if not near.any():
            return 0.0
        off = (np.unwrap(track_heading(self.moved_m)) - np.unwrap(self.samples.heading)[place])[near]
        # nobody knows how often the car turned around in an outage: every run between two has its own beginning
        _, run = np.unique(np.cumsum(~seen)[place[near]], return_inverse=True)
        usual = np.asarray(median(off, run, np.arange(run.max() + 1)))[run]
        return float((np.round((off - usual) / (2 * np.pi)) != 0).mean())


def laid_on(xy_m: Floats, way_m: Floats, samples: Samples, chain: Seeds) -> Laid:
    """The drive around a chain of pieces: local motions and association in turns."""
    end = samples.along_m[-1]
    motions = LocalMotions.of(chain)
    along = guided(motions.apply(xy_m, way_m), way_m, chain.first_m, chain.second_m, samples.line)
    for usual_m in MISFITS_M:
        inside = (along > -BAND_M) & (along < end + BAND_M)
        moved = motions.apply(xy_m[inside], way_m[inside])
        place = samples.associated(moved, along[inside])
        motions = motions.refined(
            xy_m[inside], way_m[inside], samples.xy_m[place], samples.seen[place], usual_m
        )
        along = _beyond(along, inside, samples.along_m[place], way_m, end)
    return Laid(motions, samples, along, inside, moved, place)


def _beyond(along_m: Floats, inside: Bools, found_m: Floats, way_m: Floats, end_m: float) -> Floats:
    """(n,) the arc lengths that were found, those of poses that wait at an end of the line continued beyond it."""
    row = np.flatnonzero(inside)
    on = row[(found_m > 0.0) & (found_m < end_m - LINE_M)]
    if len(on) < 2:
        return along_m
    found = along_m.copy()
    found[row] = found_m
    return continued(way_m, way_m[on], found[on])


def one_motion(xy_m: Floats, found: Laid) -> PlanarFit:
    """The one rigid motion that most of the poses beside the line, (n, 2), agree with: that of a station, refined."""
    samples, motions, place = found.samples, found.motions, found.place
    target = samples.xy_m[place]
    best, fit = -1.0, _motion(motions, 0)
    for k in np.unique(np.linspace(0, len(motions.at_m) - 1, TRIED).astype(np.int64)).tolist():
        tried = _motion(motions, k)
        gap = np.hypot(*(target - xy_m @ tried.rotation.T - tried.translation).T)
        support = float((np.exp(-((gap / SUPPORT_M) ** 2)) * samples.seen[place]).sum())
        if support > best:
            best, fit = support, tried
    seen = np.where(samples.seen[place], 1.0, 1e-6)
    for _ in range(_FIT_ROUNDS):
        gap = np.hypot(*(target - xy_m @ fit.rotation.T - fit.translation).T)
        usual = CAUCHY * max(float(np.median(gap[seen == 1.0])) if (seen == 1.0).any() else 0.0, LEAST_M)
        fit = fit_planar_motion(xy_m, target, seen / (1.0 + (gap / usual) ** 2))
    return fit


def _motion(motions: LocalMotions, k: int) -> PlanarFit:
    """That of one station."""
    turn = np.exp(1j * motions.turn_rad[k])
    shift = motions.target[k] - turn * motions.source[k]
    rotation = np.array([[turn.real, -turn.imag], [turn.imag, turn.real]])
    return PlanarFit(rotation, np.array([shift.real, shift.imag]), 1.0, np.nan)
