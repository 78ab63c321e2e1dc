"""Where a drive goes on along the GNSS line behind an outage: by its place, for nobody knows the way in between."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.alignment.gnss_line import GnssLine
from flexmap_tasks.model.arrays import Floats

SHORT_M = 20.0
"""An outage whose chord is shorter needs no look: the association finds it."""

DETOUR, DETOUR_M = 3.0, 300.0
"""The way driven in an outage is so many times its chord at most, and this."""

DRIFT_M, DRIFT_SHARE = 30.0, 0.05
"""How far a pose may be from the place where GNSS is seen again: metres, and share of the way since it was known."""


def continued(way_m: Floats, first_m: Floats, second_m: Floats) -> Floats:
    """(n,) arc length on the line at ways (n,), as far beyond the first and the last pair as was driven."""
    beyond = np.minimum(way_m - first_m[0], 0.0) + np.maximum(way_m - first_m[-1], 0.0)
    out: Floats = np.interp(way_m, first_m, second_m) + beyond
    return out


def guided(moved_m: Floats, way_m: Floats, first_m: Floats, second_m: Floats, line: GnssLine) -> Floats:
    """(n,) arc length on the line at every pose from pairs of ways and arc lengths, and from the edges of outages.

    moved_m : (n, 2) poses in the frame of the line; way_m : (n,); first_m, second_m : (k,) pairs that are known
    """
    step = np.diff(line.along_m)
    rows = np.flatnonzero(~line.seen[1:] & (step > SHORT_M))
    outages = np.column_stack([line.along_m[rows], line.along_m[rows + 1]])
    edge_m = line.xy_m[np.column_stack([rows, rows + 1])]
    pairs = [np.column_stack([first_m, second_m])]
    pairs += _between(moved_m, way_m, pairs[0], outages, edge_m)
    pairs += _beyond(moved_m, way_m, pairs[0], outages, edge_m)
    back = _beyond(moved_m[::-1], -way_m[::-1], -pairs[0][::-1], -outages[::-1, ::-1], edge_m[::-1, ::-1])
    known = np.concatenate([*pairs, *(-p for p in back)])
    known = known[np.lexsort((known[:, 1], known[:, 0]))]
    rising = np.concatenate([[True], np.diff(np.maximum.accumulate(known[:, 1])) > 0])
    return continued(way_m, *known[rising].T)


def _between(moved_m: Floats, way_m: Floats, known: Floats, outages: Floats, edge_m: Floats) -> list[Floats]:
    """Pairs at the edges of outages that lie between two known pairs."""
    after = np.searchsorted(known[:, 1], outages[:, 1])
    before = np.searchsorted(known[:, 1], outages[:, 0], side="right") - 1
    found = []
    for k in np.flatnonzero((before >= 0) & (after < len(known))).tolist():
        low, high = np.searchsorted(way_m, known[[before[k], after[k]], 0])
        if high - low < 2:
            continue
        gap = np.hypot(*(moved_m[low:high, None] - edge_m[k]).transpose(2, 0, 1))
        leaves, returns = way_m[low + gap.argmin(axis=0)]
        if leaves < returns:
            found.append(np.array([[leaves, outages[k, 0]], [returns, outages[k, 1]]]))
    return found


def _beyond(moved_m: Floats, way_m: Floats, known: Floats, outages: Floats, edge_m: Floats) -> list[Floats]:
    """The same for the outages behind the last known pair, one after the other."""
    way, along = known[-1].tolist()
    since, found = way, []
    for k in np.flatnonzero(outages[:, 0] >= along).tolist():
        leaves = way + outages[k, 0] - along
        chord = outages[k, 1] - outages[k, 0]
        low, high = np.searchsorted(way_m, [leaves + 0.9 * chord, leaves + DETOUR * chord + DETOUR_M])
        if high - low < 1:
            break
        gap = np.hypot(*(moved_m[low:high] - edge_m[k, 1]).T)
        returns = float(way_m[low + gap.argmin()])
        if gap.min() > DRIFT_M + DRIFT_SHARE * (returns - since):
            break
        found.append(np.array([[leaves, outages[k, 0]], [returns, outages[k, 1]]]))
        way, along = returns, float(outages[k, 1])
    return found
