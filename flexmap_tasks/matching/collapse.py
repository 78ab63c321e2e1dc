"""Adjacent lanelets become one centreline per road, connected where the lanelets follow each other."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from flexmap_tasks.config import CollapseParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.geometry import lanelets as kernels
from flexmap_tasks.geometry.chains import chains, reciprocated
from flexmap_tasks.geometry.segments import first_of_groups
from flexmap_tasks.model import lanelets as lanes
from flexmap_tasks.model.arrays import Bools, Floats, Ints
from flexmap_tasks.model.conflation import CenterlineMembers, Centerlines
from flexmap_tasks.model.maps import LaneletMap, Lanelets


@dataclass(frozen=True, slots=True, eq=False)
class _Groups:
    """Lanelets side by side, seen along the forward ones.

    offset : (c + 1,) int64; row : (k,) int64, lanelets from left to right; backward : (k,) bool
    """

    offset: Ints
    row: Ints
    backward: Bools


@stage("centerlines")
def collapse(lanelet_map: LaneletMap, params: CollapseParams) -> Centerlines:
    """Collapse lanelets that share a bound to one centreline, forward and backward lanes together.

    Only `params.lane_subtypes` count as lanes. Forward is the direction with more lanes; where both have as
    many, the one that starts further west (then south). Order and numbers depend on geometry alone, never on
    ids. Source: Leitenstern et al. 2024, section III-B.
    """
    found = lanes.lanelets_of(lanelet_map)
    rows = drivable_rows(found, params.lane_subtypes)
    lanelets = take(found, rows)
    groups = _side_by_side(lanelet_map, lanelets, params.driving_side)
    offset, xy_m = _middle(lanelet_map, lanelets, groups)
    groups, offset, xy_m = _in_order(groups, offset, xy_m)
    mouth = _mouths(lanelet_map, lanelets, groups)
    xy_m = _joined(offset, xy_m, mouth, params.connect_distance_m)
    return Centerlines(
        offset, xy_m, _nodes(offset, mouth.label), _members(lanelets, groups, params.driving_side)
    )


def drivable_rows(lanelets: Lanelets, subtypes: tuple[str, ...]) -> Ints:
    """Rows of the lanelets that count as lanes; one without a subtype is a road, as Lanelet2 reads it."""
    subtype = np.where(lanelets.subtype == None, "road", lanelets.subtype)  # noqa: E711 - elementwise
    return np.flatnonzero(np.isin(subtype.astype(str), subtypes))


def take(lanelets: Lanelets, rows: Ints) -> Lanelets:
    """The chosen lanelets in the given order."""
    return Lanelets(**{f.name: getattr(lanelets, f.name)[rows] for f in fields(Lanelets)})


def members_as_lanelets(centerlines: Centerlines, lanelet_map: LaneletMap) -> Lanelets:
    """The lanelets of the members, in the order of the members."""
    found = lanes.lanelets_of(lanelet_map)
    order = np.argsort(found.id, kind="stable")
    return take(found, order[np.searchsorted(found.id[order], centerlines.members.lanelet_id)])


def member_lengths_m(centerlines: Centerlines, lanelet_map: LaneletMap) -> Floats:
    """(k,) length of the own centreline of every member."""
    return lanes.lengths_m(lanes.centrelines(lanelet_map, members_as_lanelets(centerlines, lanelet_map)))


def _side_by_side(
    lanelet_map: LaneletMap, lanelets: Lanelets, driving_side: Literal["right", "left"]
) -> _Groups:
    """Chains of lanelets across the road, joined where two agree that they are each other's neighbour."""
    near = lanes.adjacency(lanelets)
    line = lanes.centrelines(lanelet_map, lanelets)
    length = lanes.lengths_m(line)
    order = _canonical_order(line.offset, line.xyz_m[:, :2])
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    # Traffic that comes towards us drives on the side away from the kerb.
    counts = near.same_direction | (near.on_left == (driving_side == "right"))
    a, b, on_left, same = (
        c[counts] for c in (near.lanelet, near.neighbour, near.on_left, near.same_direction)
    )
    end = rank[a] * 2 + ~on_left
    other = rank[b] * 2 + np.where(same, on_left, ~on_left)
    best = first_of_groups(end, ~same, np.abs(length[a] - length[b]), rank[b])
    partner = np.full(2 * len(lanelets), -1, dtype=np.int64)
    partner[end[best]] = other[best]
    offset, item, backward = chains(reciprocated(partner))
    return _forward_first(_Groups(offset, order[item], backward), line)


def _forward_first(groups: _Groups, line: lanes.Polylines) -> _Groups:
    """Every group turned so that most of its lanes run forward."""
    if not len(groups.row):
        return groups
    size = np.diff(groups.offset)
    back = np.add.reduceat(groups.backward.astype(np.int64), groups.offset[:-1])
    first = groups.row[groups.offset[:-1]]
    run = line.xyz_m[line.offset[first + 1] - 1, :2] - line.xyz_m[line.offset[first], :2]
    run = np.where(groups.backward[groups.offset[:-1]][:, None], -run, run)
    eastward = (run[:, 0] > 0) | ((run[:, 0] == 0) & (run[:, 1] > 0))
    flip = (2 * back > size) | ((2 * back == size) & ~eastward)
    offset, flat = kernels.gather(groups.offset, np.arange(len(size)), flip)
    return _Groups(offset, groups.row[flat], groups.backward[flat] ^ np.repeat(flip, size))


def _middle(lanelet_map: LaneletMap, lanelets: Lanelets, groups: _Groups) -> tuple[Ints, Floats]:
    """The middle between the outermost bounds of every group."""
    ways = []
    for at, left in ((groups.offset[:-1], True), (groups.offset[1:] - 1, False)):
        row, backward = groups.row[at], groups.backward[at]
        use_left = backward ^ left
        way = np.where(use_left, lanelets.left_way[row], lanelets.right_way[row])
        inverted = np.where(use_left, lanelets.left_inverted[row], lanelets.right_inverted[row])
        ways.append(lanes.way_polylines(lanelet_map, way, inverted ^ backward))
    offset, xyz_m = kernels.centrelines(ways[0].offset, ways[0].xyz_m, ways[1].offset, ways[1].xyz_m)
    return offset, np.ascontiguousarray(xyz_m[:, :2])


def _canonical_order(offset: Ints, xy_m: Floats) -> Ints:
    """Rows of polylines by their first point, last point and number of vertices: the same whatever the ids."""
    first, last = xy_m[offset[:-1]], xy_m[offset[1:] - 1]
    return np.lexsort((np.diff(offset), last[:, 1], last[:, 0], first[:, 1], first[:, 0]))


def _in_order(groups: _Groups, offset: Ints, xy_m: Floats) -> tuple[_Groups, Ints, Floats]:
    order = _canonical_order(offset, xy_m)
    straight = np.zeros(len(order), dtype=bool)
    line_offset, vertex = kernels.gather(offset, order, straight)
    group_offset, member = kernels.gather(groups.offset, order, straight)
    groups = _Groups(group_offset, groups.row[member], groups.backward[member])
    return groups, line_offset, xy_m[vertex]


@dataclass(frozen=True, slots=True, eq=False)
class _Mouths:
    """Ends of centrelines (2 c: start) and (2 c + 1: end) that lanelets connect.

    pair : (p, 2) int64, ends joined by a lanelet and its follower; label : (2 c,) int64, connected ends alike
    """

    pair: Ints
    label: Ints


def _mouths(lanelet_map: LaneletMap, lanelets: Lanelets, groups: _Groups) -> _Mouths:
    follow = lanes.follow_pairs(lanelet_map, lanelets)
    group = np.empty(len(lanelets), dtype=np.int64)
    group[groups.row] = np.repeat(np.arange(len(groups.offset) - 1), np.diff(groups.offset))
    back = np.zeros(len(lanelets), dtype=bool)
    back[groups.row] = groups.backward
    a, b = follow.T
    pair = np.stack([group[a] * 2 + ~back[a], group[b] * 2 + back[b]], axis=1)
    pair = np.unique(np.sort(pair, axis=1), axis=0).reshape(-1, 2)
    return _Mouths(pair, _components(pair, 2 * (len(groups.offset) - 1)))


def _components(pair: Ints, n: int) -> Ints:
    graph = coo_array((np.ones(len(pair)), (pair[:, 0], pair[:, 1])), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _joined(offset: Ints, xy_m: Floats, mouth: _Mouths, connect_distance_m: float) -> Floats:
    """Connected ends nearer than the limit moved to their common mean."""
    vertex = np.stack([offset[:-1], offset[1:] - 1], axis=1).ravel()
    point = xy_m[vertex]
    gap = np.hypot(*(point[mouth.pair[:, 0]] - point[mouth.pair[:, 1]]).T)
    label = _components(mouth.pair[gap <= connect_distance_m], len(vertex))
    # Summed in an order that geometry fixes, so that the mean has the same bits whatever the ids.
    order = np.lexsort((point[:, 1], point[:, 0], label))
    count = np.bincount(label)
    mean = np.stack([np.bincount(label[order], weights=point[order, k]) for k in (0, 1)], axis=1)
    mean = np.where(count[:, None] > 1, mean / count[:, None], 0.0)
    out = xy_m.copy()
    shared = count[label] > 1
    out[vertex[shared]] = mean[label[shared]]
    return out


def _nodes(offset: Ints, label: Ints) -> Ints:
    """(m,) node numbers of all vertices, counted in the order of the vertices."""
    m = int(offset[-1])
    key = np.arange(m) + len(label)
    key[offset[:-1]], key[offset[1:] - 1] = label[::2], label[1::2]
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    number = np.empty(len(first), dtype=np.int64)
    number[np.argsort(first)] = np.arange(len(first))
    return number[inverse]


def _members(
    lanelets: Lanelets, groups: _Groups, driving_side: Literal["right", "left"]
) -> CenterlineMembers:
    size = np.diff(groups.offset)
    owner = np.repeat(np.arange(len(size)), size)
    # From the middle outwards: a lane's place among those of its group and direction, counted from the side
    # on which oncoming traffic would be.
    key = owner * 2 + groups.backward
    place = np.arange(len(owner))
    inner_first = groups.backward if driving_side == "right" else ~groups.backward
    order = np.lexsort((np.where(inner_first, -place, place), key))
    lane = np.empty(len(owner), dtype=np.int64)
    lane[order] = np.arange(len(owner)) - np.searchsorted(key[order], key[order])
    return CenterlineMembers(
        owner, lanelets.id[groups.row], np.where(groups.backward, -1, 1).astype(np.int64), lane
    )
