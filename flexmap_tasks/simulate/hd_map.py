"""The Lanelet2 map as a person would draw it over the SLAM cloud with VectorMapBuilder."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from flexmap_tasks.geometry.utm import to_lonlat
from flexmap_tasks.model.arrays import Floats, Ints, Strings, strings
from flexmap_tasks.model.osm import OsmDocument
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.chance import stream
from flexmap_tasks.simulate.document import DocumentDraft, same_keys, texts
from flexmap_tasks.simulate.drive import Drive
from flexmap_tasks.simulate.lanes import LaneNetwork, Strip
from flexmap_tasks.simulate.slam import SlamTrack
from flexmap_tasks.simulate.world import World

FAKE_EPSG, FAKE_EASTING_M, FAKE_NORTHING_M = 32632, 600_000.0, 5_300_000.0
"""Where the drawing tool believes the SLAM frame to lie: the corner of MGRS square 32UPU."""
EASTING_LETTERS, NORTHING_LETTERS = "JKLMNPQR", "FGHJKLMNPQRSTUVABCDE"
FRAGMENT_M = 8.0
Piece = tuple[int, int]


@dataclass(frozen=True, slots=True)
class DrawnLanelet:
    """One lanelet of the map.

    id : relation id; strip : row in the lane network, -1 for what lies on no strip
    first, last : the strip's point pairs it covers, both included
    left_way, right_way : way ids; kind : the strip's kind, "crosswalk" or "fragment"
    stub : it belongs to a side road that was drawn for a few metres only
    """

    id: int
    strip: int
    first: int
    last: int
    left_way: int
    right_way: int
    kind: str
    stub: bool


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


@dataclass(slots=True)
class _Drawing:
    """Points and lines as they are put down; ids run through nodes, ways and relations."""

    base: Floats
    extra: list[Floats] = field(default_factory=list)
    used: dict[int, int] = field(default_factory=dict)
    ways: dict[bytes, int] = field(default_factory=dict)
    draft: DocumentDraft = field(default_factory=DocumentDraft)
    lanelets: list[DrawnLanelet] = field(default_factory=list)
    regulatory: dict[int, list[int]] = field(default_factory=dict)
    rows: list[Ints] = field(default_factory=list)
    next_way: int = 0

    def point(self, xyz: Floats) -> int:
        """A point of its own; its row follows those of the lane network."""
        self.extra.append(xyz)
        return len(self.base) + len(self.extra) - 1

    def line(self, rows: Ints, kind: str, subtype: str) -> int:
        """Way over these points, shared by all who ask for the same ones in either direction."""
        rows = rows if rows[0] <= rows[-1] else rows[::-1]
        key = rows.tobytes()
        if key not in self.ways:
            self.next_way += 1
            self.ways[key] = self.next_way
            tags = {"type": kind, "subtype": subtype} if subtype else {"type": kind}
            self.draft.way(self.next_way, [], tags)
            self.rows.append(np.ascontiguousarray(rows))
        return self.ways[key]


def draw_map(world: World, lanes: LaneNetwork, drive: Drive, slam: SlamTrack) -> HdMap:
    """Draw the lanelets of the roads that were driven, or of all."""
    roads, stubs = _coverage(world, lanes, drive)
    drawing = _Drawing(lanes.xyz)
    left_out = _missing_lanes(world, lanes, drive)
    for k, strip in enumerate(lanes.strips):
        if k in left_out:
            continue
        if strip.kind == "turn":
            if _joins(lanes, strip, roads) and not (lanes.followers[k][0] in left_out or _comes_from(lanes, k, left_out)):
                _draw(drawing, lanes, k, strip, (0, len(strip.left) - 1), False)
        elif strip.road in roads:
            for piece in roads[strip.road]:
                _draw(drawing, lanes, k, strip, piece, strip.road in stubs)
    _furniture(world, drawing, lanes, roads)
    _fragments(world, drawing, lanes, roads, stubs)
    return _finished(world, lanes, drawing, slam, roads)


def _coverage(world: World, lanes: LaneNetwork, drive: Drive) -> tuple[dict[int, list[Piece]], set[int]]:
    """Pieces of every drawn road, and which roads are stubs."""
    rng = stream(world.seed, "coverage")
    plan, network = world.hd_map, lanes.network
    size = {s.road: len(s.left) for s in lanes.strips if s.kind != "turn"}
    if plan.coverage == "all":
        full = set(size)
    else:
        strips = [lanes.strips[k] for k in drive.strips]
        full = {s.road for s in strips} | {s.to_road for s in strips[:-1] if s.to_road >= 0}
    pieces = {i: _cuts(rng, size[i], plan.cut_share) for i in sorted(full)}
    stubs: set[int] = set()
    near = {n for i in full for n in (network.roads[i].start, network.roads[i].end)}
    for i, road in enumerate(network.roads):
        if i in full or i not in size or rng.random() >= plan.stub_share:
            continue
        ends = [e for e, node in ((False, road.start), (True, road.end)) if node in near]
        if not ends:
            continue
        step = _line_step(lanes, i, size[i])
        reach = max(1, int(np.ceil(float(rng.uniform(plan.stub_min_m, plan.stub_max_m)) / step)))
        if reach * (len(ends) + 1) >= size[i] - 1:
            ends = ends[:1]
        reach = min(reach, size[i] - 1)
        pieces[i] = [(size[i] - 1 - reach, size[i] - 1) if end else (0, reach) for end in ends]
        stubs.add(i)
    return pieces, stubs


def _line_step(lanes: LaneNetwork, road: int, size: int) -> float:
    trims = lanes.trims
    length = lanes.network.roads[road].length_m - trims[road, False] - trims[road, True]
    return max(length / max(size - 1, 1), 0.1)


def _cuts(rng: np.random.Generator, size: int, share: float) -> list[Piece]:
    """The whole line, or two or three parts of it that meet in a vertex."""
    if size < 5 or rng.random() >= share:
        return [(0, size - 1)]
    count = min(int(rng.integers(1, 3)), size - 3)
    at = np.sort(rng.choice(np.arange(1, size - 1), count, replace=False))
    edges = [0, *at.tolist(), size - 1]
    return list(zip(edges, edges[1:], strict=False))


def _missing_lanes(world: World, lanes: LaneNetwork, drive: Drive) -> set[int]:
    """Outer lanes that the annotator forgot, never one that was driven."""
    share = world.hd_map.missing_lane_share
    if share == 0:
        return set()
    rng, driven = stream(world.seed, "missing_lanes"), set(drive.strips)
    return {
        k
        for k, s in enumerate(lanes.strips)
        if s.kind == "lane" and s.lane > 0 and rng.random() < share and k not in driven
    }


def _comes_from(lanes: LaneNetwork, turn: int, left_out: set[int]) -> bool:
    return any(turn in lanes.followers[k] for k in left_out)


def _joins(lanes: LaneNetwork, turn: Strip, roads: dict[int, list[Piece]]) -> bool:
    """Whether both roads of a turn are drawn at its junction."""
    for road, at_end in ((turn.road, turn.direction > 0), (turn.to_road, turn.to_direction < 0)):
        if road not in roads:
            return False
        size = next(len(s.left) for s in _strips_of(lanes, road))
        if not any((last == size - 1) if at_end else (first == 0) for first, last in roads[road]):
            return False
    return True


def _strips_of(lanes: LaneNetwork, road: int) -> list[Strip]:
    return [lanes.strips[k] for k in lanes.road_strips[road]]


def _draw(drawing: _Drawing, lanes: LaneNetwork, k: int, strip: Strip, piece: Piece, stub: bool) -> None:
    """One lanelet over a part of a strip; pieces count along the road, so they turn with the lane."""
    n = len(strip.left)
    first, last = piece if strip.direction > 0 or strip.kind == "turn" else (n - 1 - piece[1], n - 1 - piece[0])
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


def _furniture(world: World, drawing: _Drawing, lanes: LaneNetwork, roads: dict[int, list[Piece]]) -> None:
    """Stop lines with lights or signs on the approaches, and crosswalks."""
    network, arms = lanes.network, lanes.network.arms()
    by_strip: dict[int, list[int]] = {}
    for row, lanelet in enumerate(drawing.lanelets):
        by_strip.setdefault(lanelet.strip, []).append(row)
    for node in sorted(network.signal_nodes | network.stop_nodes | network.crosswalk_nodes):
        for road, at_end in arms[node]:
            if road not in roads:
                continue
            ahead = [
                (k, row)
                for k in lanes.road_strips[road]
                if lanes.strips[k].drivable and (lanes.strips[k].direction > 0) == at_end
                for row in by_strip.get(k, [])
                if drawing.lanelets[row].last == len(lanes.strips[k].left) - 1
            ]
            if ahead and node in network.signal_nodes | network.stop_nodes:
                _stop_line(drawing, lanes, ahead, node in network.signal_nodes)
            if node in network.crosswalk_nodes:
                _crosswalk(drawing, lanes, road, at_end, roads[road])


def _stop_line(drawing: _Drawing, lanes: LaneNetwork, ahead: list[tuple[int, int]], light: bool) -> None:
    """A stop line across the lanes, the light or sign behind it, and the rule that joins them."""
    ends = []
    for side in ("left", "right"):
        outer = [lanes.xyz[getattr(lanes.strips[k], side)[-2:]] for k, _ in ahead]
        ends.append([p[1] + (p[0] - p[1]) * min(0.5, 0.6 / max(float(np.hypot(*(p[0] - p[1])[:2])), 0.1)) for p in outer])
    across = np.array(ends[0] + ends[1])
    spread = np.hypot(*(across[:, None] - across[None])[..., :2].transpose(2, 0, 1))
    i, j = np.unravel_index(int(np.argmax(spread)), spread.shape)
    rows = np.array([drawing.point(across[i]), drawing.point(across[j])])
    stop = drawing.line(rows, "stop_line", "solid")
    strip = lanes.strips[ahead[0][0]]
    way = lines.tangents(lanes.xyz[strip.left[-2:]])[-1]
    far = np.array([*(way * (14.0 if light else -0.3)), 5.0 if light else 2.2])
    middle, span = (across[i] + across[j]) / 2 + far, (across[j] - across[i]) / np.maximum(spread[i, j], 0.1)
    board = np.array([drawing.point(middle - span * 0.4), drawing.point(middle + span * 0.4)])
    sign = drawing.line(board, *(("traffic_light", "red_yellow_green") if light else ("traffic_sign", "stop_sign")))
    rule = len(drawing.draft.relation_ids)
    members = [("way", sign, "refers"), ("way", stop, "ref_line")]
    subtype = "traffic_light" if light else "traffic_sign"
    drawing.draft.relation(rule, members, {"type": "regulatory_element", "subtype": subtype})
    for _, row in ahead:
        drawing.regulatory.setdefault(row, []).append(rule)


def _crosswalk(drawing: _Drawing, lanes: LaneNetwork, road: int, at_end: bool, pieces: list[Piece]) -> None:
    """A crossing of 3 m over the whole road, 2 m before the junction begins."""
    line = lanes.network.roads[road]
    trim = lanes.trims[road, at_end]
    if line.length_m < trim + 20.0:
        return
    here = np.array([line.length_m - trim - 2.0, line.length_m - trim - 5.0] if at_end else [trim + 5.0, trim + 2.0])
    middle = lines.at(line.xyz, here)
    way = middle[0] - middle[1]
    normal = np.array([-way[1], way[0], 0.0]) / np.hypot(*way[:2]) * (line.width_m / 2 + 0.5)
    bounds = [np.array([drawing.point(m + normal), drawing.point(m - normal)]) for m in middle]
    left, right = (drawing.line(b, "pedestrian_marking", "") for b in bounds)
    drawing.lanelets.append(DrawnLanelet(0, -1, 0, 1, left, right, "crosswalk", False))


def _fragments(
    world: World, drawing: _Drawing, lanes: LaneNetwork, roads: dict[int, list[Piece]], stubs: set[int]
) -> None:
    """Pieces of lane beside the road's edge that lead nowhere and stand for nothing."""
    rng = stream(world.seed, "fragments")
    for road in roads:
        line = lanes.network.roads[road]
        if rng.random() >= world.hd_map.fragment_share or road in stubs or line.length_m < 50:
            continue
        s = float(rng.uniform(20.0, line.length_m - 20.0 - FRAGMENT_M))
        part = lines.resample(lines.cut(line.xyz, s, s + FRAGMENT_M), 4.0)
        edge = -(line.width_m / 2 + 0.4)
        both = [lines.shifted(part, lanes.network.side * o) for o in (edge, edge - line.lane_width_m)]
        if lanes.network.side < 0:
            both.reverse()
        ways = [
            drawing.line(np.array([drawing.point(p) for p in b]), "line_thin", "solid") for b in both
        ]
        drawing.lanelets.append(DrawnLanelet(0, -1, 0, len(part) - 1, ways[0], ways[1], "fragment", False))


def _finished(
    world: World, lanes: LaneNetwork, drawing: _Drawing, slam: SlamTrack, roads: dict[int, list[Piece]]
) -> HdMap:
    """Number everything, put it into the SLAM frame, and make the document."""
    every = np.vstack([drawing.base, *[p[None] for p in drawing.extra]])
    used, place = np.unique(np.concatenate(drawing.rows), return_inverse=True)
    n, w = len(used), len(drawing.rows)
    rng = stream(world.seed, "annotation")
    town = every[used] + rng.normal(0.0, 1.0, (n, 3)) * world.hd_map.annotation_sigma_m * np.array([1.0, 1.0, 0.5])
    local = np.round(slam.to_slam(town), 4)
    node_id = np.arange(1, n + 1, dtype=np.int64)
    split = np.cumsum([len(r) for r in drawing.rows])[:-1]
    draft = drawing.draft
    draft.way_refs = [node_id[p] for p in np.split(place, split)]
    draft.way_ids = [n + i for i in draft.way_ids]
    rules = len(draft.relation_ids)
    draft.relation_ids = [n + w + 1 + i for i in draft.relation_ids]
    draft.members = [[(t, n + i, role) for t, i, role in m] for m in draft.members]
    lanelets = []
    for row, drawn in enumerate(drawing.lanelets):
        number = n + w + 1 + rules + row
        members = [("way", n + drawn.left_way, "left"), ("way", n + drawn.right_way, "right")]
        members += [("relation", n + w + 1 + r, "regulatory_element") for r in drawing.regulatory.get(row, [])]
        draft.relation(number, members, _lanelet_tags(world, drawn, lanes))
        lanelets.append(
            DrawnLanelet(number, drawn.strip, drawn.first, drawn.last, n + drawn.left_way, n + drawn.right_way,
                         drawn.kind, drawn.stub)
        )  # fmt: skip
    document = _document(draft, node_id, local)
    return HdMap(document, tuple(lanelets), node_id, town, roads)


SUBTYPES = {"bus": "bus_lane", "bicycle": "bicycle_lane", "shoulder": "road_shoulder", "crosswalk": "crosswalk"}


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
    place = same_keys({"lat": strings(map(repr, lonlat[:, 1].tolist())), "lon": strings(map(repr, lonlat[:, 0].tolist()))})
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
