"""What conflation decided, for the report: matches and their links, transfers, lane check, review, findings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.model import lanelets as lanes
from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.conflation import LaneCheck, Matches, RoadChanges, Transfers
from flexmap_tasks.model.maps import Findings, LaneletMap, RoadNetwork
from flexmap_tasks.model.osm import rows_of
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.report.along import places_along
from flexmap_tasks.report.embed import Json, Texts, millimetres, numbers
from flexmap_tasks.report.review_items import ReviewItems, change_words

LINK_EVERY_M = 15.0
MOST_LINKS = 200
"""Per match; a longer piece gets them further apart."""


def matches_of(matches: Matches, texts: Texts) -> Json:
    """One row per lanelet piece."""
    shares = {name: getattr(matches, name) for name in ("score", "confidence")}
    metres = {
        name: getattr(matches, name) for name in ("s_from_m", "s_to_m", "d_length_m", "d_chord_m", "d_area_m")
    }
    return {
        "lanelet": numbers(matches.lanelet_id, "i8"),
        "way": numbers(matches.way_id, "i8"),
        "direction": numbers(matches.direction, "i4"),
        "decision": texts.column(matches.decision),
        "reason": texts.column(matches.reason),
        "d_angle_deg": numbers(np.nan_to_num(matches.d_angle_deg, nan=-1.0), "f4"),
        **{name: numbers(np.nan_to_num(value, nan=-1.0), "f4") for name, value in (shares | metres).items()},
    }


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """Short lines from lanelets to the ways they were matched with.

    row : (n,) int64, row of the match; lane_m, way_m : (n, 2) float64, both ends in the map frame
    """

    row: Ints
    lane_m: Floats
    way_m: Floats


def links_between(matches: Matches, source: LaneletMap, roads: RoadNetwork, roads_xy_m: Floats) -> Links:
    """A link every few metres of every match; all in the map frame."""
    found = lanes.lanelets_of(source)
    middle = lanes.centrelines(source, found)
    lane, way = rows_of(found.id, matches.lanelet_id), rows_of(roads.way_id, matches.way_id)
    hit = np.flatnonzero((matches.way_id != 0) & (lane >= 0) & (way >= 0))
    length = np.nan_to_num(matches.s_to_m[hit] - matches.s_from_m[hit])
    count = np.clip(np.ceil(length / LINK_EVERY_M), 1, MOST_LINKS).astype(np.int64)
    row = np.repeat(hit, count)
    first = np.repeat(np.cumsum(count) - count, count)
    share = (np.arange(len(row)) - first + 0.5) / np.repeat(count, count)
    at_lane = _between(matches.s_from_m, matches.s_to_m, row, share)
    at_way = _between(matches.way_s_from_m, matches.way_s_to_m, row, share)
    lane_m = places_along(middle.offset, middle.xyz_m, lane[row], at_lane)
    way_m = places_along(roads.offset, roads_xy_m, way[row], at_way)
    good = np.isfinite(lane_m).all(axis=1) & np.isfinite(way_m).all(axis=1)
    return Links(row[good], lane_m[good], way_m[good])


def links_of(links: Links) -> Json:
    """The links by row."""
    return {
        "row": numbers(links.row, "i4"),
        "lane": millimetres(links.lane_m),
        "way": millimetres(links.way_m),
    }


def transfers_of(transfers: Transfers, texts: Texts) -> Json:
    """One row per value OSM offered."""
    text = ("key", "old", "new", "way_timestamp", "action", "reason")
    return {
        "lanelet": numbers(transfers.lanelet_id, "i8"),
        "source": numbers(transfers.source_lanelet_id, "i8"),
        "way": numbers(transfers.way_id, "i8"),
        "version": numbers(transfers.way_version, "i4"),
        "confidence": numbers(np.nan_to_num(transfers.confidence, nan=-1.0), "f4"),
        **{name: texts.column(getattr(transfers, name)) for name in text},
    }


def lane_check_of(check: LaneCheck, texts: Texts) -> Json:
    """One row per lanelet."""
    return {
        "lanelet": numbers(check.lanelet_id, "i8"),
        "way": numbers(check.way_id, "i8"),
        "lanes_map": numbers(check.lanes_map, "i4"),
        "lanes_osm": numbers(check.lanes_osm, "i4"),
        "verdict": texts.column(check.verdict),
        "reason": texts.column(check.reason),
    }


def changes_of(changes: RoadChanges, projection: Projection, texts: Texts) -> Json:
    """One row per change of a matched road; what it is, from what to what, and where."""
    key, old, new = change_words(changes)
    lonlat = np.column_stack([changes.lon_deg, changes.lat_deg])
    return {
        "way": numbers(changes.way_id, "i8"),
        "kind": texts.column(changes.kind),
        "key": texts.column(key),
        "old": texts.column(old),
        "new": texts.column(new),
        "moved_m": numbers(np.nan_to_num(changes.moved_m, nan=-1.0), "f4"),
        "version_old": numbers(changes.version_old, "i4"),
        "version_new": numbers(changes.version_new, "i4"),
        "time_old": texts.column(changes.timestamp_old),
        "time_new": texts.column(changes.timestamp_new),
        "lanelets": texts.column(changes.lanelets),
        "xy": millimetres(projection.to_xy_m(lonlat) if len(changes) else np.zeros((0, 2))),
    }


def review_of(items: ReviewItems, texts: Texts) -> Json:
    """All that waits for a person: the table it stands in, its row there, and the lanelet; ordered by lanelet."""
    return {
        "lanelet": numbers(items.lanelet_id, "i8"),
        "kind": texts.column(items.kind),
        "row": numbers(items.row, "i4"),
    }


def findings_of(findings: list[Findings], final: LaneletMap | None, texts: Texts) -> Json | None:
    """One row per finding; ways and nodes of the map with their place."""
    if not findings:
        return None
    text = ("code", "severity", "primitive", "message")
    columns = {name: np.concatenate([getattr(f, name) for f in findings]) for name in text}
    ids = np.concatenate([f.id for f in findings])
    return {
        "id": numbers(ids, "i8"),
        "xy": millimetres(finding_places(columns["primitive"], ids, final)),
        **{name: texts.column(column) for name, column in columns.items()},
    }


def finding_places(primitive: np.ndarray, ids: Ints, final: LaneletMap | None) -> Floats:
    """(n, 2) where nodes and ways lie; NaN for all else, which the page finds by its id."""
    xy_m = np.full((len(ids), 2), np.nan)
    if final is None:
        return xy_m
    document = final.document
    node = rows_of(document.nodes.id, ids)
    way = rows_of(document.ways.id, ids)
    at_way = (primitive == "way") & (way >= 0)
    has_nodes = at_way.copy()
    has_nodes[at_way] = np.diff(document.ways.offset)[way[at_way]] > 0
    first = document.ways.ref[document.ways.offset[way[has_nodes]]]
    node[has_nodes] = rows_of(document.nodes.id, first)
    known = ((primitive == "node") | has_nodes) & (node >= 0)
    xy_m[known] = final.xyz_m[node[known], :2]
    return xy_m


def _between(start_m: Floats, stop_m: Floats, row: Ints, share: Floats) -> Floats:
    return start_m[row] + share * (stop_m[row] - start_m[row])
