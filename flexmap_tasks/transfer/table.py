"""The decision table of transfer: which value of which way piece would land on which lanelet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexmap_tasks.config import TransferParams, TransferRule
from flexmap_tasks.model.arrays import Bools, Floats, Ints
from flexmap_tasks.model.conflation import Matches
from flexmap_tasks.model.maps import LaneletMap, PlacedRoads, RoadNetwork
from flexmap_tasks.model.osm import Tags, rows_of
from flexmap_tasks.transfer.facts import LaneletFacts
from flexmap_tasks.transfer.values import (
    CLOSED_SUBTYPES,
    NOTHING,
    NOWHERE,
    Around,
    Offer,
    offer,
    one_way_sense,
    same_value,
)

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


def offers_of(rows: Rows, facts: LaneletFacts, roads: PlacedRoads, params: TransferParams) -> Offers:
    """What every row's way offers; parsed once per way and direction."""
    sense = np.where(facts.lanelets.one_way[rows.lanelet], rows.sense, 0)
    pairs, inverse = np.unique(rows.road * 3 + sense + 1, return_inverse=True)
    found = []
    for pair in pairs.tolist():
        tags = roads.network.tags.of_element(pair // 3)
        around = _around(roads.network, pair // 3)
        found.append([offer(rule, tags, pair % 3 - 1, params, around) for rule in params.rules])
    plain = [[replace(o, also="") if o.also else o for o in line] for line in found]
    values = sorted(
        {o for line in plain for o in line} | {NOTHING}, key=lambda o: (o.value, o.weak, o.problem, o.why)
    )
    notes = sorted({o.also for line in found for o in line} | {""})
    value_code, note_code = {o: i for i, o in enumerate(values)}, {n: i for i, n in enumerate(notes)}
    shape = (len(pairs), len(params.rules))
    code = np.array([[value_code[o] for o in line] for line in plain], dtype=np.int64).reshape(shape)
    note = np.array([[note_code[o.also] for o in line] for line in found], dtype=np.int64).reshape(shape)
    return Offers(code[inverse], note[inverse], tuple(values), tuple(notes))


def _around(network: RoadNetwork, row: int) -> Around:
    if network.built_up is None or network.open_land is None or network.city_limit is None:
        return NOWHERE
    return Around(float(network.built_up[row]), float(network.open_land[row]), int(network.city_limit[row]))


@dataclass(frozen=True, slots=True)
class Case:
    """A lanelet as a decision sees it.

    tags : as they are; open_to_cars : cars may use it
    speed_rule : what a speed limit rule of the map says of it, see `LaneletFacts`
    released : its tags in the last release, none where it was not in it; None where there is no last release
    """

    tags: Mapping[str, str]
    open_to_cars: bool = True
    speed_rule: str = ""
    released: Mapping[str, str] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Contexts:
    """The lanelets sorted by all that a decision looks at.

    code : (k,) int64 into `lanelets`
    """

    code: Ints
    lanelets: tuple[Case, ...]


def contexts_of(
    facts: LaneletFacts, params: TransferParams, last_release: LaneletMap | None = None
) -> Contexts:
    """Lanelets with the same subtype and the same values under every rule, now and released, decide alike."""
    keys = sorted({rule.target for rule in params.rules} | {"subtype"})
    now = _values(facts.tags, keys, np.arange(len(facts.lanelets)))
    before: Sequence[tuple[str | None, ...] | None] = (
        [None] * len(now) if last_release is None else _released(last_release, keys, facts)
    )
    codes: dict[tuple[object, ...], int] = {}
    lanelets: list[Case] = []
    code = np.zeros(len(now), dtype=np.int64)
    rows = zip(now, before, facts.open_to_cars.tolist(), facts.speed_rule.tolist(), strict=True)
    for k, (tags, released, open_to_cars, speed_rule) in enumerate(rows):
        at = codes.setdefault((tags, released, open_to_cars, speed_rule), len(codes))
        if at == len(lanelets):
            old = None if released is None else _mapping(keys, released)
            lanelets.append(Case(_mapping(keys, tags), open_to_cars, speed_rule, old))
        code[k] = at
    return Contexts(code, tuple(lanelets))


def _values(tags: Tags, keys: list[str], rows: Ints) -> list[tuple[str | None, ...]]:
    return list(zip(*(tags.column(key)[rows].tolist() for key in keys), strict=True))


def _released(last_release: LaneletMap, keys: list[str], facts: LaneletFacts) -> list[tuple[str | None, ...]]:
    relations = last_release.document.relations
    row = rows_of(relations.id, facts.lanelets.id)
    known = (row >= 0) & (relations.tags.column("type") == "lanelet")[row]
    values = _values(relations.tags, keys, row)
    absent = (None,) * len(keys)  # drawn since: all that it says a person has said
    return [v if k else absent for v, k in zip(values, known.tolist(), strict=True)]


def _mapping(keys: list[str], values: tuple[str | None, ...]) -> dict[str, str]:
    return {key: value for key, value in zip(keys, values, strict=True) if value is not None}


def decisions(
    lanelet: Ints, code: Ints, offers: Offers, contexts: Contexts, rule: TransferRule
) -> tuple[Ints, list[Decision]]:
    """The decision on each pair (lanelet row, offer code) under one rule, as positions in a list.

    The first of the list is "nothing to say".
    """
    size = len(offers.values)
    pairs, inverse = np.unique(contexts.code[lanelet] * size + code, return_inverse=True)
    known: dict[Decision, int] = {Decision(""): 0}
    at = [
        known.setdefault(
            decide(rule, offers.values[pair % size], contexts.lanelets[pair // size]), len(known)
        )
        for pair in pairs.tolist()
    ]
    return np.array(at, dtype=np.int64)[inverse], list(known)


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
    action, reason = _edited(rule, lanelet, offered.value) or _held(rule, old, offered.value)
    return Decision(action, offered.value, reason or offered.why)


def _edited(rule: TransferRule, lanelet: Case, new: str) -> tuple[str, str] | None:
    """Action and reason where a person has changed the value since the last release; their word stands."""
    if lanelet.released is None:
        return None
    then = lanelet.released.get(rule.target, "")
    if then == lanelet.tags.get(rule.target, ""):
        return None
    if same_value(rule, then, new):
        return "keep", "changed by a person since the last release, OSM says what it said then"
    return "review", f"changed by a person since the last release, which said {then or 'nothing'}"


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
