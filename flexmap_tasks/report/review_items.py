"""All that waits for a person, as one table; used by the report and by the layers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.model.arrays import Ints, Strings, strings
from flexmap_tasks.model.conflation import LaneCheck, Matches, Transfers


@dataclass(frozen=True, slots=True, eq=False)
class ReviewItems:
    """One row per item, ordered by lanelet, kind and row.

    lanelet_id : (n,) int64; kind : (n,) str, "match", "value" or "lanes", the table it stands in; row : (n,) int64
    subject, have, offer, reason : (n,) str, what it is about, what the map says, what OSM says, and why it is open
    """

    lanelet_id: Ints
    kind: Strings
    row: Ints
    subject: Strings
    have: Strings
    offer: Strings
    reason: Strings

    def __len__(self) -> int:
        return len(self.row)


def review_items(
    matches: Matches | None, transfers: Transfers | None, check: LaneCheck | None
) -> ReviewItems:
    """Matches and values with the decision "review", and lane counts that differ."""
    items: list[tuple[int, str, int, str, str, str, str]] = []
    if matches is not None:
        for row in np.flatnonzero(matches.decision == "review").tolist():
            way = int(matches.way_id[row])
            told = ("way", "", str(way) if way else "", str(matches.reason[row]))
            items.append((int(matches.lanelet_id[row]), "match", row, *told))
    if transfers is not None:
        t = transfers
        for row in np.flatnonzero(t.action == "review").tolist():
            told = (str(t.key[row]) or "cut", str(t.old[row]), str(t.new[row]), str(t.reason[row]))
            items.append((int(t.lanelet_id[row]), "value", row, *told))
    if check is not None:
        for row in np.flatnonzero(check.verdict == "differ").tolist():
            told = ("lanes", str(check.lanes_map[row]), str(check.lanes_osm[row]), str(check.reason[row]))
            items.append((int(check.lanelet_id[row]), "lanes", row, *told))
    items.sort()
    columns: list[list[object]] = [list(c) for c in zip(*items, strict=True)] or [[] for _ in range(7)]
    lanelet, kind, rows, *texts = columns
    return ReviewItems(
        np.array(lanelet, dtype=np.int64), strings(kind), np.array(rows, dtype=np.int64), *map(strings, texts)
    )
