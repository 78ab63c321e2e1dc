"""OpenStreetMap roads as short segments between numbered nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.geometry.lanelets import offsets
from flexmap_tasks.geometry.segments import Segments, cut, first_of_groups
from flexmap_tasks.model.arrays import Bools, Floats, Ints
from flexmap_tasks.model.maps import PlacedRoads

STRAIGHT_COS = np.cos(np.radians(0.01))
"""A vertex at which a way turns by less is passed over: how densely a straight is drawn must not matter."""


@dataclass(frozen=True, slots=True, eq=False)
class RoadSegments:
    """Segments of roads as a graph.

    segments : `line` is the row of the way; canonical order, so that no result depends on ids
    tail, head : (n,) int64, node at a and at b; node_xy_m : (k, 2) float64, where the nodes lie
    """

    segments: Segments
    tail: Ints
    head: Ints
    node_xy_m: Floats


def road_segments(roads: PlacedRoads, segment_length_m: float) -> RoadSegments:
    """All ways cut into segments of at most `segment_length_m`; of identical segments one stays.

    Areas (`area=yes`), ways of one node and vertices that are not finite carry no segment. Ways that share an
    OpenStreetMap node share the node here.
    """
    network = roads.network
    offset, vertex = usable_vertices(roads)
    xy_m = roads.xy_m[vertex]
    segments = cut(offset, xy_m, segment_length_m)
    number = np.unique(network.node_id[vertex], return_inverse=True)[1]
    inner = np.flatnonzero(segments.vertex_b < 0)
    fresh = len(vertex) + np.arange(len(inner))
    head = np.where(segments.vertex_b >= 0, number[segments.vertex_b], 0)
    head[inner] = fresh
    tail = np.where(segments.vertex_a >= 0, number[segments.vertex_a], 0)
    # A cut inside a polyline's edge is the end of one segment and the start of the next.
    tail[inner + 1] = fresh
    middle = (segments.a_m + segments.b_m) / 2
    keys = (np.minimum(tail, head), np.maximum(tail, head))
    twin = np.unique(np.stack(keys, axis=1), axis=0, return_inverse=True)[1].ravel()
    way_id = network.way_id[segments.line]
    rows = first_of_groups(twin, -segments.length_m, way_id, segments.s_from_m)
    rows = rows[tail[rows] != head[rows]]
    rows = rows[np.lexsort((way_id[rows], segments.length_m[rows], middle[rows, 1], middle[rows, 0]))]
    nodes, ends = np.unique(np.concatenate([tail[rows], head[rows]]), return_inverse=True)
    node_xy_m = np.empty((len(nodes), 2))
    chosen = segments.take(rows)
    node_xy_m[ends[len(rows) :]] = chosen.b_m
    node_xy_m[ends[: len(rows)]] = chosen.a_m
    return RoadSegments(chosen, ends[: len(rows)], ends[len(rows) :], node_xy_m)


def usable_vertices(roads: PlacedRoads) -> tuple[Ints, Ints]:
    """Vertices that shape ways: finite, of no area, and no mere points on a straight: (offset, vertices)."""
    network = roads.network
    owner = np.repeat(np.arange(len(network)), np.diff(network.offset))
    area = network.tags.column("area") == "yes"
    vertex = np.flatnonzero(np.isfinite(roads.xy_m).all(axis=1) & ~area[owner])
    vertex = vertex[~_on_a_straight(owner[vertex], network.node_id[vertex], roads.xy_m[vertex])]
    return offsets(np.bincount(owner[vertex], minlength=len(network))), vertex


def _on_a_straight(way: Ints, node_id: Ints, xy_m: Floats) -> Bools:
    """Inner vertices of one way alone at which it does not turn."""
    run = np.diff(xy_m, axis=0)
    length = np.hypot(*run.T)
    cos = np.einsum("ij,ij->i", run[:-1], run[1:]) >= STRAIGHT_COS * length[:-1] * length[1:]
    _, inverse, count = np.unique(node_id, return_inverse=True, return_counts=True)
    inner = np.zeros(len(way), dtype=bool)
    inner[1:-1] = (way[:-2] == way[2:]) & cos & (count[inverse][1:-1] == 1)
    return inner
