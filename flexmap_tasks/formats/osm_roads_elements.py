"""What a reader of OpenStreetMap keeps while it reads: every way's newest state, and the nodes of roads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import NamedTuple

from flexmap_tasks.model.arrays import Floats, Ints


class RoadWay(NamedTuple):
    """One state of a way; of two states the greater tuple is the newer one, in whatever order they come.

    version : 0 where the extract has none; timestamp : RFC 3339 UTC or ""
    road : it is a road and not deleted; refs, tags : () unless it is one
    """

    version: int
    timestamp: str
    road: bool
    refs: tuple[int, ...]
    tags: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class RoadElements:
    """The roads of an extract, and where their nodes lie.

    ways : newest state of every way by its id, those that are no roads with `road` False
    node_id : (n,) int64, ascending, unique; lonlat_deg : (n, 2) float64, usable positions only
    remark : what the server that made the extract had to say ("" where it said nothing)
    """

    ways: Mapping[int, RoadWay]
    node_id: Ints
    lonlat_deg: Floats
    remark: str


@dataclass(slots=True)
class NewestWays:
    """Collects ways; the newest state of each wins.

    highways : values of `highway` that make a way a road
    """

    highways: frozenset[str]
    ways: dict[int, RoadWay] = field(default_factory=dict)

    def add(
        self,
        way_id: int,
        version: int,
        timestamp: str,
        visible: bool,
        refs: tuple[int, ...],
        tags: Mapping[str, str],
    ) -> None:
        """Take a state of a way into account."""
        if visible and is_road(tags, self.highways):
            way = RoadWay(max(version, 0), timestamp, True, refs, tuple(sorted(tags.items())))
        else:
            way = RoadWay(max(version, 0), timestamp, False, (), ())
        seen = self.ways.get(way_id)
        if seen is None or way > seen:
            self.ways[way_id] = way


def is_road(tags: Mapping[str, str], highways: frozenset[str]) -> bool:
    """Vehicles drive along it: one of the highways, and no area."""
    return tags.get("highway") in highways and tags.get("area") != "yes"


def utc_timestamp(text: str) -> str:
    """The instant as `2023-11-06T09:41:57Z`; "" where there is none or it says 1970 and before, which is none."""
    try:
        moment = datetime.strptime(text, "%Y-%m-%dT%H:%M:%S%z") if text else None
    except ValueError:
        return ""
    if moment is None or moment.timestamp() <= 0:
        return ""
    return datetime.fromtimestamp(moment.timestamp(), moment.tzinfo).strftime("%Y-%m-%dT%H:%M:%SZ")
