"""OpenStreetMap's view of the town: displaced, thinned, split, merged, and sometimes wrong."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.osm import OsmDocument, Tags
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.chance import SmoothField, stream
from flexmap_tasks.simulate.document import DocumentDraft, same_keys, texts
from flexmap_tasks.simulate.frame import TownFrame
from flexmap_tasks.simulate.roads import Network, Road
from flexmap_tasks.simulate.world import World

FIRST_NODE, FIRST_WAY = 1_000_001, 500_001
STAMP = "2025-06-01T12:00:00Z"
SURFACES = ("asphalt", "paving_stones", "cobblestone", "gravel")
NARROW_TURN = 0.7


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A part of one road as OSM draws it, before ways are made of parts.

    road : its number, -1 where there is none; twin : the other carriageway that the same line stands for
    road_s : (k,) metres along the road (rising) of every vertex; twin_s : the same along the twin (falling)
    xy : (k, 2) drawn vertices; nodes : (k,) OSM node numbers; tags : as written
    """

    road: int
    road_s: Floats
    xy: Floats
    nodes: Ints
    tags: dict[str, str]
    twin: int = -1
    twin_s: Floats = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True, slots=True, eq=False)
class RoadPart:
    """Where a stretch of a road lies in OSM: the truth of matching.

    road_s : (k,) metres along the road, rising; way_s : (k,) metres along the way at the same places
    direction : +1 where the way runs along the road's line, -1 against it
    """

    road: int
    way_id: int
    road_s: Floats
    way_s: Floats
    direction: int


@dataclass(frozen=True, slots=True, eq=False)
class OsmTown:
    """The extract and its truth.

    parts : per road its parts in the order of road_s; tags : what every way says
    missing : roads that OSM does not have; invented : ways that stand for nothing
    """

    document: OsmDocument
    parts: dict[int, list[RoadPart]]
    tags: dict[int, dict[str, str]]
    missing: frozenset[int]
    invented: frozenset[int]


@dataclass(slots=True)
class _Survey:
    """Where OSM puts its nodes."""

    world: World
    displace: SmoothField
    jitter: np.random.Generator
    xy: list[Floats] = field(default_factory=list)

    def put(self, xy: Floats) -> Ints:
        """New nodes for places of the town, displaced."""
        plan = self.world.osm
        moved = xy + self.displace(xy) * plan.field_sigma_m + self.jitter.normal(0, 1, xy.shape) * plan.jitter_sigma_m
        first = len(self.xy)
        self.xy.extend(moved)
        return np.arange(first, first + len(xy), dtype=np.int64)


def make_osm(world: World, network: Network, frame: TownFrame) -> OsmTown:
    """The extract of today."""
    survey = _Survey(world, SmoothField(stream(world.seed, "osm_field"), world.osm.field_length_m, 2),
                     stream(world.seed, "osm_jitter"))  # fmt: skip
    junction = survey.put(network.node_xyz[:, :2])
    missing = _missing(world, network)
    pieces = _pieces(world, network, survey, junction, missing)
    chains = _chains(world, pieces)
    invented = _invented(world, network, survey)
    return _written(world, network, frame, survey, pieces, chains, invented, missing)


def road_tags(road: Road, section: dict[str, str]) -> dict[str, str]:
    """What a careful mapper would write about a stretch of road."""
    tags = {"highway": road.highway}
    if road.role == "parking_aisle":
        tags["service"] = "parking_aisle"
    if road.role == "roundabout":
        tags["junction"] = "roundabout"
    tags |= {k: v for k, v in section.items() if v}
    tags["lanes"] = str(road.forward + road.backward)
    if road.backward == 0:
        tags["oneway"] = "yes"
    if road.level:
        tags |= {"bridge": "yes", "layer": str(road.level)}
    if road.bicycle:
        tags["cycleway:right" if road.backward == 0 else "cycleway:both"] = "lane"
    if road.bus:
        tags["bus:lanes"] = "|".join(["yes"] * (road.forward - 1) + ["designated"])
    return tags


def _missing(world: World, network: Network) -> frozenset[int]:
    rng = stream(world.seed, "osm_missing")
    lot = rng.uniform(size=len(network.roads))
    plain = [r.role in ("", "cul_de_sac", "parking_aisle", "frontage", "slip") for r in network.roads]
    return frozenset(np.flatnonzero((lot < world.osm.missing_share) & np.array(plain, dtype=bool)).tolist())


def _pieces(
    world: World, network: Network, survey: _Survey, junction: Ints, missing: frozenset[int]
) -> list[Piece]:
    """Every road cut where its tags change or OSM splits it."""
    rng = stream(world.seed, "osm_ways")
    moves = stream(world.seed, "osm_moved")
    lone = stream(world.seed, "osm_dual")
    as_one: dict[int, int] = {}
    for i, road in enumerate(network.roads):
        if road.role == "dual" and lone.random() < world.osm.dual_as_one_share:
            twin = next((j for j, r in enumerate(network.roads) if r.pair == road.pair and j > i), None)
            if twin is not None:
                as_one[i] = twin
    skip = set(as_one.values()) | missing
    out: list[Piece] = []
    for i, road in enumerate(network.roads):
        chance = rng.uniform(size=2)
        moved = world.osm.moved_m * float(moves.choice([-1.0, 1.0])) * (moves.random() < world.osm.moved_share)
        if i in skip:
            continue
        twin = as_one.get(i, -1)
        xy = road.xyz[:, :2]
        if twin >= 0:
            other = network.roads[twin].xyz[::-1, :2]
            share = np.linspace(0.0, 1.0, len(xy))
            xy = (lines.at(xy, share * road.length_m) + lines.at(other, share * lines.along(other)[-1])) / 2
        cuts = [0.5] if chance[0] < world.osm.split_share and road.length_m > 40.0 else []
        out += _road_pieces(world, network, survey, junction, i, xy, twin, moved, cuts)
    return _with_wrong_tags(world, out)


def _road_pieces(
    world: World, network: Network, survey: _Survey, junction: Ints, i: int, xy: Floats, twin: int,
    moved: float, cuts: list[float],
) -> list[Piece]:  # fmt: skip
    """Pieces of one road from junction to junction; vertices OSM leaves out never become nodes."""
    road = network.roads[i]
    share = lines.along(xy) / lines.along(xy)[-1]
    sections = road.sections()
    borders = sorted({0.0, 1.0, *(f / road.length_m for f, _, _ in sections), *cuts})
    every = np.unique(np.concatenate([share, borders]))
    points = lines.at(xy, every * lines.along(xy)[-1])
    bow = moved * np.sin(np.pi * every) ** 2
    drawn = lines.shifted(points, bow) if moved else points
    keep = {0, len(every) - 1}
    border_rows = np.searchsorted(every, borders)
    for a, b in zip(border_rows, border_rows[1:], strict=False):
        keep |= {int(a) + k for k in lines.thinned(drawn[a : b + 1], world.osm.thin_m)}
    rows = np.array(sorted(keep), dtype=np.int64)
    nodes = np.concatenate([[junction[road.start]], survey.put(drawn[rows[1:-1]]), [junction[road.end]]])
    placed = np.array([survey.xy[n] for n in nodes])
    out = []
    for a, b in zip(borders, borders[1:], strict=False):
        part = np.flatnonzero((every[rows] >= a - 1e-12) & (every[rows] <= b + 1e-12))
        section = next(t for f, to, t in reversed(sections) if f <= a * road.length_m + 1e-9)
        tags = road_tags(road, section)
        if twin >= 0:
            lanes = road.forward + network.roads[twin].forward
            tags = {k: v for k, v in tags.items() if k != "oneway"} | {"lanes": str(lanes)}
        s = every[rows][part]
        twin_s = (1.0 - s) * network.roads[twin].length_m if twin >= 0 else np.empty(0)
        out.append(Piece(i, s * road.length_m, placed[part], nodes[part], tags, twin, twin_s))
    return out


def _with_wrong_tags(world: World, pieces: list[Piece]) -> list[Piece]:
    """Some tags left out, some values false."""
    plan, rng = world.osm, stream(world.seed, "osm_tags")
    for piece in pieces:
        for key in ("maxspeed", "name", "surface", "lanes"):
            omitted, false = rng.uniform(size=2) < (plan.omit_share, plan.wrong_share)
            pick = int(rng.integers(0, 1000))
            if key not in piece.tags:
                continue
            if omitted:
                del piece.tags[key]
            elif false and key != "name":
                piece.tags[key] = _false_value(key, piece.tags[key], pick)
    return pieces


def _false_value(key: str, value: str, pick: int) -> str:
    if key == "surface":
        others = [s for s in SURFACES if s != value]
        return others[pick % len(others)]
    if key == "lanes":
        return str(int(value) + (1 if pick % 2 or int(value) == 1 else -1))
    others = [v for v in ("20", "30", "50", "70", "100") if v != value]
    return others[pick % len(others)]


Link = tuple[int, bool]
"""(piece, reversed)"""


def _chains(world: World, pieces: list[Piece]) -> list[list[Link]]:
    """Pieces that become one way: same tags, meeting without a corner."""
    rng = stream(world.seed, "osm_merge")
    ends: dict[int, list[tuple[int, bool]]] = {}
    for k, piece in enumerate(pieces):
        ends.setdefault(int(piece.nodes[0]), []).append((k, False))
        ends.setdefault(int(piece.nodes[-1]), []).append((k, True))
    joined: dict[tuple[int, bool], tuple[int, bool]] = {}
    for node in sorted(ends):
        wanted = rng.random() < world.osm.merge_share
        pair = _straight_pair(pieces, [e for e in ends[node] if e not in joined])
        if wanted and pair:
            joined[pair[0]], joined[pair[1]] = pair[1], pair[0]
    return _walked(pieces, joined)


def _straight_pair(pieces: list[Piece], ends: list[tuple[int, bool]]) -> tuple[tuple[int, bool], tuple[int, bool]] | None:
    """The two ends at a node that run straightest into each other and may be one way."""
    best, found = NARROW_TURN, None
    for n, a in enumerate(ends):
        for b in ends[n + 1 :]:
            first, second = pieces[a[0]], pieces[b[0]]
            one_way = "oneway" in first.tags
            if a[0] == b[0] or first.tags != second.tags or (one_way and a[1] == b[1]):
                continue
            if first.twin >= 0 or second.twin >= 0 or first.tags.get("junction"):
                continue
            turn = float(np.arccos(np.clip(-_outward(first, a[1]) @ _outward(second, b[1]), -1, 1)))
            if turn < best:
                best, found = turn, (a, b)
    return found


def _outward(piece: Piece, at_end: bool) -> Floats:
    xy = piece.xy[::-1] if at_end else piece.xy
    step = xy[1] - xy[0]
    return np.asarray(step / max(float(np.hypot(*step)), 1e-9))


def _walked(pieces: list[Piece], joined: dict[tuple[int, bool], tuple[int, bool]]) -> list[list[Link]]:
    """Chains in the order of their first piece; no chain comes back to a node it has."""
    chains: list[list[Link]] = []
    seen: set[int] = set()
    for k in range(len(pieces)):
        if k in seen:
            continue
        here: tuple[int, bool] = (k, False)
        trail = {k}
        while here in joined and joined[here][0] not in trail:
            other = joined[here]
            here = (other[0], not other[1])
            trail.add(other[0])
        chain, first = [], here
        forward = (first[0], first[1])
        nodes: set[int] = set()
        while True:
            chain.append(forward)
            seen.add(forward[0])
            nodes |= set(pieces[forward[0]].nodes.tolist())
            tail = (forward[0], not forward[1])
            after = joined.get(tail)
            if after is None or after[0] in seen:
                break
            far = pieces[after[0]].nodes[0 if after[1] else -1]
            if int(far) in nodes:
                break
            forward = after
        if "oneway" in pieces[chain[0][0]].tags and chain[0][1]:
            chain = [(n, False) for n, _ in reversed(chain)]
        chains.append(chain)
    return chains


def _invented(world: World, network: Network, survey: _Survey) -> list[tuple[Ints, dict[str, str]]]:
    """Roads beside real ones that nobody ever built, and footways that somebody did."""
    rng, out = stream(world.seed, "osm_invented"), []
    for road in network.roads:
        lot, side, gap = rng.random(), float(rng.choice([-1.0, 1.0])), float(rng.uniform(9.0, 14.0))
        if road.length_m < 60.0 or road.role:
            continue
        part = lines.cut(road.xyz[:, :2], 0.2 * road.length_m, 0.8 * road.length_m)
        if lot < world.osm.invented_share:
            line = lines.resample(lines.shifted(part, side * (road.width_m / 2 + gap)), 20.0)
            out.append((survey.put(line), {"highway": "service", "name": "Planweg"}))
        if world.osm.footways and road.highway != "motorway":
            line = lines.resample(lines.shifted(part, -side * (road.width_m / 2 + 2.0)), 25.0)
            out.append((survey.put(line), {"highway": "footway", "footway": "sidewalk"}))
    return out


def _written(
    world: World, network: Network, frame: TownFrame, survey: _Survey, pieces: list[Piece],
    chains: list[list[Link]], invented: list[tuple[Ints, dict[str, str]]], missing: frozenset[int],
) -> OsmTown:  # fmt: skip
    """The document, and where every road lies in it, measured on the coordinates as written."""
    xy = np.array(survey.xy)
    lonlat = np.round(frame.geodetic(np.column_stack([xy, np.zeros(len(xy))]))[:, :2], 7)
    xy = frame.local(lonlat)
    draft, parts, tags = DocumentDraft(), dict[int, list[RoadPart]](), dict[int, dict[str, str]]()
    for number, chain in enumerate(chains):
        way_id = FIRST_WAY + number
        refs: list[int] = []
        s0 = 0.0
        for k, flipped in chain:
            piece = pieces[k]
            nodes = piece.nodes[::-1] if flipped else piece.nodes
            refs += nodes[1 if refs else 0 :].tolist()
            way_s = s0 + lines.along(xy[nodes])
            s0 = float(way_s[-1])
            way_s = way_s[::-1] if flipped else way_s
            _place(parts, piece, way_id, way_s, -1 if flipped else 1)
        tags[way_id] = pieces[chain[0][0]].tags
        draft.way(way_id, [FIRST_NODE + r for r in refs], tags[way_id])
    phantom = set()
    for number, (nodes, line_tags) in enumerate(invented):
        way_id = FIRST_WAY + len(chains) + number
        draft.way(way_id, (FIRST_NODE + nodes).tolist(), line_tags)
        if line_tags["highway"] != "footway":
            phantom.add(way_id)
    used = np.unique(np.concatenate([np.asarray(r, dtype=np.int64) for r in draft.way_refs])) - FIRST_NODE
    document = _document(draft, used, lonlat, network)
    for found in parts.values():
        found.sort(key=lambda p: float(p.road_s[0]))
    return OsmTown(document, parts, tags, missing, frozenset(phantom))


def _place(parts: dict[int, list[RoadPart]], piece: Piece, way_id: int, way_s: Floats, direction: int) -> None:
    parts.setdefault(piece.road, []).append(RoadPart(piece.road, way_id, piece.road_s, way_s, direction))
    if piece.twin >= 0:
        parts.setdefault(piece.twin, []).append(
            RoadPart(piece.twin, way_id, piece.twin_s[::-1], way_s[::-1], -direction)
        )


def _document(draft: DocumentDraft, used: Ints, lonlat: Floats, network: Network) -> OsmDocument:
    node_id = FIRST_NODE + used
    n = len(used)
    place = lonlat[used]
    columns = {"version": "1", "timestamp": STAMP, "changeset": "1", "uid": "1", "user": "simulate"}
    attributes = same_keys(
        {k: np.full(n, v, dtype=object) for k, v in columns.items()}
        | {"lat": texts(place[:, 1], "%.7f"), "lon": texts(place[:, 0], "%.7f")}
    )
    signals = {int(k) for k in network.signal_nodes}
    tags = Tags.of({"highway": "traffic_signals"} if k in signals else {} for k in used.tolist())
    low, high = place.min(axis=0), place.max(axis=0)
    bounds = f'<bounds minlat="{low[1]:.7f}" minlon="{low[0]:.7f}" maxlat="{high[1]:.7f}" maxlon="{high[0]:.7f}"/>'
    return draft.finished(
        {"version": "0.6", "generator": "simulate"}, node_id, place, attributes, tags,
        dict.fromkeys(draft.way_ids, columns), (bounds,),
    )  # fmt: skip
