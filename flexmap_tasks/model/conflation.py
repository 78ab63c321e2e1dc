"""The decisions of conflation: centrelines, matches, transfers, lane check."""

from __future__ import annotations

from dataclasses import dataclass

from flexmap_tasks.model.arrays import Floats, Ints, Strings
from flexmap_tasks.model.maps import Findings, LaneletMap


@dataclass(frozen=True, slots=True, eq=False)
class Centerlines:
    """Adjacent lanelets collapsed to one line each, connected where the lanelets are.

    offset : (c + 1,) int64 into the vertices; xy_m : (m, 2) float64, in the direction of the forward lanelets
    node : (m,) int64, equal where two centrelines share a point
    member_centerline : (k,) int64, the centreline a lanelet belongs to
    member_lanelet_id : (k,) int64; member_direction : (k,) int64, +1 forward, -1 backward
    member_lane : (k,) int64, 0 for the lane nearest to the middle of the road, growing outwards
    """

    offset: Ints
    xy_m: Floats
    node: Ints
    member_centerline: Ints
    member_lanelet_id: Ints
    member_direction: Ints
    member_lane: Ints


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """One row per lanelet piece.

    lanelet_id : (n,) int64; s_from_m, s_to_m : (n,) float64 along the lanelet's centreline, metres
    way_id : (n,) int64, 0 where there is no counterpart; way_s_from_m, way_s_to_m : (n,) float64 along the way,
    NaN where there is none; direction : (n,) int64, +1 along the way, -1 against it, 0 none
    score, confidence : (n,) float64 in 0..1
    decision : (n,) str, "match", "none" or "review"; reason : (n,) str
    reference : (n,) int64, the reference polyline (or path) the piece was decided with
    d_angle_deg, d_length_m, d_chord_m, d_area_m : (n,) float64, the score terms, NaN where there is none
    """

    lanelet_id: Ints
    s_from_m: Floats
    s_to_m: Floats
    way_id: Ints
    way_s_from_m: Floats
    way_s_to_m: Floats
    direction: Ints
    score: Floats
    confidence: Floats
    decision: Strings
    reason: Strings
    reference: Ints
    d_angle_deg: Floats
    d_length_m: Floats
    d_chord_m: Floats
    d_area_m: Floats

    def __len__(self) -> int:
        return len(self.lanelet_id)


@dataclass(frozen=True, slots=True, eq=False)
class Transfers:
    """One row per value that OSM offers a lanelet, and what became of it.

    lanelet_id : (n,) int64, in the new map; source_lanelet_id : (n,) int64, the lanelet it was cut from (or itself)
    key, old, new : (n,) str, "" where there is no value
    way_id, way_version : (n,) int64; way_timestamp : (n,) str
    confidence : (n,) float64
    action : (n,) str, "set", "keep", "review", "split" or "remove"; reason : (n,) str
    """

    lanelet_id: Ints
    source_lanelet_id: Ints
    key: Strings
    old: Strings
    new: Strings
    way_id: Ints
    way_version: Ints
    way_timestamp: Strings
    confidence: Floats
    action: Strings
    reason: Strings


@dataclass(frozen=True, slots=True, eq=False)
class LaneCheck:
    """The lane count of the map against OSM's, per lanelet.

    lanelet_id, way_id : (n,) int64 (way 0 where unmatched)
    lanes_map, lanes_osm : (n,) int64, -1 where unknown
    verdict : (n,) str, "agree", "differ", "unknown" (OSM has no usable tag) or "unmatched"
    reason : (n,) str
    """

    lanelet_id: Ints
    way_id: Ints
    lanes_map: Ints
    lanes_osm: Ints
    verdict: Strings
    reason: Strings


@dataclass(frozen=True, slots=True, eq=False)
class Enriched:
    """What transfer returns: the map with OSM's values, and the tables that say why."""

    map: LaneletMap
    transfers: Transfers
    lane_check: LaneCheck
    findings: Findings
