"""The truth of roads: lane counts, what the map does not have, and what changed between two dates."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.model.arrays import strings
from flexmap_tasks.simulate.hd_map import HdMap
from flexmap_tasks.simulate.lanes import LaneNetwork
from flexmap_tasks.simulate.osm import OsmTown, RoadPart

Table = dict[str, NDArray[Any]]
LANE_COLUMNS = ("lanelet_id", "road", "lane", "direction", "lanes_forward", "lanes_backward", "lanes_drawn", "way_id",
                "lanes_osm")  # fmt: skip
CAR_KINDS = ("lane", "bus")


def lane_table(lanes: LaneNetwork, hd_map: HdMap, osm: OsmTown) -> Table:
    """How many lanes the road of every lanelet really has, is drawn with, and has by OSM (-1: no tag)."""
    drawn: dict[int, set[int]] = {}
    here = [d for d in hd_map.lanelets if d.strip >= 0 and d.kind in CAR_KINDS]
    for lanelet in here:
        drawn.setdefault(lanes.strips[lanelet.strip].road, set()).add(lanelet.strip)
    rows = []
    for lanelet in here:
        strip = lanes.strips[lanelet.strip]
        road = lanes.network.roads[strip.road]
        middle = float(strip.road_s[lanelet.first : lanelet.last + 1].mean())
        parts = osm.parts.get(strip.road, [])
        way = next((p.way_id for p in parts if p.road_s[0] <= middle <= p.road_s[-1]), 0)
        said = int(osm.tags[way].get("lanes", "-1")) if way else -1
        rows.append((lanelet.id, strip.road, strip.lane, strip.direction, road.forward, road.backward,
                     len(drawn[strip.road]), way, said))  # fmt: skip
    table = np.array(rows, dtype=np.int64).reshape(-1, len(LANE_COLUMNS))
    return {name: np.ascontiguousarray(table[:, k]) for k, name in enumerate(LANE_COLUMNS)}


def way_table(lanes: LaneNetwork, hd_map: HdMap, osm: OsmTown) -> Table:
    """Every way cut into what the HD map has (drawn) and has not.

    kind : "road", "invented" (a road that does not exist) or "footway"; road : -1 where it is no road
    """
    rows: list[tuple[int, float, float, str, int, bool]] = []
    for road, parts in sorted(osm.parts.items()):
        spans = _drawn_spans(lanes, hd_map, road)
        for part in parts:
            low, high = float(part.road_s[0]), float(part.road_s[-1])
            edges = sorted({low, high, *(v for span in spans for v in span if low < v < high)})
            for a, b in pairwise(edges):
                inside = any(f <= (a + b) / 2 <= t for f, t in spans)
                rows.append((part.way_id, *_on_way(part, a, b), "road", road, inside))
    for way in osm.ways:
        if way.present and not way.chain:
            kind = "footway" if way.tags["highway"] == "footway" else "invented"
            rows.append((way.id, 0.0, osm.length_m[way.id], kind, -1, False))
    rows.sort(key=lambda r: r[:2])
    kinds: tuple[Any, ...] = (np.int64, np.float64, np.float64, None, np.int64, np.bool_)
    names = ("way_id", "way_s_from_m", "way_s_to_m", "kind", "road", "drawn")
    return {
        name: np.array([r[k] for r in rows], dtype=kinds[k]) if kinds[k] else strings(r[k] for r in rows)
        for k, name in enumerate(names)
    }


def _on_way(part: RoadPart, a: float, b: float) -> tuple[float, float]:
    low, high = sorted(np.interp([a, b], part.road_s, part.way_s).tolist())
    return low, high


def _drawn_spans(lanes: LaneNetwork, hd_map: HdMap, road: int) -> list[tuple[float, float]]:
    """Stretches of a road's line with lanelets; a junction belongs to the road that is drawn up to it."""
    if road not in hd_map.roads:
        return []
    strip = lanes.strips[lanes.road_strips[road][0]]
    s = np.sort(strip.road_s)
    length = lanes.network.roads[road].length_m
    return [
        (0.0 if first == 0 else float(s[first]), length if last == len(s) - 1 else float(s[last]))
        for first, last in hd_map.roads[road]
    ]


def change_table(osm_later: OsmTown) -> Table:
    """What the later extract has that the first had not; kind "tag", "geometry", "gone" or "new"."""
    changes = osm_later.changes
    return {
        "way_id": np.array([c.way_id for c in changes], dtype=np.int64),
        "kind": strings(c.kind for c in changes),
        "key": strings(c.key for c in changes),
        "old": strings(c.old for c in changes),
        "new": strings(c.new for c in changes),
    }
