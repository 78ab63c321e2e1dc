"""Match candidates: chains of road segments inside the buffers of a reference polyline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from flexmap_tasks.geometry.buffers import BufferShape, inside
from flexmap_tasks.geometry.chains import chains, reciprocated
from flexmap_tasks.geometry.lanelets import join
from flexmap_tasks.geometry.segments import first_of_groups, project
from flexmap_tasks.matching.buffers.references import ReferenceLines
from flexmap_tasks.matching.road_segments import RoadSegments
from flexmap_tasks.model.arrays import Bools, Floats, Ints


@dataclass(frozen=True, slots=True, eq=False)
class Near:
    """Pairs of a reference segment and a road node that some round's buffer could hold.

    segment : (p,) int64, row of the reference segment; node : (p,) int64; distance_m : (p,) float64
    """

    segment: Ints
    node: Ints
    distance_m: Floats


@dataclass(frozen=True, slots=True, eq=False)
class RoadChains:
    """Road segments inside the buffers of one reference polyline, end to end, along the reference.

    offset : (c + 1,) int64; reference : (c,) int64
    road : (n,) int64, row of the road segment; against : (n,) bool, walked from its head to its tail
    a_m, b_m : (n, 2) float64, ends in walking order; along_m : (n + 1,) float64, running length over all
    """

    offset: Ints
    reference: Ints
    road: Ints
    against: Bools
    a_m: Floats
    b_m: Floats
    along_m: Floats


def near_nodes(references: ReferenceLines, roads: RoadSegments, reach_m: float) -> Near:
    """All pairs within `reach_m`, found through a spatial index."""
    segments = references.segments
    if not len(segments) or not len(roads.node_xy_m):
        empty = np.zeros(0, dtype=np.int64)
        return Near(empty, empty, np.zeros(0))
    tree = shapely.STRtree(shapely.points(roads.node_xy_m))
    lines = shapely.linestrings(np.stack([segments.a_m, segments.b_m], axis=1))
    segment, node = tree.query(lines, predicate="dwithin", distance=reach_m)
    order = np.lexsort((node, segment))
    segment, node = segment[order], node[order]
    _, distance = project(roads.node_xy_m[node], segments.a_m[segment], segments.b_m[segment])
    return Near(segment.astype(np.int64), node.astype(np.int64), distance)


def chains_inside(
    references: ReferenceLines, roads: RoadSegments, near: Near, wanted: Bools, shape: BufferShape
) -> RoadChains:
    """Chains of the road segments whose ends both lie in a buffer of the same wanted reference polyline.

    Where roads branch, the chain goes on along the segment with the smallest angle to the nearest reference
    segment, as in the original; it does not depend on where growing starts.
    """
    reference, node, heading = _nodes_inside(references, roads, near, wanted, shape)
    of, road, at_tail, at_head = _segments_inside(roads, reference, node)
    run = roads.segments.direction[road]
    against = np.einsum("ij,ij->i", run, heading[at_tail] + heading[at_head]) < 0
    run = np.where(against[:, None], -run, run)
    enter, leave = np.where(against, at_head, at_tail), np.where(against, at_tail, at_head)
    rank = np.arange(len(road))
    ahead = first_of_groups(enter, -np.einsum("ij,ij->i", run, heading[enter]), rank)
    behind = first_of_groups(leave, -np.einsum("ij,ij->i", run, heading[leave]), rank)
    next_at = np.full(len(node), -1, dtype=np.int64)
    next_at[enter[ahead]] = ahead
    partner = np.full(2 * len(road), -1, dtype=np.int64)
    on = next_at[leave[behind]]
    linked, on = behind[on >= 0], on[on >= 0]
    partner[linked * 2 + 1], partner[on * 2] = on * 2, linked * 2 + 1
    offset, item, _ = chains(reciprocated(partner))
    a, b = (_end(roads, road[item], against[item], head) for head in (False, True))
    along = np.append(0.0, np.cumsum(roads.segments.length_m[road[item]]))
    return RoadChains(offset, of[item[offset[:-1]]], road[item], against[item], a, b, along)


def _nodes_inside(
    references: ReferenceLines, roads: RoadSegments, near: Near, wanted: Bools, shape: BufferShape
) -> tuple[Ints, Ints, Floats]:
    """Nodes inside the buffers of a reference, ordered by both, with the direction of the nearest segment."""
    owner, segments = references.owner[near.segment], references.segments
    rows = np.flatnonzero(wanted[owner] & (near.distance_m <= shape.reach_m))
    segment, node = near.segment[rows], near.node[rows]
    hit = inside(roads.node_xy_m[node], segments.a_m[segment], segments.b_m[segment], shape)
    owner, segment, node, distance = owner[rows][hit], segment[hit], node[hit], near.distance_m[rows][hit]
    best = first_of_groups(owner * len(roads.node_xy_m) + node, distance, segment)
    return owner[best], node[best], segments.direction[segment[best]]


def _segments_inside(roads: RoadSegments, reference: Ints, node: Ints) -> tuple[Ints, Ints, Ints, Ints]:
    """Road segments with both ends inside: (reference, road, row of its tail, row of its head)."""
    at_tail, road = join(node, roads.tail)
    key = reference * len(roads.node_xy_m) + node
    head_key = reference[at_tail] * len(roads.node_xy_m) + roads.head[road]
    at_head = np.minimum(np.searchsorted(key, head_key), max(len(key) - 1, 0))
    both = key[at_head] == head_key if len(key) else np.zeros(0, dtype=bool)
    at_tail, at_head, road = at_tail[both], at_head[both], road[both]
    order = np.lexsort((road, reference[at_tail]))
    return reference[at_tail][order], road[order], at_tail[order], at_head[order]


def _end(roads: RoadSegments, road: Ints, against: Bools, head: bool) -> Floats:
    at_b = against ^ head
    return np.where(at_b[:, None], roads.segments.b_m[road], roads.segments.a_m[road])
