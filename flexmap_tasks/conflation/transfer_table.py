"""The decision table of transfer: which value of which way piece would land on which lanelet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flexmap_tasks.config import TransferParams, TransferRule
from flexmap_tasks.conflation.osm_values import (
    CLOSED_SUBTYPES,
    NOTHING,
    Offer,
    offer,
    one_way_sense,
    same_value,
)
from flexmap_tasks.model.arrays import Bools, Floats, Ints
from flexmap_tasks.model.conflation import Matches
from flexmap_tasks.model.lanelets import centrelines, lanelets_of, lengths_m
from flexmap_tasks.model.maps import LaneletMap, Lanelets, PlacedRoads
from flexmap_tasks.model.osm import Tags, rows_of

OPEN_SUBTYPES = ("", "road", "highway", "play_street", "exit")
"""Subtypes that Lanelet2 lets cars drive on."""
ROAD_SUBTYPES = ("", "road", "highway", "play_street")
"""Subtypes that a road's class may replace; every other one says more than the road does."""
LOCATIONS = ("", "urban", "nonurban")


@dataclass(frozen=True, slots=True)
class Decision:
    """What becomes of one offer on one lanelet: `action` is "set", "keep", "review" or "" (nothing to say)."""

    action: str
    value: str = ""
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class LaneletFacts:
    """What transfer needs to know of every lanelet, by row of `lanelets`.

    open_to_cars : (k,) bool; length_m : (k,) float64 of the centreline
    tags : of the lanelets, in the same rows
    """

    lanelets: Lanelets
    open_to_cars: Bools
    length_m: Floats
    tags: Tags


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Matched pieces that can be used: ordered by lanelet, then place.

    lanelet : (n,) int64 row of the lanelet; s_from_m, s_to_m : (n,) float64 inside it
    road : (n,) int64 row of the way; sense : (n,) int64, +1 along the way, -1 against it
    confidence : (n,) float64; sure : (n,) bool, decided as a match and certain enough
    """

    lanelet: Ints
    s_from_m: Floats
    s_to_m: Floats
    road: Ints
    sense: Ints
    confidence: Floats
    sure: Bools

    def __len__(self) -> int:
        return len(self.lanelet)

    def take(self, at: Ints | Bools) -> Rows:
        """The given rows."""
        columns = (
            self.lanelet,
            self.s_from_m,
            self.s_to_m,
            self.road,
            self.sense,
            self.confidence,
            self.sure,
        )
        return Rows(*(c[at] for c in columns))


@dataclass(frozen=True, slots=True, eq=False)
class Offers:
    """What the ways of `Rows` offer under each rule.

    code : (n, r) int64 into `values`, 0 for nothing
    values : the different offers; the first is "nothing"
    """

    code: Ints
    values: tuple[Offer, ...]


def facts_of(lanelet_map: LaneletMap) -> LaneletFacts:
    """The lanelets of the map with length, tags, and whether cars may use them."""
    lanelets = lanelets_of(lanelet_map)
    tags = lanelet_map.document.relations.tags.take(lanelets.relation_row)
    open_to_cars = np.array([_open(tags.of_element(i)) for i in range(len(lanelets))], dtype=bool)
    return LaneletFacts(lanelets, open_to_cars, lengths_m(centrelines(lanelet_map, lanelets)), tags)


def _open(tags: Mapping[str, str]) -> bool:
    """Lanelet2's default rules for a car: `participant` tags override the subtype."""
    overrides = [k for k in tags if k.split(":")[0] == "participant"]
    for key in ("participant:vehicle:car", "participant:vehicle", "participant"):
        if key in tags:
            return tags[key].lower() in ("yes", "true", "1")
    return not overrides and tags.get("subtype", "") in OPEN_SUBTYPES


def usable_rows(matches: Matches, facts: LaneletFacts, roads: PlacedRoads, params: TransferParams) -> Rows:
    """The rows of `matches` that name a lanelet of the map, a way of the roads and a piece longer than nothing."""
    lanelet = rows_of(facts.lanelets.id, matches.lanelet_id)
    road = rows_of(roads.network.way_id, matches.way_id)
    known = (lanelet >= 0) & (road >= 0) & (matches.way_id != 0) & (matches.direction != 0)
    length = facts.length_m[lanelet] if len(facts.lanelets) else np.zeros(len(matches))
    with np.errstate(invalid="ignore"):
        start, end = np.clip(matches.s_from_m, 0.0, length), np.clip(matches.s_to_m, 0.0, length)
        known &= (end > start) & np.isin(matches.decision.astype(str), ("match", "review"))
    sure = (matches.decision == "match") & (matches.confidence >= params.confidence_min)
    order = np.lexsort((matches.way_id, matches.direction, matches.s_to_m, start, lanelet))
    rows = Rows(lanelet, start, end, road, np.sign(matches.direction), matches.confidence, sure)
    return rows.take(order[known[order]])


def wrong_way(rows: Rows, facts: LaneletFacts, roads: PlacedRoads) -> Bools:
    """(n,) bool: a one-way lanelet for cars runs against a one-way road."""
    used = np.unique(rows.road)
    sense = np.zeros(len(roads.network), dtype=np.int64)
    tags = roads.network.tags
    sense[used] = [one_way_sense(tags.of_element(int(r))) or 0 for r in used]
    one_way = facts.lanelets.one_way[rows.lanelet] & facts.open_to_cars[rows.lanelet]
    against: Bools = sense[rows.road] * rows.sense == -1
    return one_way & against


def offers_of(rows: Rows, roads: PlacedRoads, params: TransferParams) -> Offers:
    """What every row's way offers; parsed once per way and direction."""
    pairs, inverse = np.unique(np.stack([rows.road, rows.sense], axis=1), axis=0, return_inverse=True)
    codes: dict[Offer, int] = {NOTHING: 0}
    table = np.zeros((len(pairs), len(params.rules)), dtype=np.int64)
    for i, (road, sense) in enumerate(pairs.tolist()):
        tags = roads.network.tags.of_element(road)
        for j, rule in enumerate(params.rules):
            table[i, j] = codes.setdefault(offer(rule, tags, sense, params), len(codes))
    return Offers(table[inverse.ravel()], tuple(codes))


@dataclass(frozen=True, slots=True, eq=False)
class Contexts:
    """The lanelets sorted by all that a decision looks at.

    code : (k,) int64 into `tags` and `open_to_cars`
    """

    code: Ints
    tags: tuple[dict[str, str], ...]
    open_to_cars: tuple[bool, ...]


def contexts_of(facts: LaneletFacts, params: TransferParams) -> Contexts:
    """Lanelets with the same subtype and the same values under every rule decide alike."""
    keys = sorted({rule.target for rule in params.rules} | {"subtype"})
    columns = [facts.tags.column(key) for key in keys]
    codes: dict[tuple[object, ...], int] = {}
    rows = zip(facts.open_to_cars.tolist(), *columns, strict=True)
    code = np.fromiter((codes.setdefault(row, len(codes)) for row in rows), np.int64, len(facts.lanelets))
    tags = [{k: str(v) for k, v in zip(keys, row[1:], strict=True) if v is not None} for row in codes]
    return Contexts(code, tuple(tags), tuple(bool(row[0]) for row in codes))


def decisions(
    lanelet: Ints, code: Ints, offers: Offers, contexts: Contexts, rule: TransferRule
) -> tuple[Ints, list[Decision]]:
    """The decision on each pair (lanelet row, offer code) under one rule, as positions in a list.

    The first of the list is "nothing to say".
    """
    pairs, inverse = np.unique(np.stack([contexts.code[lanelet], code], axis=1), axis=0, return_inverse=True)
    known: dict[Decision, int] = {Decision(""): 0}
    at = [
        known.setdefault(
            decide(rule, offers.values[offered], contexts.tags[context], contexts.open_to_cars[context]),
            len(known),
        )
        for context, offered in pairs.tolist()
    ]
    return np.array(at, dtype=np.int64)[inverse.ravel()], list(known)


def decide(rule: TransferRule, offered: Offer, lanelet: Mapping[str, str], open_to_cars: bool) -> Decision:
    """What becomes of an offer on a lanelet with these tags; values the author chose knowingly stay."""
    old, subtype = lanelet.get(rule.target, ""), lanelet.get("subtype", "")
    if not (open_to_cars or subtype == "bus_lane") or not offered.value:
        return Decision("")
    if offered.problem:
        return Decision("review", offered.value, f"{rule.key}: {offered.problem}")
    if same_value(rule, old, offered.value):
        return Decision("keep", offered.value, "the map says the same")
    if offered.weak:
        return (
            Decision("") if old else Decision("set", offered.value, "an assumption where the map is silent")
        )
    action, reason = _held(rule, old, offered.value)
    return Decision(action, offered.value, reason)


def _held(rule: TransferRule, old: str, new: str) -> tuple[str, str]:
    """Action and reason for a value that differs from the map's: is the map's value protected from it?"""
    cases = (
        (rule.parser == "subtype" and old not in ROAD_SUBTYPES,
         "keep", "the map's subtype says more than the road's class"),
        (rule.parser == "subtype" and new in CLOSED_SUBTYPES,
         "review", "it would close the lanelet to cars"),
        (rule.parser == "location" and old not in LOCATIONS,
         "keep", "the map's location says more"),
        (rule.parser == "oneway" and bool(old),
         "review", "the lanelet may be driven both ways, the road is one-way"),
        (bool(old) and rule.policy == "fill_only", "keep", "the rule only fills gaps"),
        (bool(old) and rule.policy == "review_conflicts", "review", "the map says something else"),
    )  # fmt: skip
    return next(((action, reason) for holds, action, reason in cases if holds), ("set", ""))
