"""Bus lanes, cycle lanes and shoulders: does the map have what OpenStreetMap says, on each side of the road?"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flexmap_tasks.model.arrays import Bools, Ints, Strings, strings
from flexmap_tasks.model.conflation import Transfers
from flexmap_tasks.model.lanelets import adjacency
from flexmap_tasks.model.maps import Lanelets, PlacedRoads
from flexmap_tasks.transfer.cuts.cut import Pieces
from flexmap_tasks.transfer.cuts.places import tied_groups
from flexmap_tasks.transfer.facts import LaneletFacts
from flexmap_tasks.transfer.lane_check import LaneCounts
from flexmap_tasks.transfer.values import count, one_way_sense

KINDS: Mapping[str, tuple[str, ...]] = {
    "bus_lane": ("bus_lane",),
    "bicycle_lane": ("bicycle_lane",),
    "road_shoulder": ("road_shoulder", "emergency_lane"),
}
"""What is compared, and the subtypes of lanelets that stand for it."""
_YES, _NO = ("yes", "lane", "designated", "both"), ("no", "none")


def side_lanes(tags: Mapping[str, str], sense: int, right_hand: bool) -> dict[str, int]:
    """Number of lanes of each kind for traffic along the way (`sense` +1) or against it; what is not said is absent.

    On a one-way road both sides belong to its direction. Source: OSM wiki, busway, cycleway, shoulder, lanes:bus.
    """
    both = bool(one_way_sense(tags))
    mine = "right" if (sense > 0) == right_hand else "left"
    sides = ("left", "right") if both else (mine,)
    direction = "forward" if sense > 0 else "backward"
    buses = _bus_lanes(tags, (f":{direction}", "") if both else (f":{direction}",))
    found = {
        "bus_lane": _by_side(tags, "busway", sides) if buses is None else buses,
        "bicycle_lane": _by_side(tags, "cycleway", sides),
        "road_shoulder": _by_side(tags, "shoulder", sides),
    }
    return {kind: number for kind, number in found.items() if number is not None}


def _bus_lanes(tags: Mapping[str, str], suffixes: tuple[str, ...]) -> int | None:
    """From `lanes:bus`, `lanes:psv`, `bus:lanes` and `psv:lanes` of a direction."""
    for suffix in suffixes:
        for vehicle in ("bus", "psv"):
            number = count(tags.get(f"lanes:{vehicle}{suffix}", ""))
            if number is not None:
                return number
            lanes = tags.get(f"{vehicle}:lanes{suffix}", "")
            if lanes:
                return lanes.split("|").count("designated")
    return None


def _by_side(tags: Mapping[str, str], key: str, sides: tuple[str, ...]) -> int | None:
    """Sides that have it; None where no side is mentioned. `key=right` says that the left has none."""
    plain = tags.get(key, "").strip().lower()
    sided = any(tags.get(f"{key}:{side}", "").strip() for side in (*sides, "both"))
    if len(sides) > 1 and not sided and plain in _YES and plain != "both":
        return 1  # on a one-way road a value without a side stands for one lane
    said = []
    for side in sides:
        value = tags.get(f"{key}:{side}", "").strip().lower() or tags.get(f"{key}:both", "").strip().lower()
        if not value and plain in ("left", "right"):
            value = "yes" if plain == side else "no"
        value = value or plain
        said += [1] if value in _YES else [0] if value in _NO else []
    return sum(said) if said else None


def drives_on_the_right(lanelets: Lanelets) -> bool:
    """Traffic that comes towards a lanelet is on its left, as most neighbours in the map show."""
    near = adjacency(lanelets)
    towards = ~near.same_direction & lanelets.one_way[near.lanelet] & lanelets.one_way[near.neighbour]
    return bool(np.count_nonzero(near.on_left[towards]) * 2 >= np.count_nonzero(towards))


def check_sides(
    facts: LaneletFacts,
    pieces: Pieces,
    road: Ints,
    sense: Ints,
    chosen: Bools,
    counts: LaneCounts,
    roads: PlacedRoads,
) -> Transfers:
    """A review per carriageway, direction and way where OSM's and the map's numbers differ.

    A kind of which the map has not one lanelet is not drawn in it, and not missed.
    road, sense, chosen : (p,) per piece: row of its way, direction along it, and whether it is to be looked at.
    The row names the outermost lane.
    """
    lanelets, line = facts.lanelets, facts.centreline
    group = tied_groups(lanelets)
    run = line.xyz_m[line.offset[1:] - 1, :2] - line.xyz_m[line.offset[:-1], :2]
    outermost: dict[tuple[int, int, int], int] = {}
    for p in np.lexsort((pieces.lanelet_id, counts.lane[pieces.source])).tolist():
        if chosen[p] and road[p] >= 0:
            outermost[int(group[pieces.source[p]]), int(road[p]), int(sense[p])] = p
    order = np.argsort(group, kind="stable")
    start = np.searchsorted(group[order], np.arange(group.max(initial=-1) + 2))
    right_hand = drives_on_the_right(lanelets)
    subtype = lanelets.subtype.astype(str)
    drawn_kinds = [kind for kind, subtypes in KINDS.items() if np.isin(subtype, subtypes).any()]
    found: list[tuple[int, str, int, int]] = []
    for (g, r, s), p in outermost.items():
        members = order[start[g] : start[g + 1]]
        beside = members[run[members] @ run[pieces.source[p]] > 0]
        for kind, number in side_lanes(roads.network.tags.of_element(r), s, right_hand).items():
            drawn = int(np.isin(subtype[beside], KINDS[kind]).sum())
            if kind in drawn_kinds and drawn != number:
                found.append((p, kind, drawn, number))
    return _rows(found, facts, pieces, road, roads)


def _rows(
    found: list[tuple[int, str, int, int]],
    facts: LaneletFacts,
    pieces: Pieces,
    road: Ints,
    roads: PlacedRoads,
) -> Transfers:
    at = np.array([f[0] for f in found], dtype=np.int64)
    way = road[at]
    action: Strings = np.full(len(at), "review", dtype=object)
    return Transfers(
        lanelet_id=pieces.lanelet_id[at],
        source_lanelet_id=facts.lanelets.id[pieces.source[at]],
        key=strings(f[1] for f in found),
        old=strings(str(f[2]) for f in found),
        new=strings(str(f[3]) for f in found),
        way_id=roads.network.way_id[way],
        way_version=roads.network.version[way],
        way_timestamp=roads.network.timestamp[way],
        confidence=np.ones(len(at)),
        action=action,
        reason=strings(f"OSM has {f[3]} in this direction, the map {f[2]}" for f in found),
    )
