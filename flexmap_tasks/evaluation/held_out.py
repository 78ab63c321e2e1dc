"""Accuracy on real data without truth: GNSS that was withheld from the alignment judges it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from flexmap_tasks.config import HeldOutParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import InputError
from flexmap_tasks.evaluation.summary import measures_of
from flexmap_tasks.geometry.polyline import arc_length_m, steps_m
from flexmap_tasks.geometry.same_pass import headings_rad, nearest_on_same_pass
from flexmap_tasks.model.arrays import Bools, Floats
from flexmap_tasks.model.quality import Measure, Quality
from flexmap_tasks.model.tracks import GnssTrack, Trajectory

REACH_M = 30.0
"""A pose further from the withheld track was not aligned at all, and counts as that far off."""
WINDOW_M, WINDOW_SHARE = 100.0, 0.03
"""How far apart the two tracks may be in distance driven: scatter, outages and scale add up."""
TURN_RAD = np.pi / 3
HEADING_REACH_M = 3.0
CLOSE_M = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Withheld:
    """A GNSS track in two: what the alignment may see, and what it is judged by."""

    kept: GnssTrack
    judge: GnssTrack


@stage("withheld")
def withhold(gnss: GnssTrack, params: HeldOutParams) -> Withheld:
    """Cut the track into blocks of `block_m` and withhold every `every`-th, from block `fold` on.

    In `kept` the step over a withheld block is not observed. `judge` is the whole track with only the steps inside
    of withheld blocks observed.

    Raises InputError when the track is too short for a withheld block or nothing would be left.
    """
    block = (_driven(gnss) // params.block_m).astype(np.int64)
    withheld = block % params.every == params.fold
    if not withheld.any() or (~withheld).sum() < 3:
        rule = (
            f"the track has no block {params.fold} of {params.block_m:g} m to withhold; choose shorter blocks"
        )
        raise InputError("GNSS", rule)
    inside = withheld & np.append(False, withheld[:-1]) & gnss.observed
    kept = np.flatnonzero(~withheld)
    crosses = np.append(False, np.diff(kept) > 1)
    return Withheld(
        replace(_take(gnss, ~withheld), observed=gnss.observed[kept] & ~crosses),
        replace(gnss, observed=inside),
    )


@stage("held_out")
def held_out_error(aligned: Trajectory, withheld: Withheld, params: HeldOutParams) -> Quality:
    """Distance of poses to the withheld track on the same pass.

    aligned : where the alignment, made from `withheld.kept` alone, sees the antenna
    """
    distance = withheld_distance_m(aligned, withheld.judge)
    name = f"held_out_{params.block_m:g}m"
    return Quality(tuple(_figures(name, distance)))


def withheld_distance_m(aligned: Trajectory, judge: GnssTrack) -> Floats:
    """(k,) distance of the poses on withheld blocks, metres; a pose out of reach counts as REACH_M.

    Which pose lies on which block is told by stamps where both have them, else by the distance driven.
    """
    line = judge.xyz_m[:, :2]
    driven, xy = _driven(judge), aligned.xyz_m[:, :2]
    if aligned.stamp_ns is not None and judge.stamp_ns is not None:
        place = np.interp(aligned.stamp_ns, judge.stamp_ns, driven)
    else:
        along = arc_length_m(xy)
        place = along * (driven[-1] / along[-1] if along[-1] > 0 else 1.0)
    poses = (xy, place, headings_rad(xy, _ascending(xy), HEADING_REACH_M))
    vertices = (line, driven, headings_rad(line, _ascending(line), HEADING_REACH_M))
    window = WINDOW_M + WINDOW_SHARE * float(driven[-1])
    everywhere = np.ones(len(line) - 1, dtype=bool)
    whole, segment = nearest_on_same_pass(poses, vertices, everywhere, REACH_M, window, TURN_RAD)
    on_block = _inner(judge.observed[1:], segment)
    lost = (segment < 0) & _inner(judge.observed[1:], np.searchsorted(driven, place) - 1)
    return np.concatenate([whole[on_block], np.full(int(lost.sum()), REACH_M)])


def _figures(name: str, distance: Floats) -> Iterator[Measure]:
    yield Measure(f"{name}_poses", float(len(distance)), "count")
    yield from measures_of(name, distance)
    close = float((distance < CLOSE_M).mean()) if len(distance) else None
    yield Measure(f"{name}_within_20cm", close, "1")


def _inner(withheld: Bools, segment: np.ndarray) -> Bools:
    """The segment is withheld and exists."""
    inside: Bools = np.append(withheld, False)[np.clip(segment, -1, len(withheld))] & (segment >= 0)
    return inside


def _driven(gnss: GnssTrack) -> Floats:
    """(n,) metres driven to each fix; scatter in an outage counts as the straight way across."""
    step = steps_m(gnss.xyz_m[:, :2])
    return np.concatenate([[0.0], np.cumsum(step)])


def _ascending(xy: Floats) -> Floats:
    """Metres along a line, strictly growing."""
    return arc_length_m(xy) + 1e-9 * np.arange(len(xy))


def _take(gnss: GnssTrack, rows: Bools) -> GnssTrack:
    stamp = None if gnss.stamp_ns is None else gnss.stamp_ns[rows]
    return GnssTrack(
        gnss.xyz_m[rows], gnss.sigma_m[rows], gnss.status[rows], gnss.row[rows], gnss.observed[rows], stamp
    )
