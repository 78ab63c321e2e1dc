"""Reference polylines: runs of the collapsed map from one junction or corner to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.geometry.chains import chains
from flexmap_tasks.geometry.lanelets import gather, offsets
from flexmap_tasks.geometry.segments import Segments, cut
from flexmap_tasks.model.arrays import Bools, Floats, Ints
from flexmap_tasks.model.conflation import Centerlines


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceLines:
    """Reference polylines as rows of segments in walking order.

    offset : (r + 1,) int64 into the segments
    segments : turned so that a to b is the walking direction; `line` is the centreline, and `s_from_m` to
    `s_to_m` run down where the centreline is walked backwards
    start_m : (n,) float64, metres from the start of the reference polyline to a; length_m : (r,) float64
    """

    offset: Ints
    segments: Segments
    start_m: Floats
    length_m: Floats

    def __len__(self) -> int:
        return len(self.length_m)

    @property
    def owner(self) -> Ints:
        """(n,) int64: the reference polyline of every segment."""
        return np.repeat(np.arange(len(self)), np.diff(self.offset))


def reference_lines(
    centerlines: Centerlines, segment_length_m: float, angle_max_deg: float
) -> ReferenceLines:
    """All centrelines as reference polylines of short segments; every segment in exactly one.

    A polyline ends at a node where not exactly two ends meet, and at a corner of at least `angle_max_deg`
    (Zhang and Meng 2005). Whether it ends there is a matter of that place alone, so no order matters.
    """
    segments = cut(centerlines.offset, centerlines.xy_m, segment_length_m)
    run, first, last = _runs(segments, angle_max_deg)
    partner = _joints(centerlines, segments, first, last, angle_max_deg)
    piece_offset, piece, reversed_ = chains(partner)
    count = np.bincount(run, minlength=len(first))
    _, rows = gather(offsets(count), piece, reversed_)
    walked = _turned(segments.take(rows), np.repeat(reversed_, count[piece]))
    offset = offsets(count[piece])[piece_offset]
    length = walked.length_m
    owner = np.repeat(np.arange(len(offset) - 1), np.diff(offset))
    end = np.cumsum(length)
    before = np.append(0.0, end)[offset]
    start = np.append(0.0, end)[: len(length)] - before[owner]
    return ReferenceLines(offset, walked, start, np.diff(before))


def _runs(segments: Segments, angle_max_deg: float) -> tuple[Ints, Ints, Ints]:
    """Segments of one centreline without a corner between them: (run of each segment, first, last row)."""
    direction = segments.direction
    same_line = segments.line[1:] == segments.line[:-1]
    straight = same_line & (_turn_deg(direction[:-1], direction[1:]) < angle_max_deg)
    begins = np.append(True, ~straight)[: len(segments)]
    first = np.flatnonzero(begins)
    return np.cumsum(begins) - 1, first, np.append(first[1:], len(segments))[: len(first)] - 1


def _joints(
    centerlines: Centerlines, segments: Segments, first: Ints, last: Ints, angle_max_deg: float
) -> Ints:
    """Partners of the ends of runs: those where exactly two ends of centrelines meet and run on straight."""
    partner = np.full(2 * len(first), -1, dtype=np.int64)
    line = segments.line
    begins = np.append(True, line[first][1:] != line[first][:-1])[: len(first)]
    ends = np.append(begins[1:], True)[: len(first)]
    vertex = np.stack([centerlines.offset[line[first]], centerlines.offset[line[last] + 1] - 1], axis=1)
    node = np.where(np.stack([begins, ends], axis=1), centerlines.node[vertex], -1).ravel()
    outward = np.stack([-segments.direction[first], segments.direction[last]], axis=1).reshape(-1, 2)
    end = np.flatnonzero(node >= 0)
    order = end[np.argsort(node[end], kind="stable")]
    _, at, count = np.unique(node[order], return_index=True, return_counts=True)
    pair = at[count == 2]
    a, b = order[pair], order[pair + 1] if len(pair) else order[pair]
    straight = _turn_deg(outward[a], -outward[b]) < angle_max_deg
    partner[a[straight]], partner[b[straight]] = b[straight], a[straight]
    return partner


def _turn_deg(before: Floats, after: Floats) -> Floats:
    """Angle between unit vectors, degrees 0 to 180."""
    turn: Floats = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", before, after), -1.0, 1.0)))
    return turn


def _turned(segments: Segments, backwards: Bools) -> Segments:
    flip = backwards[:, None]
    return Segments(
        line=segments.line,
        s_from_m=np.where(backwards, segments.s_to_m, segments.s_from_m),
        s_to_m=np.where(backwards, segments.s_from_m, segments.s_to_m),
        a_m=np.where(flip, segments.b_m, segments.a_m),
        b_m=np.where(flip, segments.a_m, segments.b_m),
        vertex_a=np.where(backwards, segments.vertex_b, segments.vertex_a),
        vertex_b=np.where(backwards, segments.vertex_a, segments.vertex_b),
    )
