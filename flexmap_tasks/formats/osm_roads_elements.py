"""What a reader of OpenStreetMap keeps while it reads: every way's newest state, and the nodes of roads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np

from flexmap_tasks.model.arrays import Floats, Ints

BUILT_UP = ("residential", "commercial", "retail", "industrial", "garages", "village_green", "institutional")
OPEN_LAND = ("farmland", "forest", "meadow", "orchard", "vineyard")
"""Values of `landuse` that towns are made of, and what lies between towns."""
CITY_LIMITS = {"city_limit": 0, "DE:310": 1, "DE:311": -1}
"""Signs that traffic passes where it enters a town (+1) or leaves it (-1); 0 where `city_limit` says which."""

NO_NODE = -(2**63)
"""Stands for a reference that is no number; never the id of a node."""


class RoadWay(NamedTuple):
    """One state of a way; of two states the greater tuple is the newer one, in whatever order they come.

    version : 0 where the extract has none; timestamp : RFC 3339 UTC or ""
    road : it is a road and not deleted; without that, timestamp and tags stay empty
    refs : nodes, of roads and of ways that bound land
    """

    version: int
    timestamp: str
    road: bool
    refs: tuple[int, ...] = ()
    tags: tuple[tuple[str, str], ...] = ()


class Land(NamedTuple):
    """An area: its outer ways, by nodes, that make one or several rings together; of `BUILT_UP` or not."""

    built_up: bool
    outlines: tuple[tuple[int, ...], ...]


@dataclass(frozen=True, slots=True)
class RoadElements:
    """The roads of an extract, and where their nodes lie.

    ways : newest state of every way by its id, those that are no roads with `road` False
    node_id : (n,) int64, ascending, unique; lonlat_deg : (n, 2) float64, usable positions only
    remark : what the server that made the extract had to say ("" where it said nothing)
    lands : areas of towns and between them, in no order
    city_limits : +1 by node where traffic along the way enters a town, -1 where it leaves one
    """

    ways: Mapping[int, RoadWay]
    node_id: Ints
    lonlat_deg: Floats
    remark: str
    lands: tuple[Land, ...] = ()
    city_limits: Mapping[int, int] = field(default_factory=dict)


@dataclass(slots=True)
class NewestWays:
    """Collects ways; the newest state of each wins.

    highways : values of `highway` that make a way a road
    uses : ways around land, and whether it is built up; groups : the same of ways that make rings together
    """

    highways: frozenset[str]
    ways: dict[int, RoadWay] = field(default_factory=dict)
    uses: dict[int, bool] = field(default_factory=dict)
    groups: list[tuple[bool, tuple[int, ...]]] = field(default_factory=list)

    def is_road(self, tags: Mapping[str, str]) -> bool:
        """Vehicles drive along it: one of the highways, and no area."""
        return tags.get("highway") in self.highways and tags.get("area") != "yes"

    def bounds_land(self, tags: Mapping[str, str]) -> bool:
        """The way may bound land: by what it says, or, without any tags, as a member of a relation."""
        return not tags or land_use(tags) is not None

    def lands(self) -> tuple[Land, ...]:
        """All land whose outline is known."""
        closed = [(use, (way,)) for way, use in self.uses.items()]
        found = (
            Land(use, tuple(self.ways[way].refs for way in members if way in self.ways))
            for use, members in (*closed, *self.groups)
        )
        return tuple(land for land in found if any(land.outlines))

    def add(self, way_id: int, way: RoadWay) -> None:
        """Take a state of a way into account."""
        seen = self.ways.get(way_id)
        if seen is None or way > seen:
            self.ways[way_id] = way


def land_use(tags: Mapping[str, str]) -> bool | None:
    """Whether the land is built up, None where its use says nothing about that."""
    use = tags.get("landuse")
    return True if use in BUILT_UP else False if use in OPEN_LAND else None


def city_limit(tags: Mapping[str, str]) -> int:
    """+1 where traffic along the way enters a town at a node with these tags, -1 where it leaves one, else 0."""
    faces = {"forward": 1, "backward": -1}.get(tags.get("direction", ""), 0)
    for key, sense in (("traffic_sign:forward", 1), ("traffic_sign:backward", -1), ("traffic_sign", faces)):
        signs = [CITY_LIMITS[s] for s in _signs(tags.get(key, "")) if s in CITY_LIMITS]
        if not signs:
            continue
        enters = signs[0] or {"end": -1, "both": 0}.get(tags.get("city_limit", ""), 1)
        return sense * enters
    return 0


def _signs(text: str) -> list[str]:
    return text.replace(",", ";").split(";")[:8]


def utc_timestamp(text: str) -> str:
    """The instant as `2023-11-06T09:41:57Z`; "" where there is none or it says 1970 and before, which is none."""
    try:
        moment = datetime.fromisoformat(text)
        moment = moment.astimezone(UTC) if moment.tzinfo else moment.replace(tzinfo=UTC)
    except (ValueError, OverflowError):
        return ""
    return moment.strftime("%Y-%m-%dT%H:%M:%SZ") if moment.year > 1970 else ""


def newest_nodes(ids: Ints, versions: Ints, lonlat_deg: Floats) -> tuple[Ints, Floats]:
    """Of every node the newest state, by id, unless that has no usable position.

    ids, versions : (n,) in any order; lonlat_deg : (n, 2), NaN for a deleted node
    """
    order = np.lexsort((lonlat_deg[:, 1], lonlat_deg[:, 0], versions, ids))
    ids, lonlat_deg = ids[order], lonlat_deg[order]
    newest = np.ones(len(ids), dtype=bool)
    newest[:-1] = ids[1:] != ids[:-1]
    usable = (np.abs(lonlat_deg) <= (180.0, 90.0)).all(axis=1)
    return ids[newest & usable], lonlat_deg[newest & usable]
