"""Small maps and roads with known truth for the tests of transfer."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from pyproj import Transformer

from flexmap_tasks.config import CollapseParams, TransferParams
from flexmap_tasks.formats.osm_xml_write import write_osm_xml
from flexmap_tasks.ingest.lanelet_map import ingest_lanelet_map
from flexmap_tasks.matching.collapse import collapse
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.conflation import Enriched, Matches
from flexmap_tasks.model.lanelets import centrelines, lanelets_of, lengths_m
from flexmap_tasks.model.maps import LaneletMap, PlacedRoads, RoadNetwork
from flexmap_tasks.model.osm import Tags
from flexmap_tasks.model.source import Source
from flexmap_tasks.transfer.transfer import transfer

EAST_M, NORTH_M = 690_000.0, 5_335_000.0
LANE_M = 3.5


@dataclass
class Draft:
    """A Lanelet2 map being drawn; ids are given in order."""

    nodes: dict[int, tuple[float, float]] = field(default_factory=dict)
    ways: dict[int, tuple[list[int], dict[str, str]]] = field(default_factory=dict)
    relations: dict[int, tuple[list[tuple[str, int, str]], dict[str, str]]] = field(default_factory=dict)
    last: int = 0

    def new(self) -> int:
        self.last += 1
        return self.last

    def node(self, x: float, y: float) -> int:
        self.nodes[self.new()] = (x, y)
        return self.last

    def way(self, refs: list[int], **tags: str) -> int:
        self.ways[self.new()] = (refs, {"type": "line_thin", "subtype": "solid"} | tags)
        return self.last

    def relation(self, members: list[tuple[str, int, str]], **tags: str) -> int:
        self.relations[self.new()] = (members, tags)
        return self.last

    def lanelet(self, left: int, right: int, **tags: str) -> int:
        defaults = {
            "type": "lanelet",
            "subtype": "road",
            "location": "urban",
            "one_way": "yes",
            "speed_limit": "10",
        }
        members = [("way", left, "left"), ("way", right, "right")]
        return self.relation(members, **{k: v for k, v in (defaults | tags).items() if v})

    def write(self, path: Path) -> Path:
        to_lonlat = Transformer.from_crs(32632, 4326, always_xy=True).transform
        out = ['<?xml version="1.0" encoding="UTF-8"?>', '<osm version="0.6" generator="test">']
        for i, (x, y) in self.nodes.items():
            lon, lat = to_lonlat(EAST_M + x, NORTH_M + y)
            tags = _xml_tags({"local_x": f"{x:.4f}", "local_y": f"{y:.4f}", "ele": "1.5000"})
            out.append(f'<node id="{i}" lat="{lat:.11f}" lon="{lon:.11f}">{tags}</node>')
        for i, (refs, tags) in self.ways.items():
            out.append(
                f'<way id="{i}">' + "".join(f'<nd ref="{r}"/>' for r in refs) + _xml_tags(tags) + "</way>"
            )
        for i, (members, tags) in self.relations.items():
            body = "".join(f'<member type="{t}" ref="{r}" role="{o}"/>' for t, r, o in members)
            out.append(f'<relation id="{i}">{body}{_xml_tags(tags)}</relation>')
        path.write_text("\n".join([*out, "</osm>"]), encoding="utf-8")
        return path

    def read(self, folder: Path) -> LaneletMap:
        return read(self.write(folder / "before.osm"))

    def renumbered(self, random: np.random.Generator) -> tuple[Draft, dict[int, int]]:
        """The same map with other ids in another order, some ways drawn the other way; and old id to new."""
        new = dict(zip(range(1, self.last + 1), (random.permutation(self.last) + 1).tolist(), strict=True))
        turned = {i for i in self.ways if random.uniform() < 0.5}
        out = Draft(last=self.last)
        for i in random.permutation(sorted(self.nodes)).tolist():
            out.nodes[new[i]] = self.nodes[i]
        for i in random.permutation(sorted(self.ways)).tolist():
            refs = [new[r] for r in self.ways[i][0]]
            out.ways[new[i]] = (refs[::-1] if i in turned else refs, self.ways[i][1])
        for i in random.permutation(sorted(self.relations)).tolist():
            members = [(t, new[r], role) for t, r, role in self.relations[i][0]]
            out.relations[new[i]] = (members, self.relations[i][1])
        return out, new


def _xml_tags(tags: dict[str, str]) -> str:
    return "".join(f'<tag k="{k}" v="{v}"/>' for k, v in tags.items())


def read(path: Path) -> LaneletMap:
    return ingest_lanelet_map(Source(path.name, path))


@dataclass
class Road:
    """A straight road along x: `forward` lanes below the middle, `backward` above, in sections end to end."""

    draft: Draft
    forward: list[list[int]]
    backward: list[list[int]]
    bounds: list[list[int]]


def road(
    draft: Draft,
    sections: list[float],
    forward: int = 1,
    backward: int = 1,
    step_m: float = 10.0,
    **tags: str,
) -> Road:
    """Right-hand traffic; way j of a section is the bound at y = (j - forward) * LANE_M, drawn along x."""
    out = Road(draft, [], [], [])
    lines = forward + backward + 1
    x = 0.0
    ends = [draft.node(x, (j - forward) * LANE_M) for j in range(lines)]
    for length in sections:
        count = max(int(np.ceil(length / step_m)), 1)
        places = [x + length * i / count for i in range(1, count + 1)]
        bounds = []
        for j in range(lines):
            refs = [ends[j], *(draft.node(p, (j - forward) * LANE_M) for p in places)]
            ends[j] = refs[-1]
            bounds.append(draft.way(refs))
        out.bounds.append(bounds)
        out.forward.append([draft.lanelet(bounds[j + 1], bounds[j], **tags) for j in range(forward)])
        out.backward.append(
            [draft.lanelet(bounds[j], bounds[j + 1], **tags) for j in range(forward, lines - 1)]
        )
        x += length
    return out


def roads_of(tags: list[dict[str, str]]) -> PlacedRoads:
    """Roads 1, 2, ... with these tags; their geometry does not matter to transfer."""
    n = len(tags)
    network = RoadNetwork(
        way_id=np.arange(1, n + 1, dtype=np.int64) * 100,
        version=np.arange(1, n + 1, dtype=np.int64),
        timestamp=strings(["2023-11-01T00:00:00Z"] * n),
        offset=np.arange(n + 1, dtype=np.int64) * 2,
        node_id=np.arange(2 * n, dtype=np.int64),
        lonlat_deg=np.zeros((2 * n, 2)),
        tags=Tags.of(tags),
    )
    return PlacedRoads(network, np.zeros((2 * n, 2)))


def matches_of(rows: list[tuple[int, float, float, int, int]], **columns: list[object]) -> Matches:
    """Matches (lanelet id, from, to, way id, direction); `decision` and `confidence` may be given."""
    n = len(rows)
    ids, start, end, way, direction = (
        (list(c) for c in zip(*rows, strict=True)) if rows else ([], [], [], [], [])
    )
    ones, nan = np.ones(n), np.full(n, np.nan)
    return Matches(
        lanelet_id=np.array(ids, dtype=np.int64),
        s_from_m=np.array(start, dtype=np.float64),
        s_to_m=np.array(end, dtype=np.float64),
        way_id=np.array(way, dtype=np.int64),
        way_s_from_m=np.zeros(n),
        way_s_to_m=ones,
        direction=np.array(direction, dtype=np.int64),
        score=ones,
        confidence=np.array(columns.get("confidence", ones), dtype=np.float64),
        decision=strings(columns.get("decision", ["match"] * n)),
        reason=strings([""] * n),
        reference=np.zeros(n, dtype=np.int64),
        d_angle_deg=nan,
        d_length_m=nan,
        d_chord_m=nan,
        d_area_m=nan,
    )


def along_x(
    lanelet_map: LaneletMap,
    stops: list[float],
    reach: tuple[float, float] = (-1e9, 1e9),
    shift: dict[int, float] | None = None,
) -> Matches:
    """Match every lanelet to way 100, 200, ... between the given x; lanelets run along x or against it.

    shift : per lanelet id, by how much its own stops lie elsewhere
    """
    lanelets = lanelets_of(lanelet_map)
    line = centrelines(lanelet_map, lanelets)
    length = lengths_m(line)
    rows = []
    for k, i in enumerate(lanelets.id.tolist()):
        edges = [-1e9, *(s + (shift or {}).get(i, 0.0) for s in stops), 1e9]
        a, b = (float(line.xyz_m[v, 0]) for v in (line.offset[k], line.offset[k + 1] - 1))
        for w in range(len(edges) - 1):
            low = max(min(a, b), edges[w], reach[0])
            high = min(max(a, b), edges[w + 1], reach[1])
            if high > low:
                s = sorted((x - a) / (b - a) * length[k] for x in (low, high))
                rows.append((i, s[0], s[1], (w + 1) * 100, 1 if b > a else -1))
    return matches_of(rows)


def run(
    lanelet_map: LaneletMap,
    matches: Matches,
    roads: PlacedRoads,
    params: TransferParams | None = None,
    last_release: LaneletMap | None = None,
) -> Enriched:
    centerlines = collapse(lanelet_map, CollapseParams())
    return transfer(
        lanelet_map, centerlines, matches, roads, params or TransferParams(), last_release=last_release
    )


def edited(lanelet_map: LaneletMap, lanelet_id: int, key: str, value: str) -> LaneletMap:
    """The map after a person has changed one value."""
    relations = lanelet_map.document.relations
    row = np.flatnonzero(relations.id == lanelet_id)
    tags = relations.tags.with_values(row, [key], [value])
    return replace(
        lanelet_map, document=replace(lanelet_map.document, relations=replace(relations, tags=tags))
    )


def tags_of(lanelet_map: LaneletMap, lanelet_id: int) -> dict[str, str]:
    relations = lanelet_map.document.relations
    return relations.tags.of_element(int(np.flatnonzero(relations.id == lanelet_id)[0]))


def members_of(lanelet_map: LaneletMap, relation_id: int) -> list[tuple[str, int, str]]:
    relations = lanelet_map.document.relations
    row = int(np.flatnonzero(relations.id == relation_id)[0])
    at = slice(int(relations.offset[row]), int(relations.offset[row + 1]))
    columns = (relations.member_type, relations.member_ref, relations.member_role)
    return list(zip(*(c[at].tolist() for c in columns), strict=True))


def save(lanelet_map: LaneletMap, path: Path) -> Path:
    path.write_bytes(write_osm_xml(lanelet_map.document))
    return path


def rows(enriched: Enriched, **wanted: object) -> list[dict[str, object]]:
    """Rows of the table of transfers with these values."""
    table = enriched.transfers
    names = list(type(table).__slots__)
    every = (
        dict(zip(names, r, strict=True))
        for r in zip(*(getattr(table, n).tolist() for n in names), strict=True)
    )
    return [r for r in every if all(r[k] == v for k, v in wanted.items())]
