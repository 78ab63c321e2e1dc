"""The truth of conflation: where every lanelet lies in OpenStreetMap, and what it should learn there."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.model.arrays import Floats, strings
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.hd_drawing import DrawnLanelet
from flexmap_tasks.simulate.hd_map import HdMap
from flexmap_tasks.simulate.lanes import LaneNetwork, Strip
from flexmap_tasks.simulate.osm import OsmTown, RoadPart

Table = dict[str, NDArray[Any]]
LEAST_PIECE_M = 1e-6
MATCH_COLUMNS = ("lanelet_id", "s_from_m", "s_to_m", "lanelet_length_m", "way_id", "way_s_from_m", "way_s_to_m",
                 "direction", "class", "reason", "road", "also_way_id")  # fmt: skip
TAG_COLUMNS = ("lanelet_id", "s_from_m", "s_to_m", "lanelet_length_m", "key", "value", "osm_value", "way_id")
TEXT_COLUMNS = ("class", "reason", "key", "value", "osm_value")
NUMBER_COLUMNS = ("lanelet_id", "way_id", "direction", "road", "also_way_id")
RURAL = ("motorway", "motorway_link", "trunk", "trunk_link")
SUBTYPES = {"motorway": "highway", "motorway_link": "highway", "living_street": "play_street"}
KNOWN = ("maxspeed", "name", "surface")


def match_tables(lanes: LaneNetwork, hd_map: HdMap, osm: OsmTown) -> tuple[Table, Table]:
    """Truth of matching, and of the values each piece should get.

    The pieces of a lanelet cover it without gap. Lanelets that are no lanes for cars have no rows.
    """
    writer = _Writer(lanes, osm)
    for lanelet in hd_map.lanelets:
        if lanelet.kind == "fragment":
            writer.fragment(lanelet, hd_map)
        elif lanelet.strip >= 0 and lanes.strips[lanelet.strip].drivable:
            strip = lanes.strips[lanelet.strip]
            line = lanes.centreline(strip)[lanelet.first : lanelet.last + 1]
            (writer.turn if strip.kind == "turn" else writer.link)(lanelet, strip, line)
    return _columns(MATCH_COLUMNS, writer.matches), _columns(TAG_COLUMNS, writer.tags)


def _columns(names: tuple[str, ...], rows: list[tuple[Any, ...]]) -> Table:
    out: Table = {}
    for k, name in enumerate(names):
        values = [r[k] for r in rows]
        kind = np.int64 if name in NUMBER_COLUMNS else np.float64
        out[name] = strings(values) if name in TEXT_COLUMNS else np.array(values, dtype=kind)
    return out


@dataclass(slots=True)
class _Stretch:
    """A stretch of a lanelet that runs along a road; road_s (n,) rising, s (n,) along the lanelet."""

    lanelet: DrawnLanelet
    length_m: float
    road: int
    direction: int
    road_s: Floats
    s: Floats
    kind: str
    also_way: int = 0

    def at(self, road_s: list[float]) -> tuple[float, float]:
        """Lowest and highest place on the lanelet of two places on the road."""
        low, high = sorted(np.interp(road_s, self.road_s, self.s).tolist())
        return low, high


@dataclass(slots=True)
class _Writer:
    lanes: LaneNetwork
    osm: OsmTown
    matches: list[tuple[Any, ...]] = field(default_factory=list)
    tags: list[tuple[Any, ...]] = field(default_factory=list)

    def fragment(self, lanelet: DrawnLanelet, hd_map: HdMap) -> None:
        """A piece of lane that stands for nothing."""
        length = hd_map.fragment_length_m(lanelet)
        self.matches.append(
            (lanelet.id, 0.0, length, length, 0, np.nan, np.nan, 0, "none", "fragment", -1, 0)
        )

    def link(self, lanelet: DrawnLanelet, strip: Strip, line: Floats) -> None:
        """A lane on a road."""
        road_s, s = strip.road_s[lanelet.first : lanelet.last + 1], lines.along(line)
        kind = "stub" if lanelet.stub else "link"
        rising = slice(None, None, strip.direction)
        self._along(
            _Stretch(lanelet, float(s[-1]), strip.road, strip.direction, road_s[rising], s[rising], kind)
        )

    def turn(self, lanelet: DrawnLanelet, strip: Strip, line: Floats) -> None:
        """A turn: up to where it passes the junction on the first road, from there on the second.

        A fair judge accepts either of the two roads; the other one's way is named in `also_way_id`.
        """
        length = float(lines.along(line)[-1])
        middle = self._middle(strip, line)
        ends = [(strip.road, strip.direction, True), (strip.to_road, strip.to_direction, False)]
        spans = []
        for road, direction, arriving in ends:
            at_end = (direction > 0) == arriving
            total = self.lanes.network.roads[road].length_m
            spans.append(
                (total - self.lanes.trims[road, True], total)
                if at_end
                else (0.0, self.lanes.trims[road, False])
            )
        ways = [self._way(road, sum(span) / 2) for (road, _, _), span in zip(ends, spans, strict=True)]
        for k, (road, direction, _) in enumerate(ends):
            s = np.array([0.0, middle] if k == 0 else [middle, length])
            also = ways[1 - k] if ways[1 - k] != ways[k] else 0
            self._along(
                _Stretch(
                    lanelet, length, road, direction, np.array(spans[k]), s[::direction], "junction", also
                )
            )

    def _middle(self, strip: Strip, line: Floats) -> float:
        """Where along a turn it passes the junction's node."""
        fine = lines.resample(line, 0.1)
        off = fine[:, :2] - self.lanes.network.node_xyz[strip.node, :2]
        s = lines.along(fine)
        return float(np.clip(s[int(np.argmin(np.hypot(*off.T)))], 0.02 * s[-1], 0.98 * s[-1]))

    def _way(self, road: int, road_s: float) -> int:
        part = self._part(road, road_s)
        return part.way_id if part else 0

    def _part(self, road: int, road_s: float) -> RoadPart | None:
        parts = self.osm.parts.get(road, [])
        return next((p for p in parts if p.road_s[0] <= road_s <= p.road_s[-1]), None)

    def _along(self, stretch: _Stretch) -> None:
        """Rows for every way part that the stretch runs along, and for its tags."""
        low, high = float(stretch.road_s[0]), float(stretch.road_s[-1])
        parts = self.osm.parts.get(stretch.road, [])
        edges = {low, high, *(float(p.road_s[0]) for p in parts if low < p.road_s[0] < high)}
        for a, b in pairwise(sorted(edges)):
            if b - a > LEAST_PIECE_M:
                self._match(stretch, a, b)
        edges |= {f for f, _, _ in self.lanes.network.roads[stretch.road].sections() if low < f < high}
        for a, b in pairwise(sorted(edges)):
            if b - a > LEAST_PIECE_M:
                self._tag(stretch, a, b)

    def _match(self, stretch: _Stretch, a: float, b: float) -> None:
        part, s = self._part(stretch.road, (a + b) / 2), stretch.at([a, b])
        head = (stretch.lanelet.id, *s, stretch.length_m)
        if part is None:
            self.matches.append(
                (*head, 0, np.nan, np.nan, 0, "none", "missing_in_osm", stretch.road, stretch.also_way)
            )
            return
        way = sorted(np.interp([a, b], part.road_s, part.way_s).tolist())
        direction = stretch.direction * part.direction
        self.matches.append(
            (*head, part.way_id, *way, direction, stretch.kind, "", stretch.road, stretch.also_way)
        )

    def _tag(self, stretch: _Stretch, a: float, b: float) -> None:
        road = self.lanes.network.roads[stretch.road]
        section = next(t for f, _, t in reversed(road.sections()) if f <= (a + b) / 2)
        part = self._part(stretch.road, (a + b) / 2)
        offered = expected(self.osm.tags[part.way_id]) if part else {}
        for key, value in expected(section | {"highway": road.highway}).items():
            self.tags.append(
                (stretch.lanelet.id, *stretch.at([a, b]), stretch.length_m, key, value, offered.get(key, ""),
                 part.way_id if part else 0)
            )  # fmt: skip


def expected(tags: dict[str, str]) -> dict[str, str]:
    """Lanelet2 attributes of a road with these OSM tags; "" where nothing is known."""
    highway = tags["highway"]
    speed, name, surface = (tags.get(k, "") for k in KNOWN)
    return {
        "speed_limit": speed,
        "road_name": name,
        "road_surface": surface,
        "location": "nonurban" if highway in RURAL else "urban",
        "subtype": SUBTYPES.get(highway, "road"),
    }
