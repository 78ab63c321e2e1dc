"""A start without luck for tracks without time: any rotation, any beginning, partly overlapping tracks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flexmap_tasks.alignment.gnss_line import GnssLine
from flexmap_tasks.alignment.laying import Samples, laid_on, one_motion
from flexmap_tasks.alignment.shape_seeds import EvenTrack, even_track, seeds_between
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.geometry.colinear import Seeds, best_chain
from flexmap_tasks.geometry.polyline import arc_length_m
from flexmap_tasks.geometry.rigid import PlanarFit
from flexmap_tasks.model.arrays import Bools, Floats

APART_M, APART_SHARE = 20.0, 0.04
"""Another hypothesis puts pieces this far from where the best one does, more the further its pieces are away."""

CLEARLY = 1.5
"""One hypothesis is better than another beyond doubt when so many times as much agrees with it."""

TWISTED = 0.05
"""Share of the poses that may have turned around once more than the line beside them, by noise or a wrong fix."""

CHORD_PIECES, CHORD_M, SCALED = 12, 150.0, 0.005
"""Pieces so many further on in the chain and this far away tell the scale; from which deviation on SLAM is scaled."""


class Start(NamedTuple):
    """How a drive without time lies on the GNSS line.

    fit : the one rigid motion that fits the most of it; pose : (n, 3) the poses moved piece by piece
    along_m : (n,) arc length of the line at every pose, beyond its ends where the drive is
    gap_m : (n,) distance from its place on the line; NaN beyond the ends and where nobody saw the line
    distinct_m : way of pieces with a shape of their own that agree with this
    chance_m : the same of the best agreement that is certainly chance; backwards_m : of the drive the other way
    backwards : whether the two tracks run in opposite directions
    """

    fit: PlanarFit
    pose: Floats
    along_m: Floats
    gap_m: Floats
    distinct_m: float
    chance_m: float
    backwards_m: float
    backwards: bool


class _Found(NamedTuple):
    """Alike pieces of SLAM and the line, and the best chain of them with its distinctive way; back : backwards."""

    seeds: Seeds
    distinct_m: float
    chain: Seeds
    back: Seeds
    backwards_m: float
    back_chain: Seeds


def rigid_start(pose: Floats, line: GnssLine) -> Start:
    """Pieces of SLAM and line that look alike, chained in the order of both; then a monotone association around that.

    pose : (n, 3)
    Raises AlignmentError when no piece of one track looks like one of the other.
    """
    gnss, samples = even_track(line.xy_m, line.along_m, line.seen), Samples.of(line)
    found, scale = _found(pose[:, :2], gnss), 1.0
    if not len(found.chain.first_m):
        raise AlignmentError("tracks", _strangers(found.backwards_m))
    wanted = _scale(pose[:, :2], found.chain, gnss)
    if abs(wanted - 1.0) > SCALED:
        scale = wanted
        again = _found(scale * pose[:, :2], gnss)
        found, scale = (again, scale) if again.distinct_m >= found.distinct_m else (found, 1.0)
    xy_m = scale * pose[:, :2]
    way = arc_length_m(xy_m)
    laid = laid_on(xy_m, way, samples, found.chain)
    alike = max(best_chain(s.take(np.abs(s.source - s.target) > APART_M))[0] for s in _alike_on(gnss))
    second = best_chain(found.seeds.take(_elsewhere(found.seeds, found.seeds.first_m, found.chain)))[0]
    third = best_chain(found.back.take(_elsewhere(found.back, way[-1] - found.back.first_m, found.chain)))[0]
    opposite = found.backwards_m > CLEARLY * max(found.distinct_m, alike)
    if not opposite and CLEARLY * found.backwards_m > found.distinct_m:
        # out and back on one road looks alike both ways, but for its turns
        other = laid_on(xy_m[::-1], way[-1] - way[::-1], samples, found.back_chain)
        opposite = laid.twisted() > other.twisted() + TWISTED
    moved = np.column_stack([laid.motions.apply(xy_m, way), pose[:, 2] + laid.motions.turn_at(way)])
    gap = np.hypot(*(line.at(laid.along_m) - moved[:, :2]).T)
    gap[(laid.along_m < 0) | (laid.along_m > line.along_m[-1]) | ~line.seen_at(laid.along_m)] = np.nan
    return Start(
        fit=one_motion(pose[laid.inside, :2], laid),
        pose=moved,
        along_m=laid.along_m,
        gap_m=gap,
        distinct_m=found.distinct_m,
        chance_m=max(alike, second, third),
        backwards_m=found.backwards_m,
        backwards=opposite,
    )


def _found(xy_m: Floats, gnss: EvenTrack) -> _Found:
    slam = even_track(xy_m, arc_length_m(xy_m))
    seeds, back = seeds_between(slam, gnss), seeds_between(slam, gnss, backwards=True)
    (distinct, rows), (backwards, back_rows) = best_chain(seeds), best_chain(back)
    return _Found(seeds, distinct, seeds.take(rows), back, backwards, back.take(back_rows))


def _scale(xy_m: Floats, chain: Seeds, gnss: EvenTrack) -> float:
    """Typical ratio of chords of the line to those of SLAM, (n, 2), between middles of pieces; 1 where too few."""
    slam = even_track(xy_m, arc_length_m(xy_m))
    ends = ((slam, chain.first_m), (gnss, chain.second_m))
    middle = [
        np.interp(along, t.along_m, t.xy.real) + 1j * np.interp(along, t.along_m, t.xy.imag)
        for t, along in ends
    ]
    of_slam, of_line = (np.abs(m[CHORD_PIECES:] - m[:-CHORD_PIECES]) for m in middle)
    far = of_slam > CHORD_M
    return float(np.median(of_line[far] / of_slam[far])) if far.sum() > CHORD_PIECES else 1.0


def _strangers(backwards_m: float) -> str:
    why = "check that both files are of the same drive"
    if backwards_m > 0.0:
        why = "they run in opposite directions"
    return f"SLAM and GNSS do not fit by their shapes: no piece of one looks like a piece of the other; {why}"


def _alike_on(line: EvenTrack) -> tuple[Seeds, Seeds]:
    """Pieces of a line that look like others of it, driven one way and the other."""
    return seeds_between(line, line), seeds_between(line, line, backwards=True)


def _elsewhere(seeds: Seeds, way_m: Floats, chain: Seeds) -> Bools:
    """(k,) seeds that put their piece of SLAM, at ways (k,), elsewhere than the chain does."""
    near = np.clip(np.searchsorted(chain.first_m, way_m), 0, len(chain.first_m) - 1)
    there = chain.target[near] + np.exp(1j * chain.turn_rad[near]) * (seeds.source - chain.source[near])
    apart = np.abs(there - seeds.target)
    out: Bools = apart > APART_M + APART_SHARE * np.abs(way_m - chain.first_m[near])
    return out
