"""What the lanelets of a map are, and how they lie to each other; all as whole arrays."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np

from flexmap_tasks.geometry import lanelets as kernels
from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.model.maps import LaneletMap, Lanelets
from flexmap_tasks.model.osm import OsmDocument, OsmRelations, node_rows, rows_of

TWO_WAY_SUBTYPES = ("crosswalk", "shared_walkway", "stairs", "walkway")
"""Subtypes that Lanelet2 reads as two-way unless `one_way` says otherwise: those made for walking."""
_TRUE, _FALSE = ("yes", "true", "1"), ("no", "false", "0")


@dataclass(frozen=True, slots=True, eq=False)
class Polylines:
    """One polyline per row: row i owns the vertices offset[i]:offset[i + 1].

    offset : (k + 1,) int64
    xyz_m : (m, 3) float64, metres in the frame of the map
    node_row : (m,) int64, row of the vertex in `document.nodes`, -1 where it is no node of the map
    """

    offset: Ints
    xyz_m: Floats
    node_row: Ints

    def __len__(self) -> int:
        return len(self.offset) - 1


@dataclass(frozen=True, slots=True, eq=False)
class Adjacency:
    """Neighbours across a shared bound, one row per lanelet and neighbour, so each pair stands twice.

    lanelet, neighbour : (p,) int64, rows of lanelets; ordered by lanelet, then neighbour
    on_left : (p,) bool, the neighbour lies left of the lanelet
    same_direction : (p,) bool, both run alike
    """

    lanelet: Ints
    neighbour: Ints
    on_left: Bools
    same_direction: Bools

    def __len__(self) -> int:
        return len(self.lanelet)


def lanelet_relations(document: OsmDocument) -> Ints:
    """Rows of all relations that are lanelets, complete or not; those marked `action="delete"` left out."""
    relations = document.relations
    wanted = relations.tags.column("type") == "lanelet"
    deleted = relations.attributes.column("action") == "delete"
    return np.flatnonzero(wanted & ~deleted)


class BoundState(IntEnum):
    """What a lanelet's bound on one side is."""

    GOOD = 0
    MISSING = 1
    SEVERAL = 2
    SHORT = 3


def usable_ways(document: OsmDocument) -> Bools:
    """(w,) bool: all nodes exist, and at least two are different."""
    ways, rows = document.ways, node_rows(document)
    owner = np.repeat(np.arange(len(ways.id)), np.diff(ways.offset))
    missing = np.bincount(owner[rows < 0], minlength=len(ways.id)) > 0
    first = rows[np.minimum(ways.offset[:-1], max(len(rows) - 1, 0))] if len(rows) else np.zeros(len(ways.id))
    differs = rows != first[owner]
    return (np.bincount(owner[differs], minlength=len(ways.id)) > 0) & ~missing


def bounds(
    document: OsmDocument, relation_rows: Ints, side: Literal["left", "right"], usable: Bools
) -> tuple[Ints, Ints]:
    """(k,) row of the way that bounds each lanelet on one side, -1 unless there is exactly one; and BoundState."""
    relations = document.relations
    hit = np.flatnonzero((relations.member_role == side) & (relations.member_type == "way"))
    owner = np.searchsorted(relations.offset, hit, side="right") - 1
    count = np.bincount(owner, minlength=len(relations.id))
    way = np.full(len(relations.id), -1, dtype=np.int64)
    way[owner] = rows_of(document.ways.id, relations.member_ref[hit])
    way[count != 1] = -1
    long_enough = np.append(usable, True)[way]
    state = np.where(way < 0, BoundState.MISSING, np.where(long_enough, BoundState.GOOD, BoundState.SHORT))
    state[count > 1] = BoundState.SEVERAL
    return way[relation_rows], state[relation_rows].astype(np.int64)


def lanelets_of(lanelet_map: LaneletMap) -> Lanelets:
    """The lanelets with exactly one left and one right way, each of at least two different nodes.

    Bounds are turned as the Lanelet2 library turns them when it loads a map: the left one so that the
    middle of the right lies right of it, then the right one so that the middle of the left lies left of it.
    """
    document = lanelet_map.document
    rows = lanelet_relations(document)
    usable = usable_ways(document)
    left, left_state = bounds(document, rows, "left", usable)
    right, right_state = bounds(document, rows, "right", usable)
    good = (left_state == BoundState.GOOD) & (right_state == BoundState.GOOD)
    rows, left, right = rows[good], left[good], right[good]
    left_inverted, right_inverted = _orient(lanelet_map, left, right)
    subtype = document.relations.tags.column("subtype")[rows]
    return Lanelets(
        id=document.relations.id[rows],
        relation_row=rows,
        left_way=left,
        right_way=right,
        left_inverted=left_inverted,
        right_inverted=right_inverted,
        subtype=subtype,
        one_way=_one_way(document.relations, subtype, rows),
    )


def bound_polylines(lanelet_map: LaneletMap, lanelets: Lanelets, side: Literal["left", "right"]) -> Polylines:
    """The left or right bound of every lanelet, running along it."""
    ways = lanelets.left_way if side == "left" else lanelets.right_way
    inverted = lanelets.left_inverted if side == "left" else lanelets.right_inverted
    return way_polylines(lanelet_map, ways, inverted)


def way_polylines(lanelet_map: LaneletMap, ways: Ints, inverted: Bools) -> Polylines:
    """The given ways (rows) as polylines, those with `inverted` backwards; all their nodes must exist."""
    offset, flat = kernels.gather(lanelet_map.document.ways.offset, ways, inverted)
    rows = node_rows(lanelet_map.document)[flat]
    return Polylines(offset, lanelet_map.xyz_m[rows], rows)


def centrelines(lanelet_map: LaneletMap, lanelets: Lanelets) -> Polylines:
    """The middle of every lanelet from its start to its end; its vertices are no nodes of the map."""
    left = bound_polylines(lanelet_map, lanelets, "left")
    right = bound_polylines(lanelet_map, lanelets, "right")
    offset, xyz_m = kernels.centrelines(left.offset, left.xyz_m, right.offset, right.xyz_m)
    return Polylines(offset, xyz_m, np.full(len(xyz_m), -1, dtype=np.int64))


def lengths_m(lines: Polylines) -> Floats:
    """(k,) lengths in the plane, metres."""
    return kernels.lengths_m(lines.offset, lines.xyz_m)


def end_nodes(lanelet_map: LaneletMap, lanelets: Lanelets) -> Ints:
    """(k, 4) node rows along the lanelet: start left, start right, end left, end right."""
    left = bound_polylines(lanelet_map, lanelets, "left")
    right = bound_polylines(lanelet_map, lanelets, "right")
    columns = [line.node_row[line.offset[:-1]] for line in (left, right)]
    columns += [line.node_row[line.offset[1:] - 1] for line in (left, right)]
    return np.stack(columns, axis=1)


def follow_pairs(lanelet_map: LaneletMap, lanelets: Lanelets) -> Ints:
    """(p, 2) rows (lanelet, next): both bounds of the next begin at the nodes where both of the first end.

    Along the direction the lanelets are drawn in; ordered by the first, then the second.
    """
    ends = end_nodes(lanelet_map, lanelets)
    n = np.int64(max(len(lanelet_map.xyz_m), 1))
    before, after = kernels.join(ends[:, 2] * n + ends[:, 3], ends[:, 0] * n + ends[:, 1])
    return np.stack([before, after], axis=1)


def adjacency(lanelets: Lanelets) -> Adjacency:
    """Neighbours that share a bound: my left is your right, or your left the other way."""
    left = lanelets.left_way * 4 + lanelets.left_inverted
    right = lanelets.right_way * 4 + 2 + lanelets.right_inverted
    cases = (
        (left, right ^ 2, True, True),
        (left, left ^ 1, True, False),
        (right, left ^ 2, False, True),
        (right, right ^ 1, False, False),
    )
    parts = [(*kernels.join(mine, yours), on_left, same) for mine, yours, on_left, same in cases]
    a = np.concatenate([p[0] for p in parts])
    b = np.concatenate([p[1] for p in parts])
    on_left = np.concatenate([np.full(len(p[0]), p[2]) for p in parts])
    same = np.concatenate([np.full(len(p[0]), p[3]) for p in parts])
    order = np.lexsort((~same, ~on_left, b, a))
    order = order[a[order] != b[order]]
    return Adjacency(a[order], b[order], on_left[order], same[order])


def _orient(lanelet_map: LaneletMap, left: Ints, right: Ints) -> tuple[Bools, Bools]:
    """Which bounds run against their lanelet."""
    straight = np.zeros(len(left), dtype=bool)
    a, b = (way_polylines(lanelet_map, ways, straight) for ways in (left, right))
    left_inverted = kernels.sides(a.offset, a.xyz_m, kernels.middle_points(b.offset, b.xyz_m)) >= 0
    turned = way_polylines(lanelet_map, left, left_inverted)
    middle = kernels.middle_points(turned.offset, turned.xyz_m)
    return left_inverted, kernels.sides(b.offset, b.xyz_m, middle) <= 0


def _one_way(relations: OsmRelations, subtype: Strings, rows: Ints) -> Bools:
    """`one_way`, else `one_way:vehicle`, else what the subtype implies."""
    implied = ~np.isin(subtype.astype(str), TWO_WAY_SUBTYPES)
    for key in ("one_way:vehicle", "one_way"):
        value = relations.tags.column(key)[rows].astype(str)
        implied = np.where(np.isin(value, _TRUE), True, np.where(np.isin(value, _FALSE), False, implied))
    return implied
