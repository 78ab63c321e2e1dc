"""The decisions of conflation: centrelines, matches, transfers, lane check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.model.maps import Findings, LaneletMap


@dataclass(frozen=True, slots=True, eq=False)
class CenterlineMembers:
    """Which lanelets a centreline stands for, each over the centreline's whole length.

    centerline : (k,) int64, row of the centreline; lanelet_id : (k,) int64, every lane of the map once
    direction : (k,) int64, +1 forward, -1 backward
    lane : (k,) int64, 0 for the lane nearest to the middle of the road, growing outwards, per direction
    """

    centerline: Ints
    lanelet_id: Ints
    direction: Ints
    lane: Ints

    def __len__(self) -> int:
        return len(self.lanelet_id)


@dataclass(frozen=True, slots=True, eq=False)
class Centerlines:
    """Adjacent lanelets collapsed to one line each, connected where the lanelets are.

    offset : (c + 1,) int64 into the vertices; xy_m : (m, 2) float64, in the direction of the forward lanelets
    node : (m,) int64, equal where centrelines are connected; connected ends are the same point unless they
    lie further apart than `connect_distance_m`
    members : the lanelets, ordered by centreline and from left to right across it
    """

    lists: ClassVar[tuple[str, ...]] = ("xy_m", "node")

    offset: Ints
    xy_m: Floats
    node: Ints
    members: CenterlineMembers

    def __len__(self) -> int:
        return len(self.offset) - 1


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
class References:
    """What was matched as a whole: reference polylines of buffer growing, or paths of the global matcher.

    reference : (r,) int64, 0 to r - 1; length_m : (r,) float64, metres
    matched : (r,) bool; score : (r,) float64, NaN where unmatched
    buffer_half_width_m : (r,) float64, half width of the buffer that found the match, NaN where there is none
    candidates : (r,) int64, candidates that passed the exclusion limits
    """

    reference: Ints
    length_m: Floats
    matched: Bools
    score: Floats
    buffer_half_width_m: Floats
    candidates: Ints

    def __len__(self) -> int:
        return len(self.reference)


@dataclass(frozen=True, slots=True, eq=False)
class Matched:
    """What matching returns: the decision for every metre of every lane, and the polylines it was made with."""

    matches: Matches
    references: References


@dataclass(frozen=True, slots=True, eq=False)
class Gaps:
    """Where one of the two maps has something that the other has not, one row per stretch.

    kind : (n,) str, "not_in_hd_map" (a road without lanelets) or "not_in_osm" (lanes without a road)
    id : (n,) int64, way or lanelet; s_from_m, s_to_m : (n,) float64 along the way or the lanelet's centreline
    whole : (n,) bool, nothing of the way inside the corridor, or of the lanelet, has a counterpart
    confidence : (n,) float64 in 0..1, NaN where there is no estimate; reason : (n,) str
    """

    kind: Strings
    id: Ints
    s_from_m: Floats
    s_to_m: Floats
    whole: Bools
    confidence: Floats
    reason: Strings

    def __len__(self) -> int:
        return len(self.id)


@dataclass(frozen=True, slots=True, eq=False)
class RoadChanges:
    """What became of matched roads between two dates of OpenStreetMap, one row per change.

    way_id : (n,) int64; kind : (n,) str, "tag", "geometry", "gone" or "new"
    key, old, new : (n,) str, of a tag, "" otherwise
    moved_m : (n,) float64, greatest distance between the old and the new course, NaN where it is no "geometry"
    version_old, version_new : (n,) int64, 0 where the way did not exist
    timestamp_old, timestamp_new : (n,) str, RFC 3339 UTC, "" where the way did not exist
    lanelets : (n,) str, ids of the lanelets that are or were matched to the way, with blanks between
    lon_deg, lat_deg : (n,) float64, WGS84, in the middle of the way
    """

    way_id: Ints
    kind: Strings
    key: Strings
    old: Strings
    new: Strings
    moved_m: Floats
    version_old: Ints
    version_new: Ints
    timestamp_old: Strings
    timestamp_new: Strings
    lanelets: Strings
    lon_deg: Floats
    lat_deg: Floats

    def __len__(self) -> int:
        return len(self.way_id)


@dataclass(frozen=True, slots=True, eq=False)
class Transfers:
    """One row per value that OSM offers a lanelet, and what became of it.

    lanelet_id : (n,) int64, in the new map; source_lanelet_id : (n,) int64, the lanelet it was cut from (or itself)
    key, old, new : (n,) str, "" where there is no value. The key is the attribute, or "lanes", "bus_lane",
    "bicycle_lane", "road_shoulder" where numbers of lanes are compared; "fragment" where the lanelet is beyond the
    number of lanes (`old` in the map, `new` in OSM) and leads nowhere; "" where the lanelet was or is to be cut
    way_id, way_version : (n,) int64; way_timestamp : (n,) str
    confidence : (n,) float64
    action : (n,) str, "set" (written), "keep" (the map's value stands), "review" (for a person, nothing is written),
    "split" (the lanelet was cut off its source) or "remove" (a fragment taken out); reason : (n,) str
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
    verdict : (n,) str, "agree", "differ", "unknown" (no usable tag in OSM, or in a junction), "unmatched"
    review : (n,) bool, the counts differ and no person has decided yet; reason : (n,) str
    """

    lanelet_id: Ints
    way_id: Ints
    lanes_map: Ints
    lanes_osm: Ints
    verdict: Strings
    review: Bools
    reason: Strings


@dataclass(frozen=True, slots=True, eq=False)
class Enriched:
    """What transfer returns: the map with OSM's values, and the tables that say why."""

    map: LaneletMap
    transfers: Transfers
    lane_check: LaneCheck
    findings: Findings
