"""What Lanelet2's rules for vehicles in Germany make of a lanelet's attributes; checked against the library."""

from __future__ import annotations

import re
from collections.abc import Mapping

PASSABLE_SUBTYPES = ("", "road", "highway", "play_street", "exit")
"""Subtypes a vehicle may drive on when no participant is named."""
YES, NO = ("yes", "true", "1"), ("no", "false", "0")
DEFAULT_KMH = {
    ("road", "urban"): 50.0, ("road", "nonurban"): 100.0, ("highway", "urban"): 130.0,
    ("highway", "nonurban"): 130.0, ("play_street", "urban"): 7.0, ("play_street", "nonurban"): 7.0,
    ("exit", "urban"): 50.0, ("bus_lane", "urban"): 50.0, ("bus_lane", "nonurban"): 100.0,
}  # fmt: skip
"""Limits by subtype and location where no speed_limit is given; 0 for all others."""
UNITS_KMH = {"": 1.0, "km/h": 1.0, "kmh": 1.0, "mph": 1.609344, "m/s": 3.6}
_SPEED = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(km/h|kmh|mph|m/s|)\s*")


def can_pass(tags: Mapping[str, str]) -> bool:
    """A vehicle may drive on the lanelet."""
    if any(key.startswith("participant") for key in tags):
        return _override(tags, "participant") in YES
    return tags.get("subtype", "") in PASSABLE_SUBTYPES


def is_one_way(tags: Mapping[str, str]) -> bool:
    """A vehicle may drive on it in the direction it is drawn in only."""
    return _override(tags, "one_way") not in NO


def speed_limit_kmh(tags: Mapping[str, str]) -> float:
    """The limit from attributes alone; 0 where the value is empty or no speed, as the library reads it."""
    given = [tags[key] for key in ("speed_limit:vehicle", "speed_limit") if key in tags]
    if not given:
        return DEFAULT_KMH.get((tags.get("subtype", "road"), tags.get("location", "urban")), 0.0)
    speeds = [speed for speed in map(_SPEED.fullmatch, given) if speed]
    return float(speeds[0][1]) * UNITS_KMH[speeds[0][2]] if speeds else 0.0


def _override(tags: Mapping[str, str], key: str) -> str | None:
    """The value for all participants, else that for vehicles."""
    return tags.get(key, tags.get(f"{key}:vehicle"))
