"""The baseline every matcher must beat: the nearest way that runs within 30 degrees."""

from __future__ import annotations

import numpy as np
import shapely

from flexmap_tasks.evaluation.matching_truth import Prediction
from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.lanelets import centrelines, lanelets_of
from flexmap_tasks.model.maps import LaneletMap, PlacedRoads

ANGLE_MAX_DEG = 30.0
DISTANCE_MAX_M = 15.0
"""A lane's middle lies no further from the middle of its road."""
STEP_M = 1.0


def nearest_way(lanelet_map: LaneletMap, roads: PlacedRoads, subtypes: tuple[str, ...]) -> Prediction:
    """For every metre of every lanelet with one of the subtypes the nearest way within 30 degrees, if any.

    Map and roads in the same frame.
    """
    lanelets = lanelets_of(lanelet_map)
    use = np.flatnonzero(np.isin(lanelets.subtype.astype(str), subtypes))
    lines = centrelines(lanelet_map, lanelets)
    owner, start, stop, place, heading = _samples(lines.offset, lines.xyz_m[:, :2], use)
    way, along = _nearest(place, heading, roads)
    decision = np.where(way != 0, "match", "none").astype(object)
    return Prediction(lanelets.id[owner], start, stop, way, along, decision, (way != 0).astype(np.float64))


def _samples(offset: Ints, xy_m: Floats, rows: Ints) -> tuple[Ints, Floats, Floats, Floats, Floats]:
    """Equal pieces of about a metre: line, start and stop share, middle (n, 2), heading in radians."""
    parts = []
    for row in rows.tolist():
        line = shapely.LineString(xy_m[offset[row] : offset[row + 1]])
        count = max(1, round(line.length / STEP_M))
        share = np.arange(count + 1) / count
        at = shapely.get_coordinates(shapely.line_interpolate_point(line, share, normalized=True))
        run = np.diff(at, axis=0)
        heading = np.arctan2(run[:, 1], run[:, 0])
        parts.append((np.full(count, row), share[:-1], share[1:], (at[1:] + at[:-1]) / 2, heading))
    if not parts:
        return np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty((0, 2)), np.empty(0)
    owner, start, stop, place, heading = (np.concatenate(column) for column in zip(*parts, strict=True))
    return owner.astype(np.int64), start, stop, place, heading


def _nearest(place: Floats, heading: Floats, roads: PlacedRoads) -> tuple[Ints, Ints]:
    """Way id and direction (+1 along, -1 against) per place, 0 where no way is near."""
    network, n = roads.network, len(roads.xy_m)
    last = np.zeros(n, dtype=bool)
    last[network.offset[1:] - 1] = True
    a = np.flatnonzero(~last)
    run = roads.xy_m[a + 1] - roads.xy_m[a]
    owner = np.repeat(np.arange(len(network)), np.diff(network.offset) - 1)
    segments = shapely.linestrings(np.stack([roads.xy_m[a], roads.xy_m[a + 1]], axis=1))
    points = shapely.points(place)
    point, segment = shapely.STRtree(segments).query(points, predicate="dwithin", distance=DISTANCE_MAX_M)
    turn = heading[point] - np.arctan2(run[segment, 1], run[segment, 0])
    fits = np.abs(np.cos(turn)) >= np.cos(np.radians(ANGLE_MAX_DEG))
    point, segment, turn = point[fits], segment[fits], turn[fits]
    distance = shapely.distance(points[point], segments[segment])
    order = np.lexsort((segment, distance, point))
    first = order[np.flatnonzero(np.diff(point[order], prepend=-1))]
    way, along = np.zeros(len(place), dtype=np.int64), np.zeros(len(place), dtype=np.int64)
    way[point[first]] = network.way_id[owner[segment[first]]]
    along[point[first]] = np.where(np.cos(turn[first]) > 0, 1, -1)
    return way, along
