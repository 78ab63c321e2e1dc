"""What is known exactly about a simulated world."""

from __future__ import annotations

from dataclasses import dataclass

from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings, require


@dataclass(frozen=True, slots=True, eq=False)
class TruePoses:
    """Where the body truly was at every SLAM pose, in the order of the recording.

    stamp_ns : (n,) int64; lonlat_deg : (n, 2) WGS84; ele_m : (n,) ellipsoidal height
    yaw_rad, pitch_rad : (n,) heading counter-clockwise from grid east, and nose down
    outage, multipath, standstill : (n,) bool, what GNSS and vehicle were doing
    """

    stamp_ns: Ints
    lonlat_deg: Floats
    ele_m: Floats
    yaw_rad: Floats
    pitch_rad: Floats
    outage: Bools
    multipath: Bools
    standstill: Bools

    def __len__(self) -> int:
        return len(self.stamp_ns)


@dataclass(frozen=True, slots=True, eq=False)
class TrueNodes:
    """Where every node of the HD map belongs: node_id (n,) int64; lonlat_deg (n, 2); ele_m (n,)."""

    node_id: Ints
    lonlat_deg: Floats
    ele_m: Floats


@dataclass(frozen=True, slots=True, eq=False)
class TrueMatches:
    """The way every piece of a drivable lanelet belongs to; pieces cover each lanelet without gaps.

    lanelet_id : (n,) int64; s_from_m, s_to_m, lanelet_length_m : (n,) along the true centreline
    way_id : (n,) int64, 0 where OpenStreetMap has none; also_way_id : another way that is right too, or 0
    direction : (n,) int64, +1 along the way, -1 against it, 0 none
    kind : (n,) str, "link", "junction", "stub" or "none"; reason : (n,) str, why there is none
    """

    lanelet_id: Ints
    s_from_m: Floats
    s_to_m: Floats
    lanelet_length_m: Floats
    way_id: Ints
    also_way_id: Ints
    direction: Ints
    kind: Strings
    reason: Strings

    def __post_init__(self) -> None:
        require(bool((self.lanelet_length_m > 0).all()), "a true lanelet has a length")


@dataclass(frozen=True, slots=True, eq=False)
class TrueTags:
    """The value every piece of a lanelet should get.

    lanelet_id, s_from_m, s_to_m, lanelet_length_m : as for matches; key : (n,) str, Lanelet2 attribute
    value : (n,) str, the real world; osm_value : (n,) str, what OpenStreetMap says, "" where it says nothing
    """

    lanelet_id: Ints
    s_from_m: Floats
    s_to_m: Floats
    lanelet_length_m: Floats
    key: Strings
    value: Strings
    osm_value: Strings


@dataclass(frozen=True, slots=True, eq=False)
class TrueLanes:
    """Lanes of the road of every lanelet: lanes_drawn in the map, lanes_osm by its way (-1: no tag, way 0: none)."""

    lanelet_id: Ints
    way_id: Ints
    lanes_drawn: Ints
    lanes_osm: Ints


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """All of it."""

    poses: TruePoses
    nodes: TrueNodes
    matches: TrueMatches
    tags: TrueTags
    lanes: TrueLanes
