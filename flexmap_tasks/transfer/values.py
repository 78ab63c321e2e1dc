"""What a tag of OpenStreetMap says, in the words of Lanelet2; one typed parser per kind of value.

A parser never guesses. What it cannot read, or what holds only at times, becomes a problem for a person.
Values follow the OSM wiki (Key:maxspeed, Key:oneway, Key:highway, Key:zone:traffic, Key:source:maxspeed).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

from flexmap_tasks.config import TransferParams, TransferRule

KMH_PER_UNIT = {"mph": 1.609344, "knots": 1.852}
"""Units that OSM writes behind a number; without one it is km/h."""
WALK_KMH = 7.0
"""`maxspeed=walk`: what Lanelet2 itself drives in a play street."""
SPEED_RANGE_KMH = (3.0, 150.0)
"""No road has a posted limit outside this range."""
TEXT_LENGTH_MAX = 255
"""The longest value OpenStreetMap stores."""
NONURBAN_HIGHWAYS = ("motorway", "motorway_link", "trunk", "trunk_link")
CLOSED_SUBTYPES = ("bus_lane", "bicycle_lane", "walkway", "shared_walkway", "stairs", "crosswalk")
"""Subtypes Lanelet2 closes to cars: never given to a lanelet that its author left open."""

_NUMBER = re.compile(r"([0-9]{1,3}(?:\.[0-9]{1,3})?) ?(km/h|kmh|kph|mph|knots)?\Z")
_ZONE_NUMBER = re.compile(r"([a-z]{2}):(?:zone:?)?([0-9]{2,3})\Z")
_MPH_COUNTRIES = ("gb", "uk", "us")
_WORD = re.compile(r"[a-z0-9_:.-]{1,64}\Z")
_ZONE_KEYS = ("zone:traffic", "maxspeed:type", "source:maxspeed", "zone:maxspeed", "maxspeed")
_COUNTRY = r"(?:[a-z]{2}(?:-[a-z]{1,3})?:)?"
_URBAN = re.compile(
    rf"{_COUNTRY}(?:urban|living_street|nsl_restricted|zone:?[0-9]+|bicycle_road)\Z|[a-z]{{2}}:[23]0\Z"
)
_NONURBAN = re.compile(rf"{_COUNTRY}(?:rural|motorway|trunk|nsl_single|nsl_dual)\Z")
_YES, _NO = ("yes", "true", "1"), ("no", "false", "0")


TOWN_SHARE = 0.5
"""Land along more than half of a road tells what the road runs through."""
TOWN_MAX_KMH = 60.0
"""No road through a town is posted faster: a faster one with open land around is outside."""
TOWN_HIGHWAYS = ("residential", "living_street", "pedestrian")


Zones: TypeAlias = Mapping[str, float | Literal["none"]]
"""Limits behind codes such as `de:urban`, km/h."""


@dataclass(frozen=True, slots=True)
class Offer:
    """What OSM offers for one attribute of a lanelet.

    value : the text to write; "" when OSM says nothing; what OSM says when there is a problem
    weak : an assumption that only fills a gap; why : what it rests on
    problem : why a person must look at it; such a value is never written
    also : a further value that holds only at times, for a person
    """

    value: str = ""
    weak: bool = False
    problem: str = ""
    also: str = ""
    why: str = ""


NOTHING = Offer()


@dataclass(frozen=True, slots=True)
class Around:
    """What lies along a way, see `RoadNetwork`: shares of its length, and the side of city limits it is on."""

    built_up: float = 0.0
    open_land: float = 0.0
    city_limit: int = 0


NOWHERE = Around()


def offer(
    rule: TransferRule,
    tags: Mapping[str, str],
    sense: int,
    params: TransferParams,
    around: Around = NOWHERE,
) -> Offer:
    """What a way with these tags offers a lanelet that runs along it (+1), against it (-1) or both ways (0)."""
    also = _at_times(rule.key, tags, sense)
    found = _always(rule, tags, sense, params, around)
    return replace(found, also=also) if also else found


def _always(
    rule: TransferRule, tags: Mapping[str, str], sense: int, params: TransferParams, around: Around
) -> Offer:
    match rule.parser:
        case "speed":
            return _speed(rule, tags, sense, params)
        case "subtype":
            return _subtype(_directed(rule, tags, 1), params)
        case "location":
            return _location(tags, rule.key, params, around)
        case "oneway":
            return _one_way(tags, sense)
        case "word":
            return _word(_directed(rule, tags, sense))
        case _:
            return _text(_directed(rule, tags, sense))


def one_way_sense(tags: Mapping[str, str]) -> int | None:
    """+1 along the way, -1 against it, 0 both; None when it changes or cannot be read."""
    value = tags.get("oneway", "").strip().lower()
    if value in _YES:
        return 1
    if value in ("-1", "reverse"):
        return -1
    if value in _NO:
        return 0
    if value:
        return None
    implied = tags.get("junction") in ("roundabout", "circular") or tags.get("highway") == "motorway"
    return int(implied)


def speed_kmh(text: str, zones: Zones) -> float | None:
    """The limit in km/h, infinite for `none`; None when the text is no single limit."""
    values = {_one_speed_kmh(part.strip().lower(), zones) for part in text.replace("|", ";").split(";")}
    return values.pop() if len(values) == 1 else None


def _one_speed_kmh(text: str, zones: Zones) -> float | None:
    if text == "none" or zones.get(text) == "none":
        return math.inf
    if text == "walk":
        return WALK_KMH
    if text in zones:
        return float(zones[text])
    if hit := _NUMBER.match(text):
        return float(hit[1]) * KMH_PER_UNIT.get(hit[2], 1.0)
    if (hit := _ZONE_NUMBER.match(text)) and hit[1] not in _MPH_COUNTRIES:
        return float(hit[2])
    return None


def format_kmh(speed: float) -> str:
    """A plain number of km/h: the one form that Lanelet2 and tools that only read a number agree on."""
    return f"{round(speed, 2):.2f}".rstrip("0").rstrip(".")


def same_value(rule: TransferRule, a: str, b: str) -> bool:
    """Both texts mean the same."""
    if rule.parser == "speed":
        first, second = speed_kmh(a, {}), speed_kmh(b, {})
        if first is not None and second is not None:
            return first == second or abs(first - second) < 0.05
    if rule.parser == "oneway":
        return (a in _YES) == (b in _YES) and (a in _NO) == (b in _NO)
    return a == b


def count(text: str) -> int | None:
    """A number of lanes, None when the text is none."""
    text = text.strip()
    return int(text) if re.fullmatch(r"[0-9]{1,2}", text) and int(text) > 0 else None


def _directed(rule: TransferRule, tags: Mapping[str, str], sense: int) -> str:
    """The value for this direction of the way, else the one for both; two values where both directions differ."""
    for key in (rule.key, *rule.variants):
        if found := _by_direction(key, tags, sense):
            return ";".join(found)
    return ""


def _by_direction(key: str, tags: Mapping[str, str], sense: int) -> list[str]:
    sides = {1: ("forward",), -1: ("backward",)}.get(sense, ("forward", "backward"))
    found = {tags.get(f"{key}:{side}", "").strip() or tags.get(key, "").strip() for side in sides}
    return sorted(found - {""})


def _at_times(key: str, tags: Mapping[str, str], sense: int) -> str:
    """What holds only at times in this direction: conditional and variable values."""
    other = {1: "backward", -1: "forward"}.get(sense)
    told = (
        k
        for k in sorted(tags)
        if k.startswith(f"{key}:") and (k.endswith(":conditional") or k == f"{key}:variable")
    )
    return "; ".join(f"{k}={tags[k]}" for k in told if tags[k].strip() and other not in k.split(":"))


def _text(value: str) -> Offer:
    if not value or not any(c.isalnum() for c in value):
        return NOTHING
    if len(value) > TEXT_LENGTH_MAX or not value.isprintable():
        return Offer(value[:TEXT_LENGTH_MAX], problem="the text is too long or holds control characters")
    return Offer(value)


def _word(value: str) -> Offer:
    if not value:
        return NOTHING
    parts = {part.strip().lower() for part in value.split(";")}
    if len(parts) > 1 or not _WORD.match(min(parts)):
        return Offer(value[:TEXT_LENGTH_MAX], problem="expected one OSM value")
    return Offer(parts.pop())


def _speed(rule: TransferRule, tags: Mapping[str, str], sense: int, params: TransferParams) -> Offer:
    text = _limits(rule, tags, sense)
    if not text:
        return NOTHING
    speed = speed_kmh(text, params.zone_speeds_kmh)
    if speed is None:
        return Offer(text[:TEXT_LENGTH_MAX], problem="not understood as one speed limit")
    if math.isinf(speed):
        if params.no_limit_kmh is None:
            return Offer(text, problem="no limit: Lanelet2 has no value for it, set no_limit_kmh")
        speed = params.no_limit_kmh
    low, high = SPEED_RANGE_KMH
    if not low <= speed <= high:
        return Offer(text, problem=f"a limit outside {low:g} to {high:g} km/h")
    return Offer(format_kmh(speed))


def _limits(rule: TransferRule, tags: Mapping[str, str], sense: int) -> str:
    """The limit of the road and those of its lanes; a lane without one of its own has the road's."""
    road = _directed(rule, tags, sense)
    lanes = [x for text in _by_direction(f"{rule.key}:lanes", tags, sense) for x in text.split("|")]
    own = "|".join(x for x in lanes if x.strip() or not road)
    return ";".join(text for text in (road, own) if text)


def _subtype(highway: str, params: TransferParams) -> Offer:
    subtype = params.highway_subtypes.get(highway, "")
    return Offer(subtype) if subtype else NOTHING


def _location(tags: Mapping[str, str], key: str, params: TransferParams, around: Around) -> Offer:
    """From zone tags, signs, living streets, motorways and trunks; else an assumption from land, class and speed."""
    highway = tags.get("highway", "").strip()
    if not tags.get(key, "").strip():
        return NOTHING
    votes = {
        "urban" if _URBAN.match(value) else "nonurban"
        for zone_key in _ZONE_KEYS
        if _URBAN.match(value := tags.get(zone_key, "").strip().lower()) or _NONURBAN.match(value)
    }
    if len(votes) > 1:
        return Offer(" and ".join(sorted(votes)), problem="the zone tags contradict each other")
    speed = _fastest_kmh(tags, params)
    certain = (
        *votes,
        *(("urban",) if around.city_limit > 0 or highway == "living_street" else ()),
        *(("nonurban",) if around.city_limit < 0 else ()),
        *(("nonurban",) if highway in NONURBAN_HIGHWAYS and not speed <= 50.0 else ()),
        *(("nonurban",) if around.open_land > TOWN_SHARE and speed > TOWN_MAX_KMH else ()),
    )
    return Offer(certain[0]) if certain else _assumed_location(highway, speed, around)


def _assumed_location(highway: str, speed_kmh: float, around: Around) -> Offer:
    """What is likely; nothing where neither land nor class nor speed speaks."""
    cases = (
        (around.built_up > TOWN_SHARE, "urban", "built-up land along the road"),
        (around.open_land > TOWN_SHARE, "nonurban", "open land along the road"),
        (highway in TOWN_HIGHWAYS, "urban", "the class of the road"),
        (speed_kmh > TOWN_MAX_KMH, "nonurban", "the speed limit"),
        (speed_kmh <= 50.0, "urban", "the speed limit"),
    )
    for holds, value, why in cases:
        if holds:
            return Offer(value, weak=True, why=f"an assumption from {why}")
    return NOTHING


def _fastest_kmh(tags: Mapping[str, str], params: TransferParams) -> float:
    """The greatest limit of both directions, NaN where OSM names none that can be read."""
    keys = ("maxspeed", "maxspeed:forward", "maxspeed:backward")
    speeds = [speed_kmh(tags[key], params.zone_speeds_kmh) for key in keys if tags.get(key, "").strip()]
    return max((s for s in speeds if s is not None), default=math.nan)


def _one_way(tags: Mapping[str, str], sense: int) -> Offer:
    road = one_way_sense(tags)
    if road is None:
        return Offer(
            tags["oneway"].strip()[:TEXT_LENGTH_MAX], problem="a direction that changes or is unknown"
        )
    return Offer("yes") if road and sense in (0, road) else NOTHING
