"""Carry out a plan of cuts: new nodes, two ways for one, two lanelets for one, and all that refers to them.

The first piece keeps the id. New ids depend only on what is cut and where, so that they stay the same when other
places of the map change.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexmap_tasks.model.arrays import Floats, Ints, strings
from flexmap_tasks.model.maps import LaneletMap
from flexmap_tasks.model.osm import OsmDocument, OsmNodes, OsmRelations, OsmWays, Tags, node_rows, rows_of
from flexmap_tasks.transfer.cuts.members import Member, MemberWriter
from flexmap_tasks.transfer.cuts.places import CutPlan
from flexmap_tasks.transfer.facts import LaneletFacts

RULE, NODE, WAY, LANELET = 0, 1, 2, 3
_ID_BITS = 30
"""New ids lie in 2**30 to 2**31, where no map maker's do and 32 bits still hold them."""
_PLACE_PER_M = 10.0
"""Places within a decimetre are one for the choice of an id."""
_DIGITS = {"lat": 11, "lon": 11}


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """The lanelets after cutting, by old lanelet and place.

    source : (p,) int64 row of the old lanelet; s_from_m, s_to_m : (p,) float64 on its centreline
    lanelet_id : (p,) int64; relation_row : (p,) int64 in the new document
    """

    source: Ints
    s_from_m: Floats
    s_to_m: Floats
    lanelet_id: Ints
    relation_row: Ints

    def __len__(self) -> int:
        return len(self.source)


class NewIds:
    """New ids from what they stand for (splitmix64 finaliser), clear of all ids in the document."""

    def __init__(self, document: OsmDocument) -> None:
        parts = (document.nodes.id, document.ways.id, document.relations.id, document.relations.member_ref)
        self.used = set(np.concatenate([*parts, document.ways.ref]).tolist())

    def new(self, kind: int, source: int, place_m: float) -> int:
        """An id for what is made of `source` at a place."""
        seed = (source * 4 + kind) * 2**24 + round(place_m * _PLACE_PER_M)
        while True:
            seed = (seed + 0x9E3779B97F4A7C15) % 2**64
            z = seed
            z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) % 2**64
            z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) % 2**64
            candidate = 2**_ID_BITS + (z ^ (z >> 31)) % 2**_ID_BITS
            if candidate not in self.used:
                self.used.add(candidate)
                return int(candidate)


def whole(facts: LaneletFacts) -> Pieces:
    """Every lanelet as its own only piece."""
    k = len(facts.lanelets)
    return Pieces(
        np.arange(k), np.zeros(k), facts.length_m.copy(), facts.lanelets.id, facts.lanelets.relation_row
    )


def cut_map(lanelet_map: LaneletMap, facts: LaneletFacts, plan: CutPlan) -> tuple[LaneletMap, Pieces]:
    """The map after all cuts, and what became of its lanelets."""
    if not plan.ways:
        return lanelet_map, whole(facts)
    document, ids = lanelet_map.document, NewIds(lanelet_map.document)
    ways = sorted(plan.ways, key=lambda w: int(document.ways.id[w]))
    new_nodes, xyz_m = _NewNodes(lanelet_map, ids), lanelet_map.xyz_m
    way_pieces = {w: _way_pieces(document, w, plan, ids, new_nodes) for w in ways}
    lanelet_ids = {
        k: [int(facts.lanelets.id[k])]
        + [ids.new(LANELET, int(facts.lanelets.id[k]), c.s_m) for c in plan.lanelets[k]]
        for k in sorted(plan.lanelets, key=lambda k: int(facts.lanelets.id[k]))
    }
    writer = MemberWriter(
        lanelet_map, facts, plan, {w: [i for i, _ in p] for w, p in way_pieces.items()}, lanelet_ids
    )
    nodes = new_nodes.joined()
    out_ways = _ways(document.ways, way_pieces)
    relations = _relations(document.relations, writer, facts, lanelet_ids)
    cut = _in_order(replace(document, nodes=nodes, ways=out_ways, relations=relations))
    xyz_m = np.concatenate([xyz_m, np.array(new_nodes.xyz_m, dtype=np.float64).reshape(-1, 3)])
    return replace(lanelet_map, document=cut, xyz_m=xyz_m), _pieces(facts, plan, lanelet_ids, cut)


def _pieces(
    facts: LaneletFacts, plan: CutPlan, lanelet_ids: dict[int, list[int]], document: OsmDocument
) -> Pieces:
    count = np.ones(len(facts.lanelets), dtype=np.int64)
    for k, new in lanelet_ids.items():
        count[k] = len(new)
    source = np.repeat(np.arange(len(facts.lanelets)), count)
    start = np.cumsum(count) - count
    ids = facts.lanelets.id[source]
    s_from, s_to = np.zeros(len(source)), facts.length_m[source]
    for k, new in lanelet_ids.items():
        at = slice(int(start[k]), int(start[k]) + len(new))
        places = [c.s_m for c in plan.lanelets[k]]
        ids[at] = new
        s_from[at], s_to[at] = [0.0, *places], [*places, float(facts.length_m[k])]
    return Pieces(source, s_from, s_to, ids, rows_of(document.relations.id, ids))


class _NewNodes:
    """Nodes made by cuts, interpolated between two of the map."""

    def __init__(self, lanelet_map: LaneletMap, ids: NewIds) -> None:
        self.map, self.ids = lanelet_map, ids
        self.node_rows = node_rows(lanelet_map.document)
        self.id: list[int] = []
        self.xyz_m: list[Floats] = []
        self.lonlat: list[Floats] = []
        self.attributes: list[dict[str, str]] = []
        self.tags: list[dict[str, str]] = []

    def between(self, way: int, vertex: int, t: float, along_m: float) -> int:
        """Id of a new node at share t between a vertex of the way and the next."""
        nodes, ways = self.map.document.nodes, self.map.document.ways
        a, b = (int(r) for r in self.node_rows[ways.offset[way] + vertex :][:2])
        self.id.append(self.ids.new(NODE, int(ways.id[way]), along_m))
        self.xyz_m.append(self.map.xyz_m[a] + t * (self.map.xyz_m[b] - self.map.xyz_m[a]))
        lonlat = nodes.lonlat_deg[a] + t * (nodes.lonlat_deg[b] - nodes.lonlat_deg[a])
        self.lonlat.append(lonlat)
        attributes = nodes.attributes.of_element(a)
        for key, value in zip(("lon", "lat"), lonlat.tolist(), strict=True):
            if key in attributes:
                attributes[key] = "" if np.isnan(value) else f"{value:.{_DIGITS[key]}f}"
        self.attributes.append(attributes)
        self.tags.append(_between(nodes.tags.of_element(a), nodes.tags.of_element(b), t))
        return self.id[-1]

    def joined(self) -> OsmNodes:
        """The nodes of the map and the new ones after them."""
        nodes = self.map.document.nodes
        last = nodes.position.max(initial=-1)
        return OsmNodes(
            id=np.concatenate([nodes.id, np.array(self.id, dtype=np.int64)]),
            lonlat_deg=np.concatenate(
                [nodes.lonlat_deg, np.array(self.lonlat, dtype=np.float64).reshape(-1, 2)]
            ),
            attributes=joined_tags(nodes.attributes, Tags.of(self.attributes)),
            tags=joined_tags(nodes.tags, Tags.of(self.tags)),
            position=np.concatenate([nodes.position, np.full(len(self.id), last)]),
        )


def _between(a: dict[str, str], b: dict[str, str], t: float) -> dict[str, str]:
    """Tags of a node between two: numbers in between, the rest only where both agree or one is the place's."""
    out = {}
    for key, value in a.items():
        if key in ("ele", "local_x", "local_y"):
            try:
                x, y = float(value), float(b[key])
            except (KeyError, ValueError):
                continue
            out[key] = f"{x + t * (y - x):.4f}"
        elif b.get(key) == value or key == "mgrs_code":
            out[key] = value
    return out


def joined_tags(a: Tags, b: Tags) -> Tags:
    """The tags of both, one after the other."""
    return Tags(
        np.concatenate([a.offset, a.offset[-1] + b.offset[1:]]),
        np.concatenate([a.key, b.key]),
        np.concatenate([a.value, b.value]),
    )


def _way_pieces(
    document: OsmDocument, way: int, plan: CutPlan, ids: NewIds, new_nodes: _NewNodes
) -> list[tuple[int, list[int]]]:
    """Id and nodes of every piece, in the direction of the way."""
    ways = document.ways
    refs = ways.ref[ways.offset[way] : ways.offset[way + 1]].tolist()
    out: list[tuple[int, list[int]]] = []
    start: list[int] = []
    current, next_vertex = int(ways.id[way]), 0
    for cut in plan.ways[way]:
        start = [*start, *refs[next_vertex : cut.vertex + 1]]
        if cut.t > 0.0:
            start.append(new_nodes.between(way, cut.vertex, cut.t, cut.along_m))
        out.append((current, start))
        current, start, next_vertex = (
            ids.new(WAY, int(ways.id[way]), cut.along_m),
            [start[-1]],
            cut.vertex + 1,
        )
    out.append((current, [*start, *refs[next_vertex:]]))
    return out


def _ways(ways: OsmWays, cut: dict[int, list[tuple[int, list[int]]]]) -> OsmWays:
    count = np.ones(len(ways.id), dtype=np.int64)
    for way, parts in cut.items():
        count[way] = len(parts)
    source = np.repeat(np.arange(len(ways.id)), count)
    first = np.cumsum(count) - count
    ids, start, size = ways.id[source], ways.offset[source], np.diff(ways.offset)[source]
    extra: list[int] = []
    for way, parts in cut.items():
        for j, (piece_id, refs) in enumerate(parts):
            at = first[way] + j
            ids[at], start[at], size[at] = piece_id, len(ways.ref) + len(extra), len(refs)
            extra += refs
    offset, flat = ranges(start, size)
    ref = np.concatenate([ways.ref, np.array(extra, dtype=np.int64)])[flat]
    return OsmWays(
        ids, offset, ref, ways.attributes.take(source), ways.tags.take(source), ways.position[source]
    )


def ranges(start: Ints, size: Ints) -> tuple[Ints, Ints]:
    """Offsets, and flat positions start[i], start[i] + 1, ... of size[i] each."""
    offset = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
    return offset, np.repeat(start - offset[:-1], size) + np.arange(offset[-1])


def _relations(
    relations: OsmRelations, writer: MemberWriter, facts: LaneletFacts, lanelet_ids: dict[int, list[int]]
) -> OsmRelations:
    count = np.ones(len(relations.id), dtype=np.int64)
    for k, new in lanelet_ids.items():
        count[facts.lanelets.relation_row[k]] = len(new)
    source = np.repeat(np.arange(len(relations.id)), count)
    first = np.cumsum(count) - count
    ids, start, size = relations.id[source], relations.offset[source], np.diff(relations.offset)[source]
    extra: list[Member] = []
    written = {int(row): [members] for row, members in writer.other_relations().items()}
    for k, new in lanelet_ids.items():
        row = int(facts.lanelets.relation_row[k])
        ids[first[row] : first[row] + len(new)] = new
        written[row] = writer.lanelet(k)
    for row, lists in written.items():
        for j, members in enumerate(lists):
            start[first[row] + j], size[first[row] + j] = len(relations.member_ref) + len(extra), len(members)
            extra += members
    offset, flat = ranges(start, size)
    return OsmRelations(
        id=ids,
        offset=offset,
        member_type=np.concatenate([relations.member_type, strings(m[0] for m in extra)])[flat],
        member_ref=np.concatenate([relations.member_ref, np.array([m[1] for m in extra], dtype=np.int64)])[
            flat
        ],
        member_role=np.concatenate([relations.member_role, strings(m[2] for m in extra)])[flat],
        attributes=relations.attributes.take(source),
        tags=relations.tags.take(source),
        position=relations.position[source],
    )


def _in_order(document: OsmDocument) -> OsmDocument:
    """New places among all elements: a piece stands after the piece before it, a new node after all nodes."""
    parts = (
        document.nodes.position,
        document.ways.position,
        document.relations.position,
        document.other_position,
    )
    every = np.concatenate(parts)
    rank = np.empty(len(every), dtype=np.int64)
    rank[np.argsort(every, kind="stable")] = np.arange(len(every))
    ends = np.cumsum([len(p) for p in parts])
    nodes, ways, relations, other = np.split(rank, ends[:-1])
    return replace(
        document,
        nodes=replace(document.nodes, position=nodes),
        ways=replace(document.ways, position=ways),
        relations=replace(document.relations, position=relations),
        other_position=other,
    )
