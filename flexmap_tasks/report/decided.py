"""What people decided, and whether it still holds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flexmap_tasks.model.conflation import LaneCheck, Matches, RoadChanges, Transfers
from flexmap_tasks.model.review import Decided, ReviewDecisions
from flexmap_tasks.model.shown import Shown
from flexmap_tasks.report.review_items import change_words

BY = "by a person"
"""Stands in every reason that a decision gave."""


def decided_rows(decided: Decided | None, shown: Shown) -> list[dict[str, Any]]:
    """The decisions as the page knows them; `holds` is false where one met no row, for its ground has changed."""
    if decided is None:
        return []
    tables = (decided.values, decided.matches, decided.lanes, decided.fragments, decided.changes)
    settled = _settled(shown.matches, shown.transfers, shown.lane_check) | _changed(shown.changes)
    return [
        {**decision_row(table, d), "holds": _ground(table, d) in settled}
        for table in tables
        for d in range(len(table))
    ]


def decision_row(table: ReviewDecisions, d: int) -> dict[str, Any]:
    """One decision by the names of the file's columns, all of it text."""
    text = {
        name: str(getattr(table, name)[d]) for name in ("kind", "lanelet_id", "way_id", "key", "old", "new")
    }
    told = {name: str(getattr(table, name)[d]) for name in ("value", "note", "who", "when")}
    along = {name: _metres(float(getattr(table, name)[d])) for name in ("s_from_m", "s_to_m")}
    return {**text, **along, "decision": str(table.accept[d]), **told}


def _metres(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.3f}"


def _ground(table: ReviewDecisions, d: int) -> tuple[Any, ...]:
    kind, lanelet = str(table.kind[d]), int(table.lanelet_id[d])
    if kind == "match":
        return kind, lanelet
    if kind == "change":
        return kind, *table.key_of(d)[1:]
    key = "" if kind == "lanes" else str(table.key[d])
    return kind, lanelet, int(table.way_id[d]), key


def _settled(
    matches: Matches | None, transfers: Transfers | None, check: LaneCheck | None
) -> set[tuple[Any, ...]]:
    """What the tables say was settled by people, as far as a decision can be told by."""
    out: set[tuple[Any, ...]] = set()
    if matches is not None:
        out |= {("match", i) for i in matches.lanelet_id[_by_people(matches.reason)].tolist()}
    if transfers is not None:
        for row in _by_people(transfers.reason).tolist():
            key = str(transfers.key[row])
            kind = "fragment" if key == "fragment" else "value"
            out.add((kind, int(transfers.lanelet_id[row]), int(transfers.way_id[row]), key))
    if check is not None:
        for row in _by_people(check.reason).tolist():
            out.add(("lanes", int(check.lanelet_id[row]), int(check.way_id[row]), ""))
    return out


def _changed(changes: RoadChanges | None) -> set[tuple[Any, ...]]:
    if changes is None:
        return set()
    words = zip(changes.way_id.tolist(), *(c.tolist() for c in change_words(changes)), strict=True)
    return {("change", *word) for word in words}


def _by_people(reasons: np.ndarray) -> np.ndarray:
    return np.flatnonzero([BY in str(reason) for reason in reasons.tolist()])
