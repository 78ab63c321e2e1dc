"""OpenStreetMap's view of the town, and where every road lies in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.model.arrays import Floats, Ints, strings
from flexmap_tasks.model.osm import OsmDocument, Tags
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.chance import stream
from flexmap_tasks.simulate.document import DocumentDraft, same_keys, texts
from flexmap_tasks.simulate.frame import TownFrame
from flexmap_tasks.simulate.osm_changes import Change, Way, some_time_later
from flexmap_tasks.simulate.osm_survey import Piece, Survey, missing_roads, other_lines, survey_roads
from flexmap_tasks.simulate.osm_ways import join_pieces
from flexmap_tasks.simulate.roads import Network
from flexmap_tasks.simulate.world import World

FIRST_NODE, FIRST_WAY = 1_000_001, 500_001
STAMPS = {1: "2025-06-01T12:00:00Z", 2: "2026-05-01T12:00:00Z"}
"""When a version was made."""
COORDINATE_DIGITS = 7
"""As OpenStreetMap keeps them: 1.1 cm in latitude."""


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
    """One extract and its truth.

    parts : per road its parts in the order of road_s; tags : what every way says; length_m : of every way
    ways : all ways, present or not; changes : since the first date
    """

    document: OsmDocument
    parts: dict[int, list[RoadPart]]
    tags: dict[int, dict[str, str]]
    length_m: dict[int, float]
    ways: tuple[Way, ...]
    changes: tuple[Change, ...] = ()


def make_osm(world: World, network: Network, frame: TownFrame) -> tuple[OsmTown, OsmTown | None]:
    """The extract, and the one of the later date when it is asked for."""
    survey = Survey(world)
    pieces = survey_roads(world, network, survey)
    missing = missing_roads(world, network)
    there = [k for k, p in enumerate(pieces) if p.road not in missing]
    chains = join_pieces(pieces, there, world.osm.merge_share, stream(world.seed, "osm_merge"))
    unseen = [[(k, False)] for k, p in enumerate(pieces) if p.road in missing]
    ways = []
    for number, chain in enumerate([*chains, *unseen]):
        nodes = np.concatenate(
            [
                np.flip(pieces[k].nodes)[n > 0 :] if back else pieces[k].nodes[n > 0 :]
                for n, (k, back) in enumerate(chain)
            ]
        )
        ways.append(
            Way(FIRST_WAY + number, nodes, pieces[chain[0][0]].tags, chain, present=number < len(chains))
        )
    for nodes, tags in other_lines(world, network, survey):
        ways.append(Way(FIRST_WAY + len(ways), nodes, tags, []))
    xy = survey.xy()
    first = np.ones(len(xy), dtype=np.int64)
    today = _town(frame, network, pieces, ways, xy, first, [])
    if not world.osm.later_date:
        return today, None
    later, moved, changes = some_time_later(world, ways, xy)
    version = first + (moved != xy).any(axis=1)
    return today, _town(frame, network, pieces, later, moved, version, changes)


def _town(
    frame: TownFrame, network: Network, pieces: list[Piece], ways: list[Way], xy: Floats, version: Ints,
    changes: list[Change],
) -> OsmTown:  # fmt: skip
    """The document, and where every road lies in it, measured on the coordinates as written."""
    lonlat = np.round(frame.geodetic(np.column_stack([xy, np.zeros(len(xy))]))[:, :2], COORDINATE_DIGITS)
    xy = frame.local(lonlat)
    parts: dict[int, list[RoadPart]] = {}
    length: dict[int, float] = {}
    there = [w for w in ways if w.present]
    for way in there:
        way_s = lines.along(xy[way.nodes])
        length[way.id] = float(way_s[-1])
        first = 0
        for k, back in way.chain:
            last = first + len(pieces[k].nodes) - 1
            s = way_s[first : last + 1]
            _place(parts, pieces[k], way.id, s[::-1] if back else s, -1 if back else 1)
            first = last
    for found in parts.values():
        found.sort(key=lambda p: float(p.road_s[0]))
    tags = {w.id: w.tags for w in there}
    return OsmTown(
        _document(there, lonlat, version, network), parts, tags, length, tuple(ways), tuple(changes)
    )


def _place(
    parts: dict[int, list[RoadPart]], piece: Piece, way_id: int, way_s: Floats, direction: int
) -> None:
    parts.setdefault(piece.road, []).append(RoadPart(piece.road, way_id, piece.road_s, way_s, direction))
    if piece.twin >= 0:
        twin = RoadPart(piece.twin, way_id, piece.twin_s[::-1], way_s[::-1], -direction)
        parts.setdefault(piece.twin, []).append(twin)


def _document(ways: list[Way], lonlat: Floats, version: Ints, network: Network) -> OsmDocument:
    draft = DocumentDraft()
    for way in ways:
        draft.way(way.id, FIRST_NODE + way.nodes, way.tags)
    used: Ints = np.unique(np.concatenate([w.nodes for w in ways]))
    place = lonlat[used]
    form = f"%.{COORDINATE_DIGITS}f"
    origin = {v: _origin(v) for v in STAMPS}
    attributes = same_keys(
        {k: strings(origin[v][k] for v in version[used].tolist()) for k in origin[1]}
        | {"lat": texts(place[:, 1], form), "lon": texts(place[:, 0], form)}
    )
    signals = Tags.of(
        {"highway": "traffic_signals"} if k in network.signal_nodes else {} for k in used.tolist()
    )
    low, high = place.min(axis=0), place.max(axis=0)
    box = dict(zip(("minlat", "minlon", "maxlat", "maxlon"), (low[1], low[0], high[1], high[0]), strict=True))
    bounds = "<bounds " + " ".join(f'{k}="{v:.7f}"' for k, v in box.items()) + "/>"
    return draft.finished(
        {"version": "0.6", "generator": "simulate"}, FIRST_NODE + used, place, attributes, signals,
        {w.id: origin[w.version] for w in ways}, (bounds,),
    )  # fmt: skip


def _origin(version: int) -> dict[str, str]:
    return {"version": str(version), "timestamp": STAMPS[version], "changeset": str(version), "uid": "1",
            "user": "simulate"}  # fmt: skip
