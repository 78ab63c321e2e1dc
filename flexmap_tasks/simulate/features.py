"""What makes a plan a town: roundabouts, islands, slip lanes, frontage roads, overpasses and the rest.

Every feature takes the draft, its count and its own chance, and changes the first places that fit.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from flexmap_tasks.simulate.features_junctions import overpasses, roundabouts, slip_lanes
from flexmap_tasks.simulate.features_pick import plain_roads, shuffled
from flexmap_tasks.simulate.features_roads import (
    cul_de_sacs,
    dual_carriageways,
    frontage_roads,
    islands,
    one_way_pairs,
    parking_aisles,
)
from flexmap_tasks.simulate.roads import Draft
from flexmap_tasks.simulate.world import NetworkSettings

Feature = Callable[[Draft, int, np.random.Generator, NetworkSettings], None]


def build_features(draft: Draft, plan: NetworkSettings, rng_of: Callable[[str], np.random.Generator]) -> None:
    """Everything the settings ask for, in a fixed order, each with its own stream."""
    order: tuple[tuple[str, Feature], ...] = (
        ("overpasses", overpasses),
        ("roundabouts", roundabouts),
        ("one_way_pairs", one_way_pairs),
        ("dual_carriageways", dual_carriageways),
        ("islands", islands),
        ("slip_lanes", slip_lanes),
        ("frontage_roads", frontage_roads),
        ("parking_aisles", parking_aisles),
        ("cul_de_sacs", cul_de_sacs),
        ("living_streets", _living_streets),
        ("bus_lanes", _bus_lanes),
        ("bicycle_lanes", _bicycle_lanes),
        ("tag_changes", _tag_changes),
    )
    for name, feature in order:
        count = getattr(plan, name)
        if count:
            feature(draft, count, rng_of(name), plan)


def _living_streets(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    roads = [i for i in plain_roads(draft, 20.0, two_way=False) if draft.get(i).highway == "residential"]
    for i in shuffled(roads, rng)[:count]:
        draft.change(i, highway="living_street", maxspeed=7, surface="paving_stones")


def _bus_lanes(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    roads = [i for i in plain_roads(draft, 60.0) if min(draft.get(i).forward, draft.get(i).backward) >= 2]
    for i in shuffled(roads, rng)[:count]:
        draft.change(i, bus=True)


def _bicycle_lanes(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    for i in shuffled(plain_roads(draft, 60.0), rng)[:count]:
        draft.change(i, bicycle=True)


def _tag_changes(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    """Between junctions the limit, the surface or the name changes."""
    for k, i in enumerate(shuffled(plain_roads(draft, 80.0, two_way=False), rng)[:count]):
        road = draft.get(i)
        share = round(float(rng.uniform(0.35, 0.65)), 3)
        slower = 30 if road.maxspeed > 30 else 20
        change = (
            ("maxspeed", str(slower)),
            ("surface", "cobblestone" if road.surface != "cobblestone" else "asphalt"),
            ("name", f"Am {road.name}"),
        )[k % 3]
        draft.change(i, changes=(*road.changes, (share, *change)))
