"""Small maps and road networks made of points, and what the same map looks like under other ids and cuts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pytest

from flexmap_tasks.model import lanelets as lanes
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.maps import Findings, LaneletMap, PlacedRoads, RoadNetwork
from flexmap_tasks.model.osm import OsmDocument, OsmNodes, OsmRelations, OsmWays, Tags

Line = Sequence[tuple[float, float]]


class MapDraft:
    """A Lanelet2 map in the making; points at the same place are one node."""

    def __init__(self) -> None:
        self.nodes: dict[tuple[float, float], int] = {}
        self.ways: dict[tuple[int, ...], int] = {}
        self.lanelets: list[tuple[int, int, str | None]] = []

    def way(self, line: Line) -> int:
        points = [(round(float(x), 9), round(float(y), 9)) for x, y in line]
        key = tuple(self.nodes.setdefault(p, len(self.nodes)) for p in points)
        if key[::-1] in self.ways:
            return self.ways[key[::-1]]
        return self.ways.setdefault(key, len(self.ways))

    def lanelet(self, left: Line, right: Line, subtype: str | None = "road") -> int:
        """Draw a lanelet; returns its id."""
        self.lanelets.append((self.way(left), self.way(right), subtype))
        return 10_000 + len(self.lanelets) - 1

    def build(self) -> LaneletMap:
        xy = np.array(list(self.nodes), dtype=float).reshape(-1, 2)
        n, w, r = len(self.nodes), len(self.ways), len(self.lanelets)
        empty = lambda k: Tags.of({} for _ in range(k))  # noqa: E731
        members = [(a, b) for a, b, _ in self.lanelets]
        relations = OsmRelations(
            id=np.arange(r) + 10_000,
            offset=np.arange(r + 1) * 2,
            member_type=strings(["way"] * 2 * r),
            member_ref=np.array(members, dtype=np.int64).ravel() + 1,
            member_role=strings(["left", "right"] * r),
            attributes=empty(r),
            tags=Tags.of({"type": "lanelet"} | ({"subtype": s} if s else {}) for _, _, s in self.lanelets),
            position=np.arange(r) + n + w,
        )
        size = [len(k) for k in self.ways]
        ways = OsmWays(
            id=np.arange(w) + 1,
            offset=np.concatenate([[0], np.cumsum(size)]).astype(np.int64),
            ref=np.array([i for k in self.ways for i in k], dtype=np.int64) + 1,
            attributes=empty(w), tags=empty(w), position=np.arange(w) + n,
        )  # fmt: skip
        nodes = OsmNodes(np.arange(n) + 1, np.full((n, 2), np.nan), empty(n), empty(n), np.arange(n))
        document = OsmDocument({}, nodes, ways, relations, strings([]), np.zeros(0, np.int64))
        return lanelet_map(document, np.column_stack([xy, np.zeros(n)]))


def lanelet_map(document: OsmDocument, xyz_m: np.ndarray) -> LaneletMap:
    z = strings([])
    return LaneletMap(document, xyz_m, Findings(z, z, z, np.zeros(0, np.int64), z))


def roads(lines: Iterable[Line], tags: Iterable[Mapping[str, str]] | None = None) -> PlacedRoads:
    """Ways 1, 2, ... along the lines; points at the same place are one node."""
    lines = [list(line) for line in lines]
    number: dict[tuple[float, float], int] = {}
    node = [number.setdefault((float(x), float(y)), len(number)) + 1 for line in lines for x, y in line]
    offset = np.concatenate([[0], np.cumsum([len(line) for line in lines])]).astype(np.int64)
    xy = np.array([p for line in lines for p in line], dtype=float).reshape(-1, 2)
    k = len(lines)
    all_tags = Tags.of(tags if tags is not None else ({"highway": "residential"} for _ in range(k)))
    return placed(np.arange(k) + 1, offset, np.array(node, dtype=np.int64), xy, all_tags)


def placed(
    way_id: np.ndarray, offset: np.ndarray, node_id: np.ndarray, xy_m: np.ndarray, tags: Tags
) -> PlacedRoads:
    k = len(way_id)
    network = RoadNetwork(
        np.asarray(way_id, dtype=np.int64), np.ones(k, dtype=np.int64), strings([""] * k), offset,
        node_id, xy_m / 1e5, tags,
    )  # fmt: skip
    return PlacedRoads(network, xy_m)


def ways_of(value: PlacedRoads) -> list[tuple[int, np.ndarray, np.ndarray, dict[str, str]]]:
    """(id, node ids, points, tags) per way."""
    net = value.network
    return [
        (int(net.way_id[i]), net.node_id[a:b], value.xy_m[a:b], net.tags.of_element(i))
        for i, (a, b) in enumerate(zip(net.offset[:-1].tolist(), net.offset[1:].tolist(), strict=True))
    ]


def from_ways(ways: Sequence[tuple[int, np.ndarray, np.ndarray, dict[str, str]]]) -> PlacedRoads:
    offset = np.concatenate([[0], np.cumsum([len(w[1]) for w in ways])]).astype(np.int64)
    return placed(
        np.array([w[0] for w in ways], dtype=np.int64),
        offset,
        np.concatenate([w[1] for w in ways]) if ways else np.zeros(0, np.int64),
        np.concatenate([w[2] for w in ways]) if ways else np.zeros((0, 2)),
        Tags.of(w[3] for w in ways),
    )


def with_other_ids(value: LaneletMap, seed: int) -> tuple[LaneletMap, dict[int, int]]:
    """The same map with all ids and the order of all elements permuted; and new lanelet id -> old."""
    rng = np.random.default_rng(seed)
    doc = value.document
    new_node, new_way, new_relation = (
        dict(zip(e.id.tolist(), (rng.permutation(len(e.id)) + 1).tolist(), strict=True))
        for e in (doc.nodes, doc.ways, doc.relations)
    )
    n, w, r = (rng.permutation(len(e.id)) for e in (doc.nodes, doc.ways, doc.relations))
    nodes = OsmNodes(
        np.array([new_node[i] for i in doc.nodes.id[n].tolist()]), doc.nodes.lonlat_deg[n],
        doc.nodes.attributes.take(n), doc.nodes.tags.take(n), np.arange(len(n)),
    )  # fmt: skip
    refs = [doc.ways.ref[doc.ways.offset[i] : doc.ways.offset[i + 1]] for i in w]
    ways = OsmWays(
        np.array([new_way[i] for i in doc.ways.id[w].tolist()]),
        np.concatenate([[0], np.cumsum([len(x) for x in refs])]).astype(np.int64),
        np.array([new_node[i] for x in refs for i in x.tolist()]),
        doc.ways.attributes.take(w), doc.ways.tags.take(w), np.arange(len(w)) + len(n),
    )  # fmt: skip
    of_type = {"node": new_node, "way": new_way, "relation": new_relation}
    flat = [np.arange(doc.relations.offset[i], doc.relations.offset[i + 1]) for i in r]
    rows = np.concatenate(flat)
    relations = OsmRelations(
        np.array([new_relation[i] for i in doc.relations.id[r].tolist()]),
        np.concatenate([[0], np.cumsum([len(x) for x in flat])]).astype(np.int64),
        doc.relations.member_type[rows],
        np.array([of_type[t][i] for t, i in zip(doc.relations.member_type[rows], doc.relations.member_ref[rows].tolist(), strict=True)]),
        doc.relations.member_role[rows], doc.relations.attributes.take(r), doc.relations.tags.take(r),
        np.arange(len(r)) + len(n) + len(w),
    )  # fmt: skip
    document = OsmDocument(doc.root, nodes, ways, relations, doc.other_xml, doc.other_position)
    back = {new: old for old, new in new_relation.items()}
    return LaneletMap(document, value.xyz_m[n], value.findings), back


def offset_line(line: Line, aside_m: float) -> list[tuple[float, float]]:
    """The line moved to its left."""
    p = np.asarray(line, dtype=float)
    run = np.gradient(p, axis=0)
    run /= np.hypot(*run.T)[:, None]
    return [tuple(q) for q in (p + aside_m * np.column_stack([-run[:, 1], run[:, 0]])).round(9)]


def two_way_road(draft: MapDraft, middle: Line, width_m: float = 3.5) -> tuple[int, int]:
    """One lane per direction on either side of the middle, right-hand traffic; (forward, backward) ids."""
    left, right = offset_line(middle, width_m), offset_line(middle, -width_m)
    forward = draft.lanelet(list(middle), right)
    backward = draft.lanelet(list(middle)[::-1], left[::-1])
    return forward, backward


def metres_by_way(matches) -> dict[tuple[int, int, int], float]:
    """Metres per (lanelet, way, direction)."""
    out: dict[tuple[int, int, int], float] = {}
    for lanelet, way, sign, a, b in zip(
        matches.lanelet_id.tolist(), matches.way_id.tolist(), matches.direction.tolist(),
        matches.s_from_m.tolist(), matches.s_to_m.tolist(), strict=True,
    ):  # fmt: skip
        key = (lanelet, way, sign)
        out[key] = out.get(key, 0.0) + b - a
    return out


def covered_once(built, matches) -> None:
    """Every metre of every lane is in exactly one row, rows in order."""
    found = lanes.lanelets_of(built)
    length = dict(
        zip(found.id.tolist(), lanes.lengths_m(lanes.centrelines(built, found)).tolist(), strict=True)
    )
    order = np.lexsort((matches.s_from_m, matches.lanelet_id))
    assert (order == np.arange(len(matches))).all()
    for i in np.unique(matches.lanelet_id):
        rows = np.flatnonzero(matches.lanelet_id == i)
        a, b = matches.s_from_m[rows], matches.s_to_m[rows]
        assert a[0] == 0.0
        assert (a[1:] == b[:-1]).all()
        assert b[-1] == pytest.approx(length[int(i)], abs=1e-9)
        assert (b > a).all()


def differing_metres(a, b) -> float:
    return sum(abs(a.get(k, 0.0) - b.get(k, 0.0)) for k in a.keys() | b.keys()) / 2
