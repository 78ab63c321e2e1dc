"""Places along many polylines at once."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.geometry.lanelets import along_m, lengths_m
from flexmap_tasks.model.arrays import Floats, Ints

STEP_M = 1.0
"""Laid between two polylines, so that the end of one and the start of the next are told apart."""


def places_along(offset: Ints, xy_m: Floats, line: Ints, s_m: Floats) -> Floats:
    """(n, 2) the place `s_m[i]` metres along polyline `line[i]`; clipped to its ends, NaN where `line` is -1.

    offset : (k + 1,) int64, polylines of at least one vertex each; xy_m : (m, 2 or more) float64
    """
    if len(offset) < 2 or not len(line):
        return np.full((len(line), 2), np.nan)
    length = lengths_m(offset, xy_m)
    base = np.concatenate([[0.0], np.cumsum(length + STEP_M)])
    reach = along_m(offset, xy_m) + np.repeat(base[:-1], np.diff(offset))
    wanted = base[line] + np.clip(s_m, 0.0, length[line])
    found = np.column_stack([np.interp(wanted, reach, xy_m[:, i]) for i in (0, 1)])
    found[(line < 0) | ~np.isfinite(s_m)] = np.nan
    return found
