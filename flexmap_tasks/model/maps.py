"""The two maps: lanelets in a metric frame, and OpenStreetMap's roads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings, require
from flexmap_tasks.model.osm import OsmDocument, Tags

OSM_ATTRIBUTION = (
    "Road data © OpenStreetMap contributors, Open Database License, https://www.openstreetmap.org/copyright"
)
"""What the licence of OpenStreetMap's data (ODbL) wants to be read wherever they are passed on."""


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """What a reader or a stage noticed and a person should know; one row each.

    code : (n,) str, stable name of the rule, such as "lanelet-without-bound"
    severity : (n,) str, "error", "warning" or "info"
    primitive : (n,) str, "node", "way", "lanelet", "regulatory_element", "road", "map", ...
    id : (n,) int64, id of the primitive in its map, 0 where it has none
    message : (n,) str, one sentence
    """

    code: Strings
    severity: Strings
    primitive: Strings
    id: Ints
    message: Strings

    def __len__(self) -> int:
        return len(self.code)


@dataclass(frozen=True, slots=True, eq=False)
class LaneletMap:
    """A Lanelet2 map: the whole document, and where its nodes lie in a metric frame.

    document : everything the file says; node rows here and in `xyz_m` are the same
    xyz_m : (n, 3) float64, metres; the SLAM frame when read, the map frame after georeferencing
    findings : what reading it brought to light
    """

    document: OsmDocument
    xyz_m: Floats
    findings: Findings

    def __post_init__(self) -> None:
        require(self.xyz_m.shape == (len(self.document.nodes.id), 3), "one position per node")


@dataclass(frozen=True, slots=True, eq=False)
class Lanelets:
    """The lanelets of a map as columns; bounds oriented along the lanelet, left on the left.

    id : (k,) int64, relation id; relation_row : (k,) int64, its row in the document
    left_way, right_way : (k,) int64, rows of the bounds in `document.ways`
    left_inverted, right_inverted : (k,) bool, the way runs against the lanelet
    subtype : (k,) str or None; one_way : (k,) bool as Lanelet2's default rules read it
    """

    id: Ints
    relation_row: Ints
    left_way: Ints
    right_way: Ints
    left_inverted: Bools
    right_inverted: Bools
    subtype: Strings
    one_way: Bools

    def __len__(self) -> int:
        return len(self.id)


@dataclass(frozen=True, slots=True, eq=False)
class RoadNetwork:
    """OpenStreetMap ways that vehicles drive on, by way id.

    way_id, version : (w,) int64; timestamp : (w,) str, RFC 3339 UTC or "" where the extract has none
    offset : (w + 1,) int64 into the vertices; node_id : (m,) int64
    lonlat_deg : (m, 2) float64, WGS84
    tags : all tags of every way, keys in order
    note : (w,) str, what had to be repaired, "" where nothing; None where nobody looked
    built_up, open_land : (w,) float64, shares of the way's length along towns, and between them; None as above
    city_limit : (w,) int64, +1 where signs put the way inside a town, -1 outside, 0 none does; None as above
    """

    lists: ClassVar[tuple[str, ...]] = ("node_id", "lonlat_deg")

    way_id: Ints
    version: Ints
    timestamp: Strings
    offset: Ints
    node_id: Ints
    lonlat_deg: Floats
    tags: Tags
    note: Strings | None = None
    built_up: Floats | None = None
    open_land: Floats | None = None
    city_limit: Ints | None = None

    def __len__(self) -> int:
        return len(self.way_id)

    def __post_init__(self) -> None:
        n, m = len(self.way_id), len(self.node_id)
        columns = (self.version, self.timestamp, self.tags, self.offset[1:])
        require(all(len(c) == n for c in columns), "road columns differ in length")
        require(self.lonlat_deg.shape == (m, 2) and self.offset[-1] == m, "one position per vertex of a road")


@dataclass(frozen=True, slots=True)
class GeoBox:
    """A box on the WGS84 ellipsoid that does not cross the antimeridian, degrees."""

    west_deg: float
    south_deg: float
    east_deg: float
    north_deg: float

    def __str__(self) -> str:
        return f"lat {self.south_deg:.4f} to {self.north_deg:.4f}, lon {self.west_deg:.4f} to {self.east_deg:.4f}"


@dataclass(frozen=True, slots=True, eq=False)
class PlacedRoads:
    """Roads in the frame the lanelet map lies in.

    network : the roads; xy_m : (m, 2) float64, one row per vertex of the network
    """

    network: RoadNetwork
    xy_m: Floats
