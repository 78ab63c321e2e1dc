"""What each map has that the other has not, so that either being outdated is seen."""

from __future__ import annotations

import numpy as np
import shapely

from flexmap_tasks.config import GapsParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.geometry.segments import Segments, cut
from flexmap_tasks.matching.road_segments import usable_vertices
from flexmap_tasks.model.arrays import Bools, Floats, Ints, strings
from flexmap_tasks.model.conflation import Centerlines, Gaps, Matches
from flexmap_tasks.model.maps import PlacedRoads

NOT_IN_HD_MAP, NOT_IN_OSM = "not_in_hd_map", "not_in_osm"
STEP_M = 5.0


@stage("gaps")
def find_gaps(centerlines: Centerlines, roads: PlacedRoads, matches: Matches, params: GapsParams) -> Gaps:
    """What one of the two maps has and the other has not, as `params` limits it."""
    return gaps(centerlines, roads, matches, params.corridor_m, params.shortest_m)


def gaps(
    centerlines: Centerlines, roads: PlacedRoads, matches: Matches, corridor_m: float, shortest_m: float
) -> Gaps:
    """Roads within `corridor_m` of the mapped lanes that no lane is matched to, and lanes without a road.

    Stretches shorter than `shortest_m` are left out: a junction always leaves some. Parallel to a mapped lane a
    road is reported as well, for there the corridor cannot tell a missing road from one beyond the map's purpose.
    """
    ways, lanes = _roads_without_lanes(centerlines, roads, matches, corridor_m), _lanes_without_road(matches)
    both = [np.concatenate(pair) for pair in zip(ways, lanes, strict=True)]
    kind = np.repeat(np.array([NOT_IN_HD_MAP, NOT_IN_OSM], dtype=object), [len(ways[0]), len(lanes[0])])
    long = both[2] - both[1] >= shortest_m
    whole = both[3].astype(bool)
    reason = np.where(
        kind == NOT_IN_HD_MAP,
        np.where(whole, "no lane is matched to the road", "no lane is matched to this part of the road"),
        np.where(whole, "no road fits the lanelet", "no road fits this part of the lanelet"),
    )
    return Gaps(
        kind[long], both[0][long].astype(np.int64), both[1][long], both[2][long], whole[long], both[4][long],
        strings(reason[long]),
    )  # fmt: skip


_Rows = tuple[Ints, Floats, Floats, Bools, Floats]


def _roads_without_lanes(
    centerlines: Centerlines, roads: PlacedRoads, matches: Matches, corridor_m: float
) -> _Rows:
    offset, vertex = usable_vertices(roads)
    segments = cut(offset, roads.xy_m[vertex], STEP_M)
    near = _near_lanes(centerlines, segments, corridor_m)
    way = roads.network.way_id[segments.line]
    middle = (segments.s_from_m + segments.s_to_m) / 2
    free = near & ~_covered(way, middle, matches)
    used = np.unique(way[near & ~free])
    n = len(segments)
    goes_on = free[1:] & free[:-1] & (segments.line[1:] == segments.line[:-1])
    first = np.flatnonzero(free & np.append(True, ~goes_on)[:n])
    last = np.flatnonzero(free & np.append(~goes_on, True)[:n])
    unknown = np.full(len(first), np.nan)
    return way[first], segments.s_from_m[first], segments.s_to_m[last], ~np.isin(way[first], used), unknown


def _near_lanes(centerlines: Centerlines, segments: Segments, corridor_m: float) -> Bools:
    """Segments with their middle in the corridor of any centreline."""
    near = np.zeros(len(segments), dtype=bool)
    if not len(centerlines) or not len(segments):
        return near
    owner = np.repeat(np.arange(len(centerlines)), np.diff(centerlines.offset))
    tree = shapely.STRtree(shapely.linestrings(centerlines.xy_m, indices=owner))
    middle = shapely.points((segments.a_m + segments.b_m) / 2)
    near[tree.query(middle, predicate="dwithin", distance=corridor_m)[0]] = True
    return near


def _covered(way: Ints, s_m: Floats, matches: Matches) -> Bools:
    """Whether a matched piece covers each place: the pieces that begin before it outnumber those that end."""
    hit = matches.way_id > 0
    ids = matches.way_id[hit]
    low = np.minimum(matches.way_s_from_m[hit], matches.way_s_to_m[hit])
    high = np.maximum(matches.way_s_from_m[hit], matches.way_s_to_m[hit])
    return np.asarray(_before(ids, low, way, s_m) > _before(ids, high, way, s_m))


def _before(ids: Ints, edge_m: Floats, way: Ints, s_m: Floats) -> Ints:
    """How many edges of the same way lie at or before each place."""
    n, m = len(ids), len(way)
    place = np.concatenate([edge_m, s_m])
    order = np.lexsort((np.arange(n + m) >= n, place, np.concatenate([ids, way])))
    edges = np.cumsum(order < n)
    count = np.empty(n + m, dtype=np.int64)
    count[order] = edges
    return count[n:] - np.searchsorted(np.sort(ids), way)


def _lanes_without_road(matches: Matches) -> _Rows:
    lost = matches.way_id == 0
    n = len(matches)
    same = (matches.lanelet_id[1:] == matches.lanelet_id[:-1]) & lost[1:] & lost[:-1]
    first = np.flatnonzero(lost & np.append(True, ~same)[:n])
    last = np.flatnonzero(lost & np.append(~same, True)[:n])
    partly = np.unique(matches.lanelet_id[~lost])
    length = (matches.s_to_m - matches.s_from_m) * lost
    total = np.append(0.0, np.cumsum(length))
    weighed = np.append(0.0, np.cumsum(length * matches.confidence))
    size = total[last + 1] - total[first]
    certain = np.divide(weighed[last + 1] - weighed[first], size, out=np.ones(len(first)), where=size > 0)
    ids = matches.lanelet_id[first]
    return ids, matches.s_from_m[first], matches.s_to_m[last], ~np.isin(ids, partly), certain
