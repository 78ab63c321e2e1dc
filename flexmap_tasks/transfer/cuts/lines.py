"""A bound as a line that can be cut: at a share of its length, best at a vertex it already has."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely

from flexmap_tasks.model.arrays import Floats

VERTEX_M = 0.01
"""A cut this near to a vertex is made at it, whatever else is asked for."""


@dataclass(frozen=True, slots=True)
class Line:
    """A way as a line: (n, 2) vertices and metres along."""

    xy_m: Floats
    along_m: Floats


@dataclass(frozen=True, slots=True)
class WayCut:
    """A cut of a way at a vertex (`t` 0) or between it and the next; `along_m` from the start of the way."""

    vertex: int
    t: float
    along_m: float


def turned(line: Line) -> Line:
    """The line from its end to its start."""
    return Line(line.xy_m[::-1], (line.along_m[-1] - line.along_m)[::-1])


def at_share(line: Line, share: Floats) -> Floats:
    """(n, 2) points at shares of the line's length."""
    at = share * line.along_m[-1]
    return np.stack([np.interp(at, line.along_m, line.xy_m[:, i]) for i in (0, 1)], axis=1)


def place(line: Line, share: float, snap_m: float, end_m: float) -> WayCut:
    """The cut at a share of the line's length, moved to an inner vertex within `snap_m`.

    A vertex nearer than `end_m` to an end is passed over, unless the cut lies on it.
    """
    at = share * float(line.along_m[-1])
    away = np.abs(line.along_m - at)
    clear = np.minimum(line.along_m, line.along_m[-1] - line.along_m) >= end_m
    away[~(clear | (away <= VERTEX_M))] = np.inf
    away[[0, -1]] = np.inf
    inner = int(np.argmin(away))
    if away[inner] <= max(snap_m, VERTEX_M):
        return WayCut(inner, 0.0, float(line.along_m[inner]))
    i = int(np.clip(np.searchsorted(line.along_m, at, side="right") - 1, 0, len(line.along_m) - 2))
    gap = float(line.along_m[i + 1] - line.along_m[i])
    return WayCut(i, (at - float(line.along_m[i])) / gap if gap else 0.5, at)


def own_places(cuts: list[WayCut], line: Line, inverted: bool) -> list[float]:
    """Metres along the lanelet's bound of the cuts of its way."""
    if not inverted:
        return [c.along_m for c in cuts]
    return [float(line.along_m[-1]) - c.along_m for c in reversed(cuts)]


def pieces(line: Line, at: list[float]) -> list[Floats]:
    """The line cut at the given metres."""
    stops = [0.0, *at, float(line.along_m[-1])]
    out = []
    for a, b in pairwise(stops):
        inner = line.along_m[(line.along_m > a) & (line.along_m < b)]
        out.append(at_share(line, np.concatenate([[a], inner, [b]]) / line.along_m[-1]))
    return out


def area(parts: list[Floats]) -> shapely.Polygon:
    """The polygon with these vertices, part after part."""
    return shapely.Polygon(np.concatenate(parts))
