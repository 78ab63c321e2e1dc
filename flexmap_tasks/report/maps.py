"""Maps and roads for the report: lines, lanelets, tags."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexmap_tasks.geometry.lanelets import gather, lengths_m
from flexmap_tasks.model import lanelets as lanes
from flexmap_tasks.model.alignment import Warp
from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.maps import LaneletMap, RoadNetwork
from flexmap_tasks.report.embed import Json, Texts, millimetres, numbers


def moved(lanelet_map: LaneletMap, warp: Warp) -> LaneletMap:
    """The map where a warp puts it."""
    return replace(lanelet_map, xyz_m=warp.apply_drawn(lanelet_map.xyz_m))


def map_of(lanelet_map: LaneletMap, texts: Texts) -> Json:
    """Lines and lanelets of a map."""
    return {"lines": lines_of(lanelet_map, texts), "lanelets": lanelets_of(lanelet_map, texts)}


def lines_of(lanelet_map: LaneletMap, texts: Texts) -> Json:
    """Every way of the map whose nodes exist, as a line."""
    ways = lanelet_map.document.ways
    rows = np.flatnonzero(lanes.usable_ways(lanelet_map.document))
    lines = lanes.way_polylines(lanelet_map, rows, np.zeros(len(rows), dtype=bool))
    return {
        "id": numbers(ways.id[rows], "i8"),
        "offset": numbers(lines.offset, "i4"),
        "xy": millimetres(lines.xyz_m),
        "kind": texts.column(ways.tags.column("type")[rows]),
    }


def lanelets_of(lanelet_map: LaneletMap, texts: Texts) -> Json:
    """Lanelets by row: both bounds as rows of `lines_of`, turned along the lanelet, length and tags."""
    found = lanes.lanelets_of(lanelet_map)
    usable = np.flatnonzero(lanes.usable_ways(lanelet_map.document))
    row_of_way = np.full(len(lanelet_map.document.ways.id), -1, dtype=np.int64)
    row_of_way[usable] = np.arange(len(usable))
    return {
        "id": numbers(found.id, "i8"),
        "left": numbers(row_of_way[found.left_way], "i4"),
        "right": numbers(row_of_way[found.right_way], "i4"),
        "left_inverted": numbers(found.left_inverted, "u1"),
        "right_inverted": numbers(found.right_inverted, "u1"),
        "length": numbers(lanes.lengths_m(lanes.centrelines(lanelet_map, found)), "f4"),
        "tags": texts.tags(lanelet_map.document.relations.tags.take(found.relation_row)),
    }


def roads_of(
    roads: RoadNetwork, xy_m: Floats, near: Floats, margin_m: float, texts: Texts
) -> tuple[Json, Ints]:
    """The roads that come within `margin_m` of the box around `near`, and their rows."""
    rows = _rows_near(roads.offset, xy_m, near, margin_m)
    offset, flat = gather(roads.offset, rows, np.zeros(len(rows), dtype=bool))
    return {
        "id": numbers(roads.way_id[rows], "i8"),
        "version": numbers(roads.version[rows], "i4"),
        "timestamp": texts.column(roads.timestamp[rows]),
        "offset": numbers(offset, "i4"),
        "xy": millimetres(xy_m[flat]),
        "length": numbers(lengths_m(offset, xy_m[flat]) if len(rows) else np.zeros(0), "f4"),
        "tags": texts.tags(roads.tags.take(rows)),
        "note": texts.column(roads.note[rows]) if roads.note is not None else None,
        "left_out": len(roads) - len(rows),
    }, rows


def _rows_near(offset: Ints, xy_m: Floats, near: Floats, margin_m: float) -> Ints:
    """Polylines whose box meets the box of `near`, widened by `margin_m`."""
    known = near[np.isfinite(near).all(axis=1)]
    if not len(known) or not len(xy_m):
        return np.arange(len(offset) - 1, dtype=np.int64)
    low, high = known.min(axis=0) - margin_m, known.max(axis=0) + margin_m
    least = np.minimum.reduceat(xy_m, offset[:-1])
    most = np.maximum.reduceat(xy_m, offset[:-1])
    return np.flatnonzero(((least <= high) & (most >= low)).all(axis=1))
