"""The Lanelet2 map as a person would draw it over the SLAM cloud with VectorMapBuilder."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexmap_tasks.geometry.utm import to_lonlat
from flexmap_tasks.model.arrays import Floats, Ints, Strings, strings
from flexmap_tasks.model.osm import OsmDocument
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.chance import stream
from flexmap_tasks.simulate.document import DocumentDraft, same_keys, texts
from flexmap_tasks.simulate.drive import Drive
from flexmap_tasks.simulate.hd_coverage import Piece, coverage, joins, missing_lanes
from flexmap_tasks.simulate.hd_drawing import Drawing, DrawnLanelet
from flexmap_tasks.simulate.hd_furniture import put_fragments, put_furniture
from flexmap_tasks.simulate.lanes import LaneNetwork, Strip
from flexmap_tasks.simulate.slam import SlamTrack
from flexmap_tasks.simulate.world import World

FAKE_EPSG, FAKE_EASTING_M, FAKE_NORTHING_M = 32632, 600_000.0, 5_300_000.0
"""Where the drawing tool believes the SLAM frame to lie: the corner of MGRS square 32UPU."""
EASTING_LETTERS, NORTHING_LETTERS = "JKLMNPQR", "FGHJKLMNPQRSTUVABCDE"
SUBTYPES = {
    "bus": "bus_lane",
    "bicycle": "bicycle_lane",
    "shoulder": "road_shoulder",
    "crosswalk": "crosswalk",
}


@dataclass(frozen=True, slots=True, eq=False)
class HdMap:
    """The map and its truth.

    document : the Lanelet2 file; lanelets : in the order of their ids
    node_id : (n,); town_xyz_m : (n, 3) where each node really lies, annotation error included
    roads : drawn roads and the pieces of their line (first, last vertex of the trimmed line)
    """

    document: OsmDocument
    lanelets: tuple[DrawnLanelet, ...]
    node_id: Ints
    town_xyz_m: Floats
    roads: dict[int, list[Piece]]

    def fragment_length_m(self, lanelet: DrawnLanelet) -> float:
        """Length of the middle line of a lanelet that lies on no strip."""
        ways = self.document.ways
        bounds = []
        for way in (lanelet.left_way, lanelet.right_way):
            row = way - int(ways.id[0])
            rows = ways.ref[ways.offset[row] : ways.offset[row + 1]] - int(self.node_id[0])
            bounds.append(self.town_xyz_m[rows])
        return float(lines.along((bounds[0] + bounds[1]) / 2)[-1])


def draw_map(world: World, lanes: LaneNetwork, drive: Drive, slam: SlamTrack) -> HdMap:
    """Draw the lanelets of the roads that were driven, or of all."""
    roads, stubs = coverage(world, lanes, drive)
    drawing = Drawing(lanes.xyz)
    left_out = missing_lanes(world, lanes, drive)
    left_out |= {turn for k in left_out for turn in lanes.followers[k]}
    for k, strip in enumerate(lanes.strips):
        if strip.kind == "turn":
            if k not in left_out and lanes.followers[k][0] not in left_out and joins(lanes, strip, roads):
                _draw(drawing, lanes, k, strip, (0, len(strip.left) - 1), False)
        elif k not in left_out:
            for piece in roads.get(strip.road, ()):
                _draw(drawing, lanes, k, strip, piece, strip.road in stubs)
    put_furniture(drawing, lanes, roads)
    put_fragments(world, drawing, lanes, roads, stubs)
    return _finished(world, lanes, drawing, slam, roads)


def _draw(drawing: Drawing, lanes: LaneNetwork, k: int, strip: Strip, piece: Piece, stub: bool) -> None:
    """One lanelet over a part of a strip; pieces count along the road, so they turn with the lane."""
    n = len(strip.left)
    first, last = (
        piece if strip.direction > 0 or strip.kind == "turn" else (n - 1 - piece[1], n - 1 - piece[0])
    )
    ways = []
    for side, rows in (("left", strip.left), ("right", strip.right)):
        kind, subtype = _paint(lanes, strip, side)
        ways.append(drawing.line(rows[first : last + 1], kind, subtype))
    drawing.lanelets.append(DrawnLanelet(0, k, first, last, ways[0], ways[1], strip.kind, stub))


def _paint(lanes: LaneNetwork, strip: Strip, side: str) -> tuple[str, str]:
    """Type and subtype of a bound."""
    if strip.kind == "turn":
        return "virtual", ""
    inner = (side == "left") == (lanes.network.side > 0)
    road = lanes.network.roads[strip.road]
    count = road.forward if strip.direction > 0 else road.backward
    if strip.kind in ("bicycle", "shoulder"):
        return "line_thin", "solid"
    if inner:
        one_way_edge = strip.lane == 0 and road.backward == 0
        return "line_thin", "solid" if one_way_edge else "dashed"
    return "line_thin", "solid" if strip.lane == count - 1 else "dashed"


def _finished(
    world: World, lanes: LaneNetwork, drawing: Drawing, slam: SlamTrack, roads: dict[int, list[Piece]]
) -> HdMap:
    """Number everything, put it into the SLAM frame, and make the document."""
    every = np.vstack([drawing.base, *[p[None] for p in drawing.extra]])
    used, place = np.unique(np.concatenate(drawing.rows), return_inverse=True)
    n, w = len(used), len(drawing.rows)
    rng = stream(world.seed, "annotation")
    town = every[used] + rng.normal(0.0, 1.0, (n, 3)) * world.hd_map.annotation_sigma_m * np.array(
        [1.0, 1.0, 0.5]
    )
    local = np.round(slam.to_slam(town), 4)
    node_id = np.arange(1, n + 1, dtype=np.int64)
    split = np.cumsum([len(r) for r in drawing.rows])[:-1]
    draft = drawing.draft
    draft.way_refs = list(np.split(node_id[place], split))
    draft.way_ids = [n + i for i in draft.way_ids]
    rules = len(draft.relation_ids)
    draft.relation_ids = [n + w + 1 + i for i in draft.relation_ids]
    draft.members = [[(t, n + i, role) for t, i, role in m] for m in draft.members]
    lanelets = []
    for row, drawn in enumerate(drawing.lanelets):
        number = n + w + 1 + rules + row
        members = [("way", n + drawn.left_way, "left"), ("way", n + drawn.right_way, "right")]
        members += [
            ("relation", n + w + 1 + r, "regulatory_element") for r in drawing.regulatory.get(row, [])
        ]
        draft.relation(number, members, _lanelet_tags(world, drawn, lanes))
        lanelets.append(replace(drawn, id=number, left_way=n + drawn.left_way, right_way=n + drawn.right_way))
    document = _document(draft, node_id, local)
    return HdMap(document, tuple(lanelets), node_id, town, roads)


def _lanelet_tags(world: World, drawn: DrawnLanelet, lanes: LaneNetwork) -> dict[str, str]:
    tags = {
        "type": "lanelet",
        "subtype": SUBTYPES.get(drawn.kind, "road"),
        "speed_limit": str(world.hd_map.speed_limit_km_h),
        "location": "urban",
        "one_way": "no" if drawn.kind == "crosswalk" else "yes",
    }
    if drawn.kind == "turn":
        tags["turn_direction"] = lanes.strips[drawn.strip].turn
    if drawn.kind == "crosswalk":
        tags["participant:pedestrian"] = "yes"
    return tags


def _document(draft: DocumentDraft, node_id: Ints, local: Floats) -> OsmDocument:
    fake = np.array([FAKE_EASTING_M, FAKE_NORTHING_M]) + local[:, :2]
    lonlat = to_lonlat(fake, FAKE_EPSG)
    place = same_keys(
        {"lat": strings(map(repr, lonlat[:, 1].tolist())), "lon": strings(map(repr, lonlat[:, 0].tolist()))}
    )
    tags = same_keys({
        "mgrs_code": mgrs_codes(fake),
        "local_x": texts(local[:, 0], "%.4f"),
        "local_y": texts(local[:, 1], "%.4f"),
        "ele": texts(local[:, 2], "%.4f"),
    })  # fmt: skip
    meta = ('<MetaInfo format_version="1" map_version="1"/>',)
    return draft.finished({"generator": "VMB"}, node_id, lonlat, place, tags, other_xml=meta)


def mgrs_codes(utm_m: Floats) -> Strings:
    """(n,) MGRS to 100 m as the drawing tool writes it, for places (n, 2) near its square 32UPU."""
    east, north = np.floor(utm_m / 100.0).astype(np.int64).T
    return strings(
        f"32U{EASTING_LETTERS[e // 1000 - 1]}{NORTHING_LETTERS[n // 1000 % 20]}{e % 1000:03d}{n % 1000:03d}"
        for e, n in zip(east.tolist(), north.tolist(), strict=True)
    )
