"""Attributes of the finished map judged by the truth, metre by metre."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.evaluation.lineage import lineage
from flexmap_tasks.geometry.overlay import overlay
from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.model.conflation import Transfers
from flexmap_tasks.model.lanelets import lanelets_of
from flexmap_tasks.model.maps import LaneletMap, Lanelets
from flexmap_tasks.model.osm import rows_of
from flexmap_tasks.model.truth import TrueTags


@dataclass(frozen=True, slots=True)
class AttributeScore:
    """Metres of one attribute.

    right_m : the map says what a faithful transfer of OpenStreetMap gives, or what it said before where
    OpenStreetMap says nothing; missing_m : it says nothing; wrong_m : it says something else
    error : missing and wrong over all; None without metres
    real_m, real_right_m : metres where the real world's value is known, and where the map has it
    """

    right_m: float
    missing_m: float
    wrong_m: float
    error: float | None
    real_m: float
    real_right_m: float


def attribute_scores(
    before: LaneletMap, finished: LaneletMap, transfers: Transfers | None, truth: TrueTags, junctions: Ints
) -> dict[str, AttributeScore]:
    """A score per attribute that the truth knows, by name.

    junctions : ids of lanelets that lead from one road onto another: what either road gives is right
    """
    ids = np.unique(truth.lanelet_id)
    old, lanelets = lanelets_of(before), lanelets_of(finished)
    origin = lineage(finished, lanelets, transfers)
    line = rows_of(ids, origin.source_id)
    use = np.flatnonzero(line >= 0)
    pieces = (line[use], origin.start[use], origin.stop[use])
    out = {}
    for key in sorted(set(truth.key.tolist())):
        rows = np.flatnonzero(truth.key == key)
        of_key = rows_of(ids, truth.lanelet_id[rows])
        whole = truth.lanelet_length_m[rows]
        laid = overlay(len(ids), (of_key, truth.s_from_m[rows] / whole, truth.s_to_m[rows] / whole), pieces)
        known = laid.first >= 0
        row = rows[laid.first[known]]
        metres = (laid.stop - laid.start)[known] * truth.lanelet_length_m[row]
        has, had = _values(finished, lanelets, key), _values(before, old, key)
        now = np.append(has, "")[_at(use, laid.second[known])]
        then = np.append(had, "")[rows_of(old.id, truth.lanelet_id[row])]
        offered, real = truth.osm_value[row], truth.value[row]
        wanted = np.where(offered == "", then, offered)
        lanelet = np.where(np.isin(truth.lanelet_id[row], junctions), truth.lanelet_id[row], -row - 1)
        out[key] = _score(metres, now, _choices(lanelet, wanted), _choices(lanelet, real))
    return out


def _at(use: Ints, second: Ints) -> Ints:
    """Rows of lanelets, -1 where no lanelet lies."""
    return np.append(use, -1)[second]


def _values(lanelet_map: LaneletMap, lanelets: Lanelets, key: str) -> Strings:
    column = lanelet_map.document.relations.tags.column(key)[lanelets.relation_row]
    out: Strings = np.where(column == None, "", column)  # noqa: E711 - element by element
    return out


def _choices(group: Ints, value: Strings) -> list[set[str]]:
    """Per row all values of its group."""
    of_group: dict[int, set[str]] = {}
    for key, text in zip(group.tolist(), value.tolist(), strict=True):
        of_group.setdefault(key, set()).add(text)
    return [of_group[key] for key in group.tolist()]


def _score(metres: Floats, now: Strings, wanted: list[set[str]], real: list[set[str]]) -> AttributeScore:
    right = _any_same(now, wanted)
    missing = ~right & (now == "")
    known = np.array(["" not in values for values in real], dtype=bool)
    total = float(metres.sum())
    right_m, missing_m = float(metres[right].sum()), float(metres[missing].sum())
    wrong_m = float(metres[~right & ~missing].sum())
    return AttributeScore(
        right_m=right_m,
        missing_m=missing_m,
        wrong_m=wrong_m,
        error=(missing_m + wrong_m) / total if total else None,
        real_m=float(metres[known].sum()),
        real_right_m=float(metres[known & _any_same(now, real)].sum()),
    )


def _any_same(now: Strings, choices: list[set[str]]) -> Bools:
    pairs = zip(now.tolist(), choices, strict=True)
    return np.array([any(same_value(text, value) for value in values) for text, values in pairs], dtype=bool)


def same_value(a: str, b: str) -> bool:
    """Equal as text, or as numbers ("50" and "50.0")."""
    if a == b:
        return True
    try:
        return abs(float(a) - float(b)) < 5e-3
    except ValueError:
        return False
