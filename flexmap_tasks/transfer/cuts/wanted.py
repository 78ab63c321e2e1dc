"""Where values that land change along a lanelet: the cuts one would like to make."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from flexmap_tasks.config import TransferParams
from flexmap_tasks.model.arrays import Ints
from flexmap_tasks.transfer.facts import LaneletFacts
from flexmap_tasks.transfer.table import Rows

AS_IT_IS = "(as it is)"


@dataclass(frozen=True, slots=True)
class Wanted:
    """A change of values along a lanelet: at `s_m`, told by row `row` of the matches used, with a reason."""

    lanelet: int
    s_m: float
    row: int
    reason: str


def wanted_cuts(
    rows: Rows, landing: Ints, texts: list[list[str]], facts: LaneletFacts, params: TransferParams
) -> list[Wanted]:
    """Changes along each lanelet; `landing` (n, r) codes what each row would write, 0 nothing.

    texts : per column the attribute, then the values by code
    """
    if not len(rows):
        return []
    _, signature = np.unique(landing, axis=0, return_inverse=True)
    signature = signature.ravel()
    first = np.flatnonzero(np.append(True, rows.lanelet[1:] != rows.lanelet[:-1]))
    end = np.append(first[1:], len(rows))
    owner = np.repeat(np.arange(len(first)), end - first)
    differs = np.bincount(owner[signature != signature[first][owner]], minlength=len(first)) > 0
    reach = np.maximum.reduceat(rows.s_to_m, first)
    gap = np.maximum(rows.s_from_m[first], facts.length_m[rows.lanelet[first]] - reach) > params.split_gap_m
    out: list[Wanted] = []
    for i in np.flatnonzero(differs | gap).tolist():
        out += _lanelet_cuts(rows, landing, texts, range(int(first[i]), int(end[i])), facts, params)
    return out


def _lanelet_cuts(
    rows: Rows, landing: Ints, texts: list[list[str]], at: range, facts: LaneletFacts, params: TransferParams
) -> list[Wanted]:
    lanelet = int(rows.lanelet[at[0]])
    length = float(facts.length_m[lanelet])
    runs = [(float(rows.s_from_m[i]), float(rows.s_to_m[i]), tuple(landing[i].tolist()), i) for i in at]
    runs = _without_short(_merged(runs), params.split_stretch_m)
    nothing = (0,) * landing.shape[1]
    if runs[0][0] > params.split_gap_m:
        runs.insert(0, (0.0, runs[0][0], nothing, runs[0][3]))
    if length - runs[-1][1] > params.split_gap_m:
        runs.append((runs[-1][1], length, nothing, runs[-1][3]))
    runs = _merged(runs)
    return [Wanted(lanelet, (a[1] + b[0]) * 0.5, b[3], _change(a[2], b[2], texts)) for a, b in pairwise(runs)]


_Run = tuple[float, float, tuple[int, ...], int]


def _merged(runs: list[_Run]) -> list[_Run]:
    """Neighbouring runs of equal values become one."""
    out = [runs[0]]
    for run in runs[1:]:
        last = out[-1]
        if run[2] == last[2]:
            out[-1] = (last[0], max(last[1], run[1]), last[2], last[3])
        else:
            out.append(run)
    return out


def _without_short(runs: list[_Run], least_m: float) -> list[_Run]:
    """Runs shorter than `least_m` left out, the shortest first; one always stays."""
    while len(runs) > 1:
        i = min(range(len(runs)), key=lambda k: (runs[k][1] - runs[k][0], k))
        if runs[i][1] - runs[i][0] >= least_m:
            break
        runs = _merged(runs[:i] + runs[i + 1 :])
    return runs


def _change(a: tuple[int, ...], b: tuple[int, ...], texts: list[list[str]]) -> str:
    """Which values change, in words."""
    parts = [
        f"{texts[j][0]} {texts[j][x + 1] or AS_IT_IS} | {texts[j][y + 1] or AS_IT_IS}"
        for j, (x, y) in enumerate(zip(a, b, strict=True))
        if x != y
    ]
    return "; ".join(parts)
