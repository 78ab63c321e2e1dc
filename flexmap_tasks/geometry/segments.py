"""Polylines cut into short straight segments, and where a place along a polyline lies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.geometry.lanelets import along_m, offsets

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SHORTEST_M = 1e-6
"""Two vertices nearer than this are one: a segment needs a direction."""


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Straight pieces of polylines, in the order of the polylines.

    line : (n,) int64, polyline; s_from_m, s_to_m : (n,) float64, metres along it
    a_m, b_m : (n, 2) float64, ends; vertex_a, vertex_b : (n,) int64, vertex of the polyline, -1 inside a cut
    """

    line: Ints
    s_from_m: Floats
    s_to_m: Floats
    a_m: Floats
    b_m: Floats
    vertex_a: Ints
    vertex_b: Ints

    def __len__(self) -> int:
        return len(self.line)

    @property
    def length_m(self) -> Floats:
        """(n,) lengths, all above zero."""
        length: Floats = np.hypot(*(self.b_m - self.a_m).T)
        return length

    @property
    def direction(self) -> Floats:
        """(n, 2) unit vectors from a to b."""
        run: Floats = (self.b_m - self.a_m) / self.length_m[:, None]
        return run

    def take(self, rows: Ints) -> Segments:
        """The chosen segments in the given order."""
        return Segments(
            self.line[rows], self.s_from_m[rows], self.s_to_m[rows], self.a_m[rows], self.b_m[rows],
            self.vertex_a[rows], self.vertex_b[rows],
        )  # fmt: skip


def cut(offset: Ints, xy_m: Floats, longest_m: float) -> Segments:
    """All polylines in equal pieces of at most `longest_m` between their vertices.

    A vertex on top of the one before it is passed over, so that no segment is without direction; the vertex
    number of the later one then stands for both.
    """
    line_of = np.repeat(np.arange(len(offset) - 1), np.diff(offset))
    step = np.hypot(*np.diff(xy_m, axis=0, prepend=xy_m[:1]).T)
    keep = step > SHORTEST_M
    keep[offset[:-1][np.diff(offset) > 0]] = True
    vertex = np.flatnonzero(keep)
    drawn = np.append(offset[:-1][np.diff(offset) > 0], offset[-1])
    line, at = line_of[vertex], along_m(drawn, xy_m)[vertex]
    i = np.flatnonzero(line[:-1] == line[1:])
    count = np.maximum(np.ceil((at[i + 1] - at[i]) / longest_m - 1e-9), 1).astype(np.int64)
    start = offsets(count)
    of = np.repeat(np.arange(len(i)), count)
    k = np.arange(start[-1]) - start[of]
    first, last = k == 0, k == count[of] - 1
    t0, t1 = k / count[of], np.where(last, 1.0, (k + 1) / count[of])
    p, q, p_s, q_s = xy_m[vertex[i]][of], xy_m[vertex[i + 1]][of], at[i][of], at[i + 1][of]
    return Segments(
        line=line[i][of],
        s_from_m=p_s + t0 * (q_s - p_s),
        s_to_m=p_s + t1 * (q_s - p_s),
        a_m=_between(p, q, t0),
        b_m=_between(p, q, t1),
        vertex_a=np.where(first, vertex[i][of], -1),
        vertex_b=np.where(last, vertex[i + 1][of], -1),
    )


def project(point_m: Floats, a_m: Floats, b_m: Floats) -> tuple[Floats, Floats]:
    """Nearest place on each segment, pair by pair: (share of the segment 0 to 1, distance in metres)."""
    run = b_m - a_m
    square = np.einsum("ij,ij->i", run, run)
    t = np.einsum("ij,ij->i", point_m - a_m, run)
    t = np.clip(np.divide(t, square, out=np.zeros_like(t), where=square > 0), 0.0, 1.0)
    foot = a_m + t[:, None] * run
    return t, np.hypot(*(point_m - foot).T)


def first_of_groups(*keys: NDArray[Any]) -> Ints:
    """Rows that come first in their group; the first key names the group, the others decide, in this order."""
    order = np.lexsort(keys[::-1])
    group = keys[0][order]
    first: Ints = order[np.append(True, group[1:] != group[:-1])[: len(order)]]
    return first


def least_of_groups(start: Ints, value: Floats) -> Ints:
    """Row of the least value of every group of neighbouring rows, the first of equals.

    start : (k,) int64, first row of every group, none empty
    """
    if not len(start):
        return np.zeros(0, dtype=np.int64)
    group = np.zeros(len(value), dtype=np.int64)
    group[start[1:]] = 1
    group = np.cumsum(group)
    hit = np.flatnonzero(value == np.minimum.reduceat(value, start)[group])
    of = group[hit]
    first: Ints = hit[np.append(True, of[1:] != of[:-1])]
    return first


def running_maximum(value: Floats, group: Ints) -> Floats:
    """Largest value so far within each group of neighbouring rows, by doubling."""
    out, reach = value.copy(), 1
    while reach < len(out) and (group[reach:] == group[:-reach]).any():
        same = group[reach:] == group[:-reach]
        out[reach:] = np.where(same, np.maximum(out[reach:], out[:-reach]), out[reach:])
        reach *= 2
    return out


def _between(p: Floats, q: Floats, t: Floats) -> Floats:
    return np.where((t >= 1.0)[:, None], q, p + t[:, None] * (q - p))
