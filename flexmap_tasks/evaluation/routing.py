"""A map's routing graph for vehicles, as the Lanelet2 library would build it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from flexmap_tasks.evaluation.traffic_rules import can_pass, is_one_way, speed_limit_kmh
from flexmap_tasks.geometry.lanelets import join
from flexmap_tasks.model.arrays import Bools, Ints
from flexmap_tasks.model.lanelets import end_nodes, lanelets_of
from flexmap_tasks.model.maps import LaneletMap, Lanelets
from flexmap_tasks.model.osm import OsmDocument


@dataclass(frozen=True, slots=True, eq=False)
class Routing:
    """What a vehicle can do on a map.

    lanelet_id : (k,) int64, usable lanelets
    follow : (e, 2) int64, unique pairs of ids (from, to): driving on from the one as drawn leads onto the other
    two_way : (k,) bool, drivable against its direction too; without_limit : (k,) bool, drivable at 0 km/h or less
    """

    lanelet_id: Ints
    follow: Ints
    two_way: Bools
    without_limit: Bools


def routing(lanelet_map: LaneletMap) -> Routing:
    """The routing graph by the rules for vehicles in Germany, lane changes left out."""
    lanelets = lanelets_of(lanelet_map)
    tags = [lanelet_map.document.relations.tags.of_element(row) for row in lanelets.relation_row.tolist()]
    passable = np.array([can_pass(t) for t in tags], dtype=bool)
    two_way = passable & ~np.array([is_one_way(t) for t in tags], dtype=bool)
    stands = np.array([speed_limit_kmh(t) <= 0 for t in tags], dtype=bool)
    signed = np.isin(lanelets.id, _with_speed_sign(lanelet_map.document))
    rows = _follow_rows(lanelet_map, lanelets, passable, two_way)
    pairs = np.unique(lanelets.id[rows], axis=0) if len(rows) else np.empty((0, 2), dtype=np.int64)
    return Routing(lanelets.id, pairs, two_way, passable & stands & ~signed)


def _follow_rows(lanelet_map: LaneletMap, lanelets: Lanelets, passable: Bools, two_way: Bools) -> Ints:
    """(e, 2) rows of lanelets; the second may be entered at its end where it is two-way."""
    start_left, start_right, end_left, end_right = end_nodes(lanelet_map, lanelets).T
    n = np.int64(max(len(lanelet_map.xyz_m), 1))
    drawn, turned = np.flatnonzero(passable), np.flatnonzero(two_way)
    entry = np.concatenate([(start_left * n + start_right)[drawn], (end_right * n + end_left)[turned]])
    before, after = join((end_left * n + end_right)[drawn], entry)
    return np.stack([drawn[before], np.concatenate([drawn, turned])[after]], axis=1)


def _with_speed_sign(document: OsmDocument) -> Ints:
    """Lanelets whose limit is set by a regulatory element."""
    relations = document.relations
    signs = relations.id[relations.tags.column("subtype") == "speed_limit"]
    hit = np.flatnonzero(
        (relations.member_role == "regulatory_element") & np.isin(relations.member_ref, signs)
    )
    return relations.id[np.searchsorted(relations.offset, hit, side="right") - 1]


def reachable_share(routes: Routing) -> float:
    """Mean share of all lanelets that can be reached from a lanelet, itself included; 0 for an empty map."""
    n = len(routes.lanelet_id)
    if n == 0:
        return 0.0
    order = np.argsort(routes.lanelet_id, kind="stable")
    edge = order[np.searchsorted(routes.lanelet_id[order], routes.follow)]
    graph = coo_array((np.ones(len(edge)), (edge[:, 0], edge[:, 1])), shape=(n, n)).tocsr()
    count, part = connected_components(graph, connection="strong")
    size = np.bincount(part, minlength=count)
    reached = _reached(part[edge].astype(np.int64), size)
    return float(size @ np.array(reached, dtype=np.float64)) / n**2


def _reached(edges: Ints, size: Ints) -> list[int]:
    """Lanelets reached from each strongly connected part; a set of parts is the bits of one integer."""
    onward: list[set[int]] = [set() for _ in size]
    for a, b in edges.tolist():
        if a != b:
            onward[a].add(b)
    seen: list[int | None] = [None] * len(size)
    for root in range(len(size)):
        stack = [root]
        while stack:
            part = stack[-1]
            waiting = [b for b in onward[part] if seen[b] is None]
            if waiting and seen[part] is None:
                stack.extend(waiting)
                continue
            stack.pop()
            bits = 1 << part
            for b in onward[part]:
                bits |= seen[b] or 0
            seen[part] = bits
    return [int(size[_bits(parts or 0, len(size))].sum()) for parts in seen]


def _bits(value: int, count: int) -> Bools:
    packed = np.frombuffer(value.to_bytes((count + 7) // 8, "little"), dtype=np.uint8)
    return np.unpackbits(packed, bitorder="little", count=count).astype(bool)
