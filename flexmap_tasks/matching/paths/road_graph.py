"""OpenStreetMap roads as a graph: links from junction to junction, however the ways are cut."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from flexmap_tasks.geometry.chains import chains
from flexmap_tasks.geometry.lanelets import join
from flexmap_tasks.geometry.segments import cut, first_of_groups
from flexmap_tasks.matching.road_segments import usable_vertices
from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.model.maps import PlacedRoads, RoadNetwork

ONE_WAY_YES, ONE_WAY_BACK, ONE_WAY_NO = ("yes", "true", "1"), ("-1", "reverse"), ("no", "false", "0")
IMPLIED_ONE_WAY = ("motorway", "motorway_link")
LAYER = re.compile(r"[+-]?[0-9]{1,2}")
RINGS = ("roundabout", "circular")
LINK_KEYS = ("highway", "junction", "service", "access", "layer", "bridge", "tunnel")
"""A link ends where one of these changes, or the direction of travel."""


@dataclass(frozen=True, slots=True, eq=False)
class RoadGraph:
    """Links and their segments.

    Segments, ordered by link and place, turned along the link:
    link : (n,) int64; a_m, b_m : (n, 2) float64; s_m : (n,) float64, metres along the link at a
    way : (n,) int64, row of the way; way_a_m, way_b_m : (n,) float64, metres along the way at a and b

    Links:
    offset : (k + 1,) int64 into the segments; length_m : (k,) float64
    tail, head : (k,) int64, nodes; one_way : (k,) int64, +1 only along the link, -1 only against it, 0 both
    way_of : (k,) int64, row of the way of its first segment: what the tags of the link are read from
    nodes : number of nodes
    """

    link: Ints
    a_m: Floats
    b_m: Floats
    s_m: Floats
    way: Ints
    way_a_m: Floats
    way_b_m: Floats
    offset: Ints
    length_m: Floats
    tail: Ints
    head: Ints
    one_way: Ints
    way_of: Ints
    nodes: int

    def __len__(self) -> int:
        return len(self.length_m)


def road_graph(roads: PlacedRoads) -> RoadGraph:
    """The graph of all usable ways; canonical order by geometry, so that neither ids nor cuts of ways matter.

    Of segments between the same two nodes one stays. Areas, ways of one node and vertices that are not finite
    are passed over.
    """
    network = roads.network
    offset, vertex = usable_vertices(roads)
    segments = cut(offset, roads.xy_m[vertex], np.inf)
    number = np.unique(network.node_id[vertex], return_inverse=True)[1]
    tail, head = number[segments.vertex_a], number[segments.vertex_b]
    rows = _canonical_rows(tail, head, network.way_id[segments.line], segments.a_m, segments.b_m)
    segments, tail, head = segments.take(rows), tail[rows], head[rows]
    way_direction = one_way_of(network)
    kind = _kinds(network, way_direction)
    partner = _joints(tail, head, kind[segments.line], way_direction[segments.line] != 0)
    link_offset, row, against = chains(partner)
    segments, tail, head = segments.take(row), tail[row], head[row]
    link = np.repeat(np.arange(len(link_offset) - 1), np.diff(link_offset))
    length = segments.length_m
    total = np.append(0.0, np.cumsum(length))
    first, last = link_offset[:-1], link_offset[1:] - 1
    flip = against[:, None]
    direction = np.where(against, -1, 1) * way_direction[segments.line]
    return RoadGraph(
        link=link,
        a_m=np.where(flip, segments.b_m, segments.a_m),
        b_m=np.where(flip, segments.a_m, segments.b_m),
        s_m=total[:-1] - total[first][link],
        way=segments.line,
        way_a_m=np.where(against, segments.s_to_m, segments.s_from_m),
        way_b_m=np.where(against, segments.s_from_m, segments.s_to_m),
        offset=link_offset,
        length_m=total[last + 1] - total[first],
        tail=np.where(against[first], head[first], tail[first]),
        head=np.where(against[last], tail[last], head[last]),
        one_way=direction[first],
        way_of=segments.line[first],
        nodes=int(number.max(initial=-1)) + 1,
    )


def one_way_of(network: RoadNetwork) -> Ints:
    """(w,) int64: +1 where traffic runs along the way only, -1 against it only, 0 both or changing."""
    value = network.tags.column("oneway").astype(str)
    ring = np.isin(network.tags.column("junction").astype(str), RINGS)
    implied = ring | np.isin(network.tags.column("highway").astype(str), IMPLIED_ONE_WAY)
    forward = np.isin(value, ONE_WAY_YES) | (implied & ~np.isin(value, ONE_WAY_NO + ONE_WAY_BACK))
    return np.where(forward, 1, np.where(np.isin(value, ONE_WAY_BACK), -1, 0)).astype(np.int64)


def _kinds(network: RoadNetwork, direction: Ints) -> Ints:
    """(w,) number of the combination of tags that a link keeps."""
    columns = [network.tags.column(key).astype(str) for key in LINK_KEYS]
    codes = [np.unique(c, return_inverse=True)[1].ravel() for c in columns]
    stacked = np.stack([*codes, direction != 0], axis=1)
    return np.unique(stacked, axis=0, return_inverse=True)[1].ravel()


def _canonical_rows(tail: Ints, head: Ints, way_id: Ints, a_m: Floats, b_m: Floats) -> Ints:
    """One row per pair of nodes, ordered by where the segments lie."""
    ends = np.stack([np.minimum(tail, head), np.maximum(tail, head)], axis=1)
    twin = np.unique(ends, axis=0, return_inverse=True)[1].ravel()
    rows = first_of_groups(twin, way_id)
    rows = rows[tail[rows] != head[rows]]
    middle = a_m[rows] + b_m[rows]
    spread = np.abs(a_m[rows] - b_m[rows])
    order: Ints = rows[np.lexsort((spread[:, 1], spread[:, 0], middle[:, 1], middle[:, 0]))]
    return order


def _joints(tail: Ints, head: Ints, kind: Ints, directed: Bools) -> Ints:
    """Partners of segment ends at nodes of exactly two ends whose segments are of one kind and direction."""
    node = np.stack([tail, head], axis=1).ravel()
    end = np.argsort(node, kind="stable")
    _, at, count = np.unique(node[end], return_index=True, return_counts=True)
    first = at[count == 2]
    a, b = end[first], end[first + 1] if len(first) else end[first]
    fits = (kind[a >> 1] == kind[b >> 1]) & (~directed[a >> 1] | ((a & 1) != (b & 1)))
    partner = np.full(len(node), -1, dtype=np.int64)
    partner[a[fits]], partner[b[fits]] = b[fits], a[fits]
    return partner


def node_distances(graph: RoadGraph, limit_m: float) -> tuple[Ints, Ints, Floats]:
    """Shortest ways between link ends, up to the limit: (offset (nodes + 1,), other node, metres).

    Every node is at distance 0 from itself; others are ordered by node. Direction of travel is left aside.
    """
    near = graph.length_m <= limit_m
    start = np.concatenate([graph.tail[near], graph.head[near]])
    stop = np.concatenate([graph.head[near], graph.tail[near]])
    step = np.concatenate([graph.length_m[near]] * 2)
    used = np.unique(np.concatenate([graph.tail, graph.head]))
    source, target, metres = used, used, np.zeros(len(used))
    front = np.arange(len(used))
    while len(front):
        at, by = join(target[front], start)
        row = front[at]
        reach = metres[row] + step[by]
        fine = reach <= limit_m
        known = len(source)
        source = np.concatenate([source, source[row[fine]]])
        target = np.concatenate([target, stop[by[fine]]])
        metres = np.concatenate([metres, reach[fine]])
        age = np.arange(len(source)) >= known
        best = first_of_groups(source * graph.nodes + target, metres, age)
        source, target, metres, fresh = source[best], target[best], metres[best], age[best]
        front = np.flatnonzero(fresh)
    offset = np.searchsorted(source, np.arange(graph.nodes + 1))
    return offset.astype(np.int64), target, metres


def layer_of(network: RoadNetwork, graph: RoadGraph) -> Ints:
    """(k,) layer per link: as tagged, else +1 for bridges, -1 for tunnels, 0 for the rest."""
    layer = tag(network, graph, "layer")
    known, number = np.unique(layer, return_inverse=True)
    value = np.array([int(v) if LAYER.fullmatch(v) else 0 for v in known], dtype=np.int64)[number.ravel()]
    bridge, tunnel = (~np.isin(tag(network, graph, key), ("None", "no")) for key in ("bridge", "tunnel"))
    return np.where(value != 0, value, bridge.astype(np.int64) - tunnel)


def tag(network: RoadNetwork, graph: RoadGraph, key: str) -> Strings:
    """(k,) value of a tag per link, "None" where it has none."""
    column: Strings = network.tags.column(key).astype(str)[graph.way_of]
    return column
