"""From matched polylines to way pieces along every reference polyline, without gap or overlap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.geometry.lanelets import gather, offsets
from flexmap_tasks.geometry.segments import first_of_groups, project, running_maximum
from flexmap_tasks.matching.buffers.growing import Grown
from flexmap_tasks.matching.buffers.references import ReferenceLines
from flexmap_tasks.matching.road_segments import RoadSegments
from flexmap_tasks.model.arrays import Floats, Ints


@dataclass(frozen=True, slots=True, eq=False)
class WayIntervals:
    """Parts of reference polylines and the part of a way that answers to each.

    reference : (n,) int64, ascending; from_m, to_m : (n,) float64 along the reference, ascending within one
    way : (n,) int64, row of the way; way_from_m, way_to_m : (n,) float64 along the way at from_m and to_m
    """

    reference: Ints
    from_m: Floats
    to_m: Floats
    way: Ints
    way_from_m: Floats
    way_to_m: Floats


def way_intervals(
    references: ReferenceLines, roads: RoadSegments, grown: Grown, tolerance_m: float
) -> WayIntervals:
    """One interval per way that a matched chain runs along.

    The chain is trimmed to where the reference begins and ends. Where the chain changes from one way to the
    next, the nearest place of the reference is the border. A rest of the reference of up to `tolerance_m`
    before or behind the chain goes to its first or last way, a longer one to none.
    """
    best = grown.best
    owner = np.repeat(np.arange(len(best.first)), best.last - best.first + 1)
    row, way_from, way_to = _trimmed(references, roads, grown, owner)
    way = roads.segments.line[grown.road[row]]
    owner = owner[row]
    n = len(row)
    follows = (owner[1:] == owner[:-1]) & (way[1:] == way[:-1]) & (np.abs(way_from[1:] - way_to[:-1]) < 1e-6)
    begins = np.append(True, ~follows)[:n]
    ends = np.append(begins[1:], True)[:n]
    first, last = np.flatnonzero(begins), np.flatnonzero(ends)
    reference = best.reference[owner[first]]
    length = references.length_m[reference]
    start = np.append(True, reference[1:] != reference[:-1])[: len(first)]
    stop = np.append(start[1:], True)[: len(first)]
    a = _on_reference(references, reference, grown.a_m[row[first]])
    b = _on_reference(references, reference, grown.b_m[row[last]])
    border = np.where(start, np.where(a <= tolerance_m, 0.0, a), a)
    finish = np.where(stop, np.where(length - b <= tolerance_m, length, b), length)
    # The reference never runs backwards: a border behind an earlier one moves up to it.
    border = running_maximum(border, reference)
    to = np.where(stop, np.maximum(finish, border), np.append(border[1:], 0.0)[: len(border)])
    keep = to > border
    return WayIntervals(reference[keep], border[keep], to[keep], way[first][keep],
                        way_from[first][keep], way_to[last][keep])  # fmt: skip


def _trimmed(
    references: ReferenceLines, roads: RoadSegments, grown: Grown, owner: Ints
) -> tuple[Ints, Floats, Floats]:
    """Chain segments between the feet of the reference's ends: (row, metres along the way at a and b)."""
    segments, best = roads.segments, grown.best
    way_from = np.where(grown.against, segments.s_to_m[grown.road], segments.s_from_m[grown.road])
    way_to = np.where(grown.against, segments.s_from_m[grown.road], segments.s_to_m[grown.road])
    row = np.arange(len(owner))
    head = references.segments.a_m[references.offset[:-1]][best.reference]
    tail = references.segments.b_m[references.offset[1:] - 1][best.reference]
    t_head, d_head = project(head[owner], grown.a_m, grown.b_m)
    t_tail, d_tail = project(tail[owner], grown.a_m, grown.b_m)
    at = first_of_groups(owner, np.round(d_head, 9), row)
    to = first_of_groups(owner, np.round(d_tail, 9), -row)
    # A chain that bends back on itself could end before it begins: then it stays whole.
    whole = (at > to) | ((at == to) & (t_head[at] >= t_tail[to]))
    run = way_to - way_from
    trimmed_from, trimmed_to = way_from.copy(), way_to.copy()
    trimmed_from[at[~whole]] += (run * t_head)[at[~whole]]
    trimmed_to[to[~whole]] = (way_from + run * t_tail)[to[~whole]]
    keep = whole[owner] | ((row >= at[owner]) & (row <= to[owner]))
    keep &= trimmed_from != trimmed_to
    return row[keep], trimmed_from[keep], trimmed_to[keep]


def _on_reference(references: ReferenceLines, reference: Ints, point_m: Floats) -> Floats:
    """Metres along its reference polyline of the nearest place to each point."""
    rows = reference
    offset, segment = gather(references.offset, rows, np.zeros(len(rows), dtype=bool))
    owner = np.repeat(np.arange(len(rows)), np.diff(offset))
    t, distance = project(point_m[owner], references.segments.a_m[segment], references.segments.b_m[segment])
    best = first_of_groups(owner, np.round(distance, 9), segment)
    row = segment[best]
    place: Floats = references.start_m[row] + t[best] * references.segments.length_m[row]
    return place


def uncovered(references: ReferenceLines, intervals: WayIntervals) -> tuple[Ints, Floats, Floats]:
    """What no interval covers: (reference, from, to), ordered alike."""
    n = len(references)
    count = np.bincount(intervals.reference, minlength=n)
    at = offsets(count)
    reference = np.repeat(np.arange(n), count + 1)
    place = np.arange(len(reference)) - np.repeat(offsets(count + 1)[:-1], count + 1)
    before, after = at[reference] + place - 1, at[reference] + place
    from_m = np.where(place > 0, np.append(intervals.to_m, 0.0)[before], 0.0)
    last = place == count[reference]
    to_m = np.where(last, references.length_m[reference], np.append(intervals.from_m, 0.0)[after])
    gap = to_m > from_m
    return reference[gap], from_m[gap], to_m[gap]
