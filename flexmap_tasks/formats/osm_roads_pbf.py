"""Roads from OpenStreetMap PBF through libosmium: the ways first, then the nodes they need."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import osmium

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.osm_roads_elements import (
    NewestWays,
    RoadElements,
    RoadWay,
    city_limit,
    land_use,
    newest_nodes,
    utc_timestamp,
)
from flexmap_tasks.model.source import Source

REFERENCES_PER_BYTE = 8
"""Real files hold less than one way or reference to a node per byte; compressed zeros hold hundreds."""


def read_pbf_roads(source: Source, highways: frozenset[str]) -> RoadElements:
    """The roads of a PBF file; raises InputError when it is damaged."""
    try:
        newest = _ways(source, highways)
        wanted = {ref for way in newest.ways.values() for ref in way.refs}
        newest_position: dict[int, tuple[int, float, float]] = {}
        limits: dict[int, int] = {}
        for node in _elements(source, osmium.osm.NODE):
            if node.id in wanted:
                sense = city_limit({tag.k: tag.v for tag in node.tags}) if len(node.tags) else 0
                limits |= {node.id: sense} if sense else {}
                state = _state(node)
                newest_position[node.id] = max(newest_position.get(node.id, state), state)
    except InputError:
        raise
    except (RuntimeError, ValueError) as error:
        rule = f"the OpenStreetMap PBF is damaged or cut off ({str(error)[:200]}); fetch it again"
        raise InputError(source.name, rule) from None
    ids = np.array(list(newest_position), dtype=np.int64)
    lonlat = np.array([state[1:] for state in newest_position.values()], dtype=np.float64).reshape(-1, 2)
    nodes = newest_nodes(ids, np.zeros_like(ids), lonlat)
    return RoadElements(newest.ways, *nodes, "", newest.lands(), limits)


def _ways(source: Source, highways: frozenset[str]) -> NewestWays:
    newest = NewestWays(highways)
    budget = 1_000_000 + REFERENCES_PER_BYTE * source.path.stat().st_size
    for way in _elements(source, osmium.osm.WAY):
        version = max(way.version, 0)
        road = way.visible and way.tags.get("highway") in highways
        land = way.visible and (not len(way.tags) or "landuse" in way.tags)
        budget -= 1 + (len(way.nodes) if road or land else 0)
        if budget < 0:
            rule = "the file claims far more ways and nodes than its size can hold; it is no OpenStreetMap extract"
            raise InputError(source.name, rule, f"way {way.id}")
        tags = {tag.k: tag.v for tag in way.tags} if road or land else {}
        bounds = land and newest.bounds_land(tags)
        newest.add(way.id, RoadWay(version, "", False, tuple(n.ref for n in way.nodes) if bounds else ()))
        use = land_use(tags)
        if bounds and use is not None:
            newest.uses[way.id] = use
        if not road:
            continue
        if newest.is_road(tags):
            refs = tuple(node.ref for node in way.nodes)
            newest.add(way.id, RoadWay(version, _stamp(way), True, refs, tuple(sorted(tags.items()))))
    for relation in _elements(source, osmium.osm.RELATION):
        use = land_use({"landuse": relation.tags.get("landuse")}) if relation.visible else None
        if use is not None:
            outer = tuple(m.ref for m in relation.members if m.type == "w" and m.role != "inner")
            newest.groups.append((use, outer))
    return newest


def _elements(source: Source, kind: Any) -> Iterator[Any]:
    """All elements of a kind; libosmium's own filter by id would take memory by the size of the ids."""
    return iter(osmium.FileProcessor(osmium.io.File(str(source.path), "pbf"), kind))


def _state(node: Any) -> tuple[int, float, float]:
    """Version, longitude and latitude, of which the greatest counts; infinite where deleted or nowhere."""
    if node.visible and node.location.valid():
        return max(node.version, 0), node.lon, node.lat
    return max(node.version, 0), math.inf, math.inf


def _stamp(way: Any) -> str:
    return utc_timestamp(way.timestamp.isoformat()) if way.version > 0 else ""
