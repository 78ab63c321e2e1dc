"""What a reader of OpenStreetMap keeps while it reads: every way's newest state, and the nodes of roads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np

from flexmap_tasks.model.arrays import Floats, Ints

NO_NODE = -(2**63)
"""Stands for a reference that is no number; never the id of a node."""


class RoadWay(NamedTuple):
    """One state of a way; of two states the greater tuple is the newer one, in whatever order they come.

    version : 0 where the extract has none; timestamp : RFC 3339 UTC or ""
    road : it is a road and not deleted; without that, timestamp, refs and tags stay empty
    """

    version: int
    timestamp: str
    road: bool
    refs: tuple[int, ...] = ()
    tags: tuple[tuple[str, str], ...] = ()


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

    def is_road(self, tags: Mapping[str, str]) -> bool:
        """Vehicles drive along it: one of the highways, and no area."""
        return tags.get("highway") in self.highways and tags.get("area") != "yes"

    def add(self, way_id: int, way: RoadWay) -> None:
        """Take a state of a way into account."""
        seen = self.ways.get(way_id)
        if seen is None or way > seen:
            self.ways[way_id] = way


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
