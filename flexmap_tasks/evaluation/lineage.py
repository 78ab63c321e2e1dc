"""Which part of which lanelet every lanelet of the finished map is: cuts undone on paper."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexmap_tasks.evaluation.matching_truth import Prediction
from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.conflation import Transfers
from flexmap_tasks.model.lanelets import centrelines, end_nodes, lengths_m
from flexmap_tasks.model.maps import LaneletMap, Lanelets
from flexmap_tasks.model.osm import rows_of


@dataclass(frozen=True, slots=True, eq=False)
class Lineage:
    """Which part of which lanelet of the first map each lanelet of the finished one is.

    source_id : (k,) int64; start, stop : (k,) shares of the source's length
    """

    source_id: Ints
    start: Floats
    stop: Floats


def lineage(finished: LaneletMap, lanelets: Lanelets, transfers: Transfers | None) -> Lineage:
    """Pieces of one source are laid end to end in the order they are driven, each by its share of all lengths."""
    source = lanelets.id.copy()
    if transfers is not None:
        cut = np.flatnonzero(transfers.action == "split")
        row = rows_of(transfers.lanelet_id[cut], lanelets.id)
        source = np.where(row >= 0, transfers.source_lanelet_id[cut][row], source) if len(cut) else source
    length = np.maximum(lengths_m(centrelines(finished, lanelets)), 1e-9)
    start, stop = np.zeros(len(source)), np.ones(len(source))
    ids, group, count = np.unique(source, return_inverse=True, return_counts=True)
    ends = end_nodes(finished, lanelets)
    for several in np.flatnonzero(count > 1).tolist():
        rows = _in_order(np.flatnonzero(group == several), ends)
        share = np.append(0.0, np.cumsum(length[rows])) / length[rows].sum()
        start[rows], stop[rows] = share[:-1], share[1:]
    return Lineage(ids[group], start, stop)


def _in_order(rows: Ints, ends: Ints) -> Ints:
    """Pieces one after the other: each begins at the nodes where the one before ends."""
    follows = {tuple(ends[row, :2].tolist()): row for row in rows.tolist()}
    targets = {tuple(ends[row, 2:].tolist()) for row in rows.tolist()}
    first = [row for row in rows.tolist() if tuple(ends[row, :2].tolist()) not in targets]
    out: list[int] = []
    at: int | None = first[0] if first else int(rows[0])
    while at is not None and at not in out:
        out.append(at)
        at = follows.get(tuple(ends[at, 2:].tolist()))
    return np.array(out + [row for row in rows.tolist() if row not in out], dtype=np.int64)


def onto_sources(prediction: Prediction, lanelets: Lanelets, origin: Lineage) -> Prediction:
    """A prediction about the finished map's lanelets as one about the lanelets they were cut from."""
    row = rows_of(lanelets.id, prediction.lanelet_id)
    start, size = origin.start[row], (origin.stop - origin.start)[row]
    return replace(
        prediction,
        lanelet_id=origin.source_id[row],
        start=start + prediction.start * size,
        stop=start + prediction.stop * size,
    )
