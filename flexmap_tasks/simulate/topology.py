"""The roads of a real OpenStreetMap extract as a draft: its topology and tags, our lanes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from flexmap_tasks.config import OsmRoadsParams
from flexmap_tasks.errors import CoverageError
from flexmap_tasks.formats.osm_roads import read_road_elements
from flexmap_tasks.formats.osm_roads_elements import RoadElements
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.osm import rows_of
from flexmap_tasks.model.source import Source
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.frame import TownFrame
from flexmap_tasks.simulate.roads import Draft, Road
from flexmap_tasks.simulate.world import World

SHORT_M = 9.0
"""Junctions nearer than this become one: their lanes would not find room between them."""
SPEEDS = {"motorway": 120, "trunk": 100, "living_street": 7, "service": 20}
MOST_LANES = 6


def read_topology(world: World, source: Source) -> Draft:
    """Roads within `network.topology_radius_m` of the world's place.

    Raises InputError for an unreadable file, CoverageError when it has no road there.
    """
    elements = read_road_elements(source, frozenset(OsmRoadsParams().highways))
    place = world.place
    frame = TownFrame.at(place.lat_deg, place.lon_deg, place.height_m)
    draft = _draft(elements, frame, world)
    if not draft.living():
        raise CoverageError(
            source.name,
            f"no road within {world.network.topology_radius_m:g} m of {place.lat_deg:.5f}, {place.lon_deg:.5f}: "
            "set `place` to somewhere inside the extract",
        )
    return draft


def _draft(elements: RoadElements, frame: TownFrame, world: World) -> Draft:
    mirror = np.array([1.0 if world.driving_side == "right" else -1.0, 1.0])
    xy = frame.local(elements.lonlat_deg)
    inside = np.hypot(*xy.T) <= world.network.topology_radius_m
    xy = xy * mirror
    lanes = {}
    uses = np.zeros(len(xy), dtype=np.int64)
    for way_id in sorted(elements.ways):
        way = elements.ways[way_id]
        rows = (
            rows_of(elements.node_id, np.array(way.refs, dtype=np.int64))
            if way.road
            else np.empty(0, np.int64)
        )
        rows = rows[(rows >= 0)]
        rows = rows[inside[rows]]
        rows = rows[np.append(True, np.diff(rows) != 0)] if len(rows) else rows
        if len(rows) < 2:
            continue
        lanes[way_id] = (rows, dict(way.tags))
        uses[rows] += 1
        uses[rows[[0, -1]]] += 1
    draft, junctions = Draft(), dict[int, int]()
    for rows, tags in lanes.values():
        cuts = np.flatnonzero(uses[rows] > 1).tolist()
        for a, b in pairwise(sorted({0, *cuts, len(rows) - 1})):
            _add(draft, junctions, rows[a : b + 1].tolist(), xy, tags, world)
    _contract(draft)
    return draft


def _add(
    draft: Draft, junctions: dict[int, int], rows: list[int], xy: Floats, tags: dict[str, str], world: World
) -> None:
    """One road between two junctions; a loop is cut so that it has two ends."""
    if rows[0] == rows[-1]:
        if len(rows) > 3:
            half = len(rows) // 2
            _add(draft, junctions, rows[: half + 1], xy, tags, world)
            _add(draft, junctions, rows[half:], xy, tags, world)
        return
    for row in (rows[0], rows[-1]):
        if row not in junctions:
            junctions[row] = draft.node(xy[row])
    start, end = junctions[rows[0]], junctions[rows[-1]]
    line = xy[rows]
    if tags.get("oneway") in ("-1", "reverse"):
        start, end, line = end, start, line[::-1]
    draft.road(_road(start, end, line, tags, world))


def _road(start: int, end: int, line: Floats, tags: dict[str, str], world: World) -> Road:
    highway = tags["highway"]
    ring = tags.get("junction") in ("roundabout", "circular")
    one_way = tags.get("oneway") in ("yes", "1", "true", "-1", "reverse") or ring or highway == "motorway"
    text = tags.get("lanes", "")
    count = min(int(text), MOST_LANES) if text.isdecimal() and int(text) > 0 else (1 if one_way else 2)
    speed = tags.get("maxspeed", "")
    limit = int(speed) if speed.isdecimal() and 0 < int(speed) < 200 else SPEEDS.get(highway, 50)
    forward = count if one_way else max(1, (count + 1) // 2)
    level = int(tags["layer"]) if tags.get("layer") in ("1", "2") and tags.get("bridge", "no") != "no" else 0
    aisle = tags.get("service") == "parking_aisle"
    role = "roundabout" if ring else "parking_aisle" if aisle else "overpass" if level else ""
    width = 2.75 if highway == "service" else world.network.lane_width_m
    return Road(
        start, end, lines.rounded(line), highway, forward, 0 if one_way else max(1, count - forward), width,
        tags.get("name", ""), limit, tags.get("surface", ""), role, level=level,
    )  # fmt: skip


def _contract(draft: Draft) -> None:
    """Unite junctions that are too close, by taking the short road between them away."""
    for i in draft.living():
        road = draft.get(i)
        if road.length_m >= SHORT_M:
            continue
        draft.remove(i)
        for other, at_end in draft.arms(road.end):
            far = draft.get(other)
            if (far.start if at_end else far.end) == road.start:
                draft.remove(other)
                continue
            xyz = far.xyz.copy()
            xyz[-1 if at_end else 0] = draft.nodes[road.start]
            draft.change(other, xyz=xyz, **{"end" if at_end else "start": road.start})
