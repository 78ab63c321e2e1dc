"""Whether shapes alone say that two tracks are of one drive: a wrong alignment is worse than none."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flexmap_tasks.alignment.gnss_line import GnssLine
from flexmap_tasks.alignment.rigid_start import Start
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.geometry.polyline import arc_length_m
from flexmap_tasks.model.arrays import Floats

NEAR_M = 5.0
"""A pose runs along the line when it is this near after the start, whose lever arm is not yet known."""

LOOSE_END_M = 20.0
"""Where the common way begins, at least one track begins, and so at its end: but for this way of noise."""

MIN_ALONG = 0.9
"""Share of the common way, where GNSS was seen, on which the tracks run along each other."""

WHOLE_SHARE = 0.05
"""Tracks whose ends lie no further apart than this share of the longer begin and end together, as no others do."""

SURE, MIN_DISTINCT_M = 1.75, 200.0
"""Else the way that agrees by its shape must be so many times the longest that agrees by chance, and this at least.

Of 160 pairs of drives through towns of one grid and on winding roads one pair shared a way 1.6 times that of chance.
"""


class Overlap(NamedTuple):
    """The way that two tracks have in common, in metres.

    before_m, after_m : (2,) way of SLAM, and of GNSS where it was seen, before and after the common way
    common_m : way on which they run along each other; along : its share of the way between its ends
    longer_m : length of the longer track, GNSS where it was seen
    """

    before_m: Floats
    after_m: Floats
    common_m: float
    along: float
    longer_m: float

    @property
    def loose_m(self) -> float:
        """The longer of the ways for which both tracks go on apart, before the common way or after it."""
        return float(max(self.before_m.min(), self.after_m.min()))

    @property
    def whole(self) -> bool:
        """Whether the tracks begin and end together."""
        return float(max(self.before_m.max(), self.after_m.max())) <= WHOLE_SHARE * self.longer_m


def overlap_of(start: Start, slam_xy_m: Floats, line: GnssLine) -> Overlap:
    """What SLAM, (n, 2) places in its own frame, and the line share under a start."""
    way = arc_length_m(slam_xy_m)
    step = np.diff(line.along_m, prepend=0.0)
    seen = np.cumsum(np.where(line.seen, step, 0.0))
    near = np.flatnonzero(start.gap_m < NEAR_M)
    length = np.array([way[-1], seen[-1]])
    if not len(near):
        return Overlap(length, length, 0.0, 0.0, float(length.max()))
    first, last = near[0], near[-1]
    place = np.interp(start.along_m[[first, last]], line.along_m, seen)
    own, inside = np.gradient(way), slice(first, last + 1)
    known = np.isfinite(start.gap_m[inside])
    common = float(own[near].sum())
    return Overlap(
        before_m=np.array([way[first], place[0]]),
        after_m=np.array([way[-1] - way[last], seen[-1] - place[1]]),
        common_m=common,
        along=common / float(own[inside][known].sum()),
        longer_m=float(length.max()),
    )


def refuse_other_shape(start: Start, slam_xy_m: Floats, line: GnssLine) -> None:
    """Raises AlignmentError when the tracks need not be of one drive, or not there: each with one clear line.

    slam_xy_m : (n, 2)
    """
    shared = overlap_of(start, slam_xy_m, line)
    fault = _fault(start, shared)
    if fault:
        raise AlignmentError("tracks", fault)


def _fault(start: Start, shared: Overlap) -> str:
    """What is wrong, "" for nothing."""
    if start.backwards:
        return (
            f"SLAM and GNSS run in opposite directions: {start.backwards_m:.0f} m agree by their shape when one is "
            f"driven backwards, {start.distinct_m:.0f} m as they are; put the rows of the wrong file in the order of "
            "the drive"
        )
    if start.distinct_m < MIN_DISTINCT_M and not shared.whole:
        return (
            "SLAM and GNSS do not say where along its way the drive lies: they share only "
            f"{start.distinct_m:.0f} m with a shape of their own, {MIN_DISTINCT_M:.0f} m are needed; drive at least "
            "one turn, or give both time stamps"
        )
    if shared.loose_m > LOOSE_END_M or shared.along < MIN_ALONG:
        return (
            f"SLAM and GNSS do not fit by their shapes: only {shared.common_m:.0f} m run along each other "
            f"({shared.along:.0%} of the way between), then they part though both go on for {shared.loose_m:.0f} m; "
            "check that both files are of the same drive, or give both time stamps"
        )
    if start.distinct_m < SURE * start.chance_m and not shared.whole:
        return (
            f"SLAM and GNSS share too little to be sure by their shapes: {start.distinct_m:.0f} m agree, but "
            f"{start.chance_m:.0f} m of other places look alike too, and {SURE:g} times that is needed; take a "
            "longer common part, or give both time stamps"
        )
    return ""
