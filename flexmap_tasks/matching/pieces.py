"""Decisions along polylines of the collapsed map, written down for the lanelets they stand for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.geometry.lanelets import join
from flexmap_tasks.model.arrays import Bools, Floats, Ints

SHORTEST_PIECE_M = 1e-6
"""A shorter piece is rounding, not road: it goes to its neighbour."""


@dataclass(frozen=True, slots=True, eq=False)
class LinePieces:
    """Parts of centrelines in walking order.

    line : (n,) int64, centreline; from_m, to_m : (n,) float64 along it, running down where walked backwards
    interval : (n,) int64, the decision each part belongs to; share_from, share_to : (n,) float64 of it
    """

    line: Ints
    from_m: Floats
    to_m: Floats
    interval: Ints
    share_from: Floats
    share_to: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Homes:
    """The line every lanelet belongs to, over the line's whole length.

    lanelet_id, line : (k,) int64; backward : (k,) bool, it runs against its line
    line_length_m : (lines,) float64
    """

    lanelet_id: Ints
    line: Ints
    backward: Bools
    line_length_m: Floats


@dataclass(frozen=True, slots=True, eq=False)
class LaneletPieces:
    """Parts of lanelets, each lanelet covered once without gap, ordered by lanelet and place.

    member : (n,) int64, row of the members; s_from_m, s_to_m : (n,) float64 along the lanelet's centreline
    interval : (n,) int64, the decision; share_from, share_to : (n,) float64, the part of it at s_from, s_to
    """

    member: Ints
    s_from_m: Floats
    s_to_m: Floats
    interval: Ints
    share_from: Floats
    share_to: Floats


def line_pieces(
    cuts_m: tuple[Floats, Floats], interval: Ints, walk_m: Floats, line: Ints, s_m: tuple[Floats, Floats]
) -> LinePieces:
    """Decisions laid over centrelines that are walked one after the other.

    cuts_m : (from, to) of every decision on the whole walk, without gap; interval : (n,) its number
    walk_m : (m + 1,) where each stretch of one centreline begins on the walk; line, s_m : (m,) its centreline
    and from-to along it
    """
    edges = np.unique(np.concatenate([cuts_m[0], walk_m]))
    edges = edges[(edges >= walk_m[0]) & (edges <= walk_m[-1])]
    # Edges that differ by rounding only are one; the walk's own stay.
    near = np.append(np.diff(edges) < SHORTEST_PIECE_M, False)
    own = np.isin(edges, walk_m)
    after_near, before_own = np.append(False, near[:-1]), np.append(own[1:], False)
    drop = ~own & (after_near | (near & before_own))
    edges = edges[~drop]
    middle = (edges[:-1] + edges[1:]) / 2
    k = np.clip(np.searchsorted(walk_m, middle, side="right") - 1, 0, len(line) - 1)
    d = np.clip(np.searchsorted(cuts_m[0], middle, side="right") - 1, 0, len(interval) - 1)
    span = walk_m[k + 1] - walk_m[k]
    t = [(e - walk_m[k]) / span for e in (edges[:-1], edges[1:])]
    run = s_m[1] - s_m[0]
    size = cuts_m[1][d] - cuts_m[0][d]
    share = [np.clip((e - cuts_m[0][d]) / size, 0.0, 1.0) for e in (edges[:-1], edges[1:])]
    return LinePieces(line[k], s_m[0][k] + t[0] * run[k],
                      np.where(t[1] >= 1.0, s_m[1][k], s_m[0][k] + t[1] * run[k]),
                      interval[d], share[0], share[1])  # fmt: skip


def lanelet_pieces(home: Homes, pieces: LinePieces, length_m: Floats) -> LaneletPieces:
    """The pieces of every lanelet, by share of the length of the line it belongs to.

    length_m : (k,) float64, length of each lanelet's own centreline. A lanelet whose line carries no piece (it
    has no length) gets one over its whole length with interval -1.
    """
    down = pieces.from_m > pieces.to_m
    low = np.minimum(pieces.from_m, pieces.to_m)
    share_low = np.where(down, pieces.share_to, pieces.share_from)
    share_high = np.where(down, pieces.share_from, pieces.share_to)
    order = np.lexsort((low, pieces.line))
    member, at = join(home.line, pieces.line[order])
    row = order[at]
    back = home.backward[member]
    first, last = _firsts(member)
    total = home.line_length_m[pieces.line[row]]
    f_low = np.where(first, 0.0, low[row] / total)
    # The end of one piece is the start of the next, to the bit.
    f_high = np.where(last, 1.0, np.append(f_low[1:], 1.0)[: len(f_low)])
    length = length_m[member]
    bare = np.setdiff1d(np.arange(len(home.line)), member)
    zero = np.zeros(len(bare))
    found = LaneletPieces(
        np.concatenate([member, bare]),
        np.concatenate([np.where(back, 1.0 - f_high, f_low) * length, zero]),
        np.concatenate([np.where(back, 1.0 - f_low, f_high) * length, length_m[bare]]),
        np.concatenate([pieces.interval[row], np.full(len(bare), -1)]),
        np.concatenate([np.where(back, share_high[row], share_low[row]), zero]),
        np.concatenate([np.where(back, share_low[row], share_high[row]), zero]),
    )
    order = np.lexsort((found.s_from_m, home.lanelet_id[found.member]))
    return LaneletPieces(*(getattr(found, name)[order] for name in LaneletPieces.__slots__))


def _firsts(group: Ints) -> tuple[Bools, Bools]:
    """Whether a row is the first, the last of its group of neighbouring rows."""
    change = group[1:] != group[:-1]
    return np.append(True, change)[: len(group)], np.append(change, True)[: len(group)]
