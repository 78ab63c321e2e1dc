"""Pieces of lines laid over each other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LEAST = 1e-9
"""Overlaps below this share of their line are rounding."""


class Overlay(NamedTuple):
    """Stretches in which nothing changes, by line and place.

    line : (n,) int64; start, stop : (n,) shares of the line
    first, second : (n,) int64, the row of each table that covers the stretch, -1 where none does
    """

    line: Ints
    start: Floats
    stop: Floats
    first: Ints
    second: Ints


def overlay(lines: int, first: tuple[Ints, Floats, Floats], second: tuple[Ints, Floats, Floats]) -> Overlay:
    """Cut `lines` lines, each of length 1, at every end of a piece.

    first, second : (line, start, stop) of pieces; those of one table do not overlap. Shares are clipped to 0..1
    """
    parts = [
        (line, np.clip(start, 0.0, 1.0), np.clip(stop, 0.0, 1.0)) for line, start, stop in (first, second)
    ]
    ends = [2.0 * line + share for line, start, stop in parts for share in (start, stop)]
    every = np.arange(lines, dtype=np.float64)
    cuts = np.unique(np.concatenate([*ends, 2.0 * every, 2.0 * every + 1.0]))
    low, high = cuts[:-1], cuts[1:]
    line = np.floor(low / 2.0).astype(np.int64)
    keep = (high - low > LEAST) & (high <= 2.0 * line + 1.0)
    low, high, line = low[keep], high[keep], line[keep]
    rows = [_covering((low + high) / 2.0, *part) for part in parts]
    return Overlay(line, low - 2.0 * line, high - 2.0 * line, *rows)


def _covering(place: Floats, line: Ints, start: Floats, stop: Floats) -> Ints:
    """(n,) row of the piece around each place, -1 where there is none."""
    if not len(line):
        return np.full(len(place), -1, dtype=np.int64)
    order = np.lexsort((stop, 2.0 * line + start))
    at = np.searchsorted((2.0 * line + start)[order], place, side="right") - 1
    row = order[np.maximum(at, 0)]
    inside = (at >= 0) & (place < (2.0 * line + stop)[row])
    return np.where(inside, row, -1)
