"""All that waits for a person, as one table; used by the report and by the layers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.model.arrays import Ints, Strings, strings
from flexmap_tasks.model.conflation import LaneCheck, Matches, Transfers

KINDS = ("value", "match", "lanes", "fragment")


@dataclass(frozen=True, slots=True, eq=False)
class ReviewItems:
    """One row per item, ordered by lanelet, kind and row.

    lanelet_id : (n,) int64; kind : (n,) str, one of KINDS; row : (n,) int64, in the table it stands in, which is the
    transfers for values and fragments, else the matches or the lane check
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


Item = tuple[int, str, int, str, str, str, str]


def review_items(
    matches: Matches | None, transfers: Transfers | None, check: LaneCheck | None
) -> ReviewItems:
    """Matches and values with the decision "review", fragments that nobody took out, and lane counts that differ.

    A lane count that stands in the transfers as well, because it is far off, is one item.
    """
    items: list[Item] = []
    counted: set[int] = set()
    if check is not None:
        rows = np.flatnonzero(check.review)
        counted = set(check.lanelet_id[rows].tolist())
        for row in rows.tolist():
            told = ("lanes", str(check.lanes_map[row]), str(check.lanes_osm[row]), str(check.reason[row]))
            items.append((int(check.lanelet_id[row]), "lanes", row, *told))
    if matches is not None:
        for row in np.flatnonzero(matches.decision == "review").tolist():
            way = int(matches.way_id[row])
            told = ("way", "", str(way) if way else "", str(matches.reason[row]))
            items.append((int(matches.lanelet_id[row]), "match", row, *told))
    items += _of_transfers(transfers, counted) if transfers is not None else []
    items.sort()
    columns: list[list[object]] = [list(c) for c in zip(*items, strict=True)] or [[] for _ in range(7)]
    lanelet, kind, rows_, *texts = columns
    return ReviewItems(
        np.array(lanelet, dtype=np.int64),
        strings(kind),
        np.array(rows_, dtype=np.int64),
        *map(strings, texts),
    )


def _of_transfers(t: Transfers, counted: set[int]) -> list[Item]:
    out: list[Item] = []
    for row in np.flatnonzero(t.action == "review").tolist():
        lanelet, key = int(t.lanelet_id[row]), str(t.key[row])
        if key == "lanes" and lanelet in counted:
            continue
        kind = "fragment" if key == "fragment" else "value"
        out.append((lanelet, kind, row, key or "cut", str(t.old[row]), str(t.new[row]), str(t.reason[row])))
    return out
