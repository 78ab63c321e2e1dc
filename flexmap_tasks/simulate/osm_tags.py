"""What OpenStreetMap says about a road, and what it leaves out or gets wrong."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.simulate.roads import Road
from flexmap_tasks.simulate.world import OsmSettings

SURFACES = ("asphalt", "paving_stones", "cobblestone", "gravel")
SPEEDS = ("20", "30", "50", "70", "100")
FALLIBLE = ("maxspeed", "name", "surface", "lanes")


def road_tags(road: Road, section: dict[str, str], lanes: int) -> dict[str, str]:
    """What a careful mapper would write about a stretch of road."""
    tags = {"highway": road.highway}
    if road.role == "parking_aisle":
        tags["service"] = "parking_aisle"
    if road.role == "roundabout":
        tags["junction"] = "roundabout"
    tags |= {k: v for k, v in section.items() if v}
    tags["lanes"] = str(lanes)
    if road.backward == 0 and lanes == road.forward:
        tags["oneway"] = "yes"
    if road.level:
        tags |= {"bridge": "yes", "layer": str(road.level)}
    if road.bicycle:
        tags["cycleway:right" if road.backward == 0 else "cycleway:both"] = "lane"
    if road.bus:
        tags["bus:lanes"] = "|".join(["yes"] * (road.forward - 1) + ["designated"])
    return tags


def worsened(tags: dict[str, str], plan: OsmSettings, rng: np.random.Generator) -> dict[str, str]:
    """The same tags with some left out and some false."""
    out = dict(tags)
    for key in FALLIBLE:
        omitted, false = rng.uniform(size=2) < (plan.omit_share, plan.wrong_share)
        pick = int(rng.integers(0, 1000))
        if key in out and omitted:
            del out[key]
        elif key in out and false and key != "name":
            out[key] = false_value(key, out[key], pick)
    return out


def false_value(key: str, value: str, pick: int) -> str:
    """Another plausible value."""
    if key == "lanes":
        return str(int(value) + (1 if pick % 2 or int(value) == 1 else -1))
    others = [v for v in (SURFACES if key == "surface" else SPEEDS) if v != value]
    return others[pick % len(others)]
