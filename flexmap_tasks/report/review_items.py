"""All that waits for a person, as one table; used by the report and by the layers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.model.arrays import Ints, Strings, strings
from flexmap_tasks.model.conflation import LaneCheck, Matches, RoadChanges, Transfers
from flexmap_tasks.model.review import ReviewDecisions

CONCERNED = frozenset(
    ("access", "bridge", "bus", "busway", "cycleway", "highway", "junction", "lane_markings", "lanes", "layer",
     "maxspeed", "motor_vehicle", "name", "oneway", "ref", "service", "shoulder", "surface", "tunnel", "turn",
     "vehicle")
)  # fmt: skip
"""Keys, up to the first colon, whose change is worth a person's look; all others stand in the table alone."""

KINDS = ("value", "match", "lanes", "fragment", "change")


@dataclass(frozen=True, slots=True, eq=False)
class ReviewItems:
    """One row per item, ordered by lanelet, kind and row; changes of OSM last.

    lanelet_id : (n,) int64, 0 where the item has none; kind : (n,) str, one of KINDS
    row : (n,) int64, in the transfers for values and fragments, else in matches, lane check or road changes
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
    matches: Matches | None,
    transfers: Transfers | None,
    check: LaneCheck | None,
    changes: RoadChanges | None = None,
    seen: ReviewDecisions | None = None,
) -> ReviewItems:
    """Matches and values with the decision "review", fragments that nobody took out, lane counts that differ, and
    changes of matched roads that concern the map and that nobody has `seen`.

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
    items += sorted(_of_changes(changes, seen)) if changes is not None else []
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


def change_words(changes: RoadChanges) -> tuple[Strings, Strings, Strings]:
    """(n,) what has changed on a way, and from what to what: values of a tag, or versions."""
    tag = changes.kind == "tag"
    old = np.where(tag, changes.old, strings(f"v{v}" if v else "" for v in changes.version_old.tolist()))
    new = np.where(tag, changes.new, strings(f"v{v}" if v else "" for v in changes.version_new.tolist()))
    return np.where(tag, changes.key, changes.kind), old, new


def _of_changes(changes: RoadChanges, seen: ReviewDecisions | None) -> list[Item]:
    known = set() if seen is None else {seen.key_of(d)[1:] for d in range(len(seen))}
    out: list[Item] = []
    words = zip(*(column.tolist() for column in change_words(changes)), strict=True)
    for row, (key, old, new) in enumerate(words):
        way, first = int(changes.way_id[row]), str(changes.lanelets[row]).split(" ", 1)[0]
        concerns = changes.kind[row] != "tag" or str(key).partition(":")[0] in CONCERNED
        if concerns and (way, key, old, new) not in known:
            moved = f", its course by {changes.moved_m[row]:.1f} m" if changes.kind[row] == "geometry" else ""
            reason = f"OSM changed way {way}{moved}"
            out.append((int(first or 0), "change", row, str(key), str(old), str(new), reason))
    return out
