"""The decision table of transfer: which value of which way piece would land on which lanelet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

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
from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.model.conflation import Matches
from flexmap_tasks.model.lanelets import Polylines, centrelines, end_nodes, lanelets_of, lengths_m
from flexmap_tasks.model.maps import LaneletMap, Lanelets, PlacedRoads
from flexmap_tasks.model.osm import OsmDocument, Tags, rows_of

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

    open_to_cars : (k,) bool; forks : (k,) bool, it turns, or begins or ends together with another lanelet
    centreline : (k,) lines; length_m : (k,) float64, their lengths in the plane
    drawn_way : (k,) int64 row of the way that is its member `centerline`, -1 for none, -2 where several share
    one; drawn_inverted : (k,) bool, it runs against the lanelet
    speed_rule : (k,) str, what a speed limit rule (regulatory element) says of it in km/h, "?" where it cannot be
    read, "" without a rule; Lanelet2 then ignores the tag
    tags : of the lanelets, in the same rows
    """

    lanelets: Lanelets
    open_to_cars: Bools
    forks: Bools
    centreline: Polylines
    length_m: Floats
    drawn_way: Ints
    drawn_inverted: Bools
    speed_rule: Strings
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
        return Rows(
            self.lanelet[at],
            self.s_from_m[at],
            self.s_to_m[at],
            self.road[at],
            self.sense[at],
            self.confidence[at],
            self.sure[at],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Offers:
    """What the ways of `Rows` offer under each rule.

    code : (n, r) int64 into `values`, 0 for nothing
    note : (n, r) int64 into `notes`, values that hold only at times, 0 for none
    values, notes : the different ones, in an order of their own
    """

    code: Ints
    note: Ints
    values: tuple[Offer, ...]
    notes: tuple[str, ...]


def facts_of(lanelet_map: LaneletMap) -> LaneletFacts:
    """The lanelets of the map with length, tags, and whether cars may use them."""
    lanelets = lanelets_of(lanelet_map)
    tags = lanelet_map.document.relations.tags.take(lanelets.relation_row)
    open_to_cars = np.array([_open(tags.of_element(i)) for i in range(len(lanelets))], dtype=bool)
    lines = centrelines(lanelet_map, lanelets)
    drawn = _drawn_centrelines(lanelet_map.document, lanelets)
    inverted = _against(lanelet_map, drawn, lines)
    forks = _forks(end_nodes(lanelet_map, lanelets)) | (tags.column("turn_direction") != None)  # noqa: E711
    rules = speed_rules(lanelet_map.document, lanelets)
    return LaneletFacts(lanelets, open_to_cars, forks, lines, lengths_m(lines), drawn, inverted, rules, tags)


def _forks(ends: Ints) -> Bools:
    """(k,) bool: another lanelet has the same two nodes at its start, or at its end."""
    out = np.zeros(len(ends), dtype=bool)
    for pair in (ends[:, :2], ends[:, 2:]):
        _, inverse, times = np.unique(pair, axis=0, return_inverse=True, return_counts=True)
        out |= times[inverse.ravel()] > 1
    return out


def speed_rules(document: OsmDocument, lanelets: Lanelets) -> Strings:
    """(k,) str: see `LaneletFacts.speed_rule`."""
    relations = document.relations
    limit = (relations.tags.column("type") == "regulatory_element") & (
        relations.tags.column("subtype") == "speed_limit"
    )
    hit = np.flatnonzero(
        (relations.member_role == "regulatory_element") & (relations.member_type == "relation")
    )
    rule = rows_of(relations.id, relations.member_ref[hit])
    hit, rule = hit[rule >= 0], rule[rule >= 0]
    hit, rule = hit[limit[rule]], rule[limit[rule]]
    out: Strings = np.full(len(lanelets), "", dtype=object)
    lanelet = rows_of(lanelets.relation_row, np.searchsorted(relations.offset, hit, side="right") - 1)
    for k, r in zip(lanelet.tolist(), rule.tolist(), strict=True):
        sign = relations.tags.of_element(r).get("sign_type", "")
        speed = speed_kmh(sign.removeprefix("de274-"), {})
        out[k] = "?" if speed is None or not 0 < speed < 1000 or out[k] else format_kmh(speed)
    return out


def _drawn_centrelines(document: OsmDocument, lanelets: Lanelets) -> Ints:
    relations = document.relations
    hit = np.flatnonzero((relations.member_role == "centerline") & (relations.member_type == "way"))
    owner = np.searchsorted(relations.offset, hit, side="right") - 1
    way = rows_of(document.ways.id, relations.member_ref[hit])
    lanelet = rows_of(lanelets.relation_row, owner)
    hit, way, lanelet = hit[lanelet >= 0], way[lanelet >= 0], lanelet[lanelet >= 0]
    out = np.full(len(lanelets), -1, dtype=np.int64)
    out[lanelet] = way
    several = np.bincount(lanelet, minlength=len(lanelets)) > 1
    shared = np.bincount(way[way >= 0], minlength=len(document.ways.id)) > 1
    shared[lanelets.left_way] = shared[lanelets.right_way] = True
    out[several | ((out >= 0) & shared[out])] = -2
    return out


def _against(lanelet_map: LaneletMap, drawn: Ints, lines: Polylines) -> Bools:
    """(k,) bool: the drawn centreline runs against the lanelet, judged from end to end."""
    out = np.zeros(len(drawn), dtype=bool)
    has = np.flatnonzero(drawn >= 0)
    offset, ref = lanelet_map.document.ways.offset, lanelet_map.document.ways.ref
    has = has[np.diff(offset)[drawn[has]] > 0]
    ends = [
        rows_of(lanelet_map.document.nodes.id, ref[at])
        for at in (offset[drawn[has]], offset[drawn[has] + 1] - 1)
    ]
    run = lanelet_map.xyz_m[ends[1]] - lanelet_map.xyz_m[ends[0]]
    along = lines.xyz_m[lines.offset[has + 1] - 1] - lines.xyz_m[lines.offset[has]]
    out[has] = np.einsum("ij,ij->i", run[:, :2], along[:, :2]) < 0
    return out


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
    found = []
    for road, sense in pairs.tolist():
        tags = roads.network.tags.of_element(road)
        found.append([offer(rule, tags, sense, params) for rule in params.rules])
    plain = [[replace(o, also="") for o in line] for line in found]
    values = sorted(
        {o for line in plain for o in line} | {NOTHING}, key=lambda o: (o.value, o.weak, o.problem)
    )
    notes = sorted({o.also for line in found for o in line} | {""})
    value_code, note_code = {o: i for i, o in enumerate(values)}, {n: i for i, n in enumerate(notes)}
    shape = (len(pairs), len(params.rules))
    code = np.array([[value_code[o] for o in line] for line in plain], dtype=np.int64).reshape(shape)
    note = np.array([[note_code[o.also] for o in line] for line in found], dtype=np.int64).reshape(shape)
    return Offers(code[inverse.ravel()], note[inverse.ravel()], tuple(values), tuple(notes))


@dataclass(frozen=True, slots=True)
class Case:
    """A lanelet as a decision sees it: its tags, whether cars may use it, what a speed limit rule says of it."""

    tags: Mapping[str, str]
    open_to_cars: bool = True
    speed_rule: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Contexts:
    """The lanelets sorted by all that a decision looks at.

    code : (k,) int64 into `lanelets`
    """

    code: Ints
    lanelets: tuple[Case, ...]


def contexts_of(facts: LaneletFacts, params: TransferParams) -> Contexts:
    """Lanelets with the same subtype and the same values under every rule decide alike."""
    keys = sorted({rule.target for rule in params.rules} | {"subtype"})
    columns = [facts.tags.column(key) for key in keys]
    codes: dict[tuple[object, ...], int] = {}
    rows = zip(facts.open_to_cars.tolist(), facts.speed_rule.tolist(), *columns, strict=True)
    code = np.fromiter((codes.setdefault(row, len(codes)) for row in rows), np.int64, len(facts.lanelets))
    lanelets = [
        Case(
            {k: str(v) for k, v in zip(keys, row[2:], strict=True) if v is not None},
            bool(row[0]),
            str(row[1]),
        )
        for row in codes
    ]
    return Contexts(code, tuple(lanelets))


def decisions(
    lanelet: Ints, code: Ints, offers: Offers, contexts: Contexts, rule: TransferRule
) -> tuple[Ints, list[Decision]]:
    """The decision on each pair (lanelet row, offer code) under one rule, as positions in a list.

    The first of the list is "nothing to say".
    """
    pairs, inverse = np.unique(np.stack([contexts.code[lanelet], code], axis=1), axis=0, return_inverse=True)
    known: dict[Decision, int] = {Decision(""): 0}
    at = [
        known.setdefault(decide(rule, offers.values[offered], contexts.lanelets[context]), len(known))
        for context, offered in pairs.tolist()
    ]
    return np.array(at, dtype=np.int64)[inverse.ravel()], list(known)


def decide(rule: TransferRule, offered: Offer, lanelet: Case) -> Decision:
    """What becomes of an offer on a lanelet; values the author chose knowingly stay."""
    old = lanelet.tags.get(rule.target, "")
    ruled = lanelet.speed_rule if rule.target == "speed_limit" else ""
    driven = lanelet.open_to_cars or lanelet.tags.get("subtype") == "bus_lane"
    if not driven or not offered.value or (offered.weak and old):
        return Decision("")
    if offered.problem:
        return Decision("review", offered.value, f"{rule.key}: {offered.problem}")
    if same_value(rule, ruled or old, offered.value):
        return Decision("keep", offered.value, "the map says the same")
    if ruled:
        return Decision(
            "review", offered.value, f"a speed limit rule of the map says {ruled}, a tag has no effect"
        )
    action, reason = _held(rule, old, offered.value)
    return Decision(action, offered.value, reason or ("an assumption" if offered.weak else ""))


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
