"""Where OpenStreetMap puts the roads: displaced by a smooth field, jittered, thinned, moved, cut."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.chance import SmoothField, stream
from flexmap_tasks.simulate.osm_tags import road_tags, worsened
from flexmap_tasks.simulate.roads import Network
from flexmap_tasks.simulate.world import World

LEAST_SPLIT_M, LEAST_PARALLEL_M = 40.0, 60.0


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A part of one road as OSM draws it, before ways are made of parts.

    road : its number; twin : the other carriageway that the same line stands for, -1 without
    road_s : (k,) metres along the road (rising) of every vertex; twin_s : the same along the twin (falling)
    xy : (k, 2) drawn vertices; nodes : (k,) rows of the survey; tags : as written
    """

    road: int
    road_s: Floats
    xy: Floats
    nodes: Ints
    tags: dict[str, str]
    twin: int = -1
    twin_s: Floats = field(default_factory=lambda: np.empty(0))


class Survey:
    """Puts nodes of OSM, each displaced; rows count up."""

    def __init__(self, world: World) -> None:
        self._plan = world.osm
        self._field = SmoothField(stream(world.seed, "osm_field"), world.osm.field_length_m, 2)
        self._jitter = stream(world.seed, "osm_jitter")
        self._placed: list[Floats] = []
        self._count = 0

    def put(self, xy: Floats) -> tuple[Ints, Floats]:
        """Rows and displaced places of new nodes that truly lie at xy (n, 2)."""
        noise = self._jitter.normal(0.0, 1.0, xy.shape) * self._plan.jitter_sigma_m
        placed = xy + self._field(xy) * self._plan.field_sigma_m + noise
        self._placed.append(placed)
        self._count += len(xy)
        return np.arange(self._count - len(xy), self._count, dtype=np.int64), placed

    def xy(self) -> Floats:
        """(n, 2) places of all nodes."""
        return np.vstack(self._placed)


def missing_roads(world: World, network: Network) -> frozenset[int]:
    """Roads that OSM does not have; never one that others need, such as a part of a roundabout."""
    lot = stream(world.seed, "osm_missing").uniform(size=len(network.roads))
    plain = np.array(
        [r.role in ("", "cul_de_sac", "parking_aisle", "frontage", "slip") for r in network.roads]
    )
    return frozenset(np.flatnonzero((lot < world.osm.missing_share) & plain).tolist())


def survey_roads(world: World, network: Network, survey: Survey) -> list[Piece]:
    """Pieces of every road, missing ones too, in the order of the roads."""
    rows, placed = survey.put(network.node_xyz[:, :2])
    chance, tags_rng = stream(world.seed, "osm_ways"), stream(world.seed, "osm_tags")
    as_one = _dual_as_one(world, network)
    skip = set(as_one.values())
    out: list[Piece] = []
    for i, road in enumerate(network.roads):
        split, sign, move = chance.random(), float(chance.choice([-1.0, 1.0])), chance.random()
        if i in skip:
            continue
        moved = world.osm.moved_m * sign * (move < world.osm.moved_share)
        cut = split < world.osm.split_share and road.length_m > LEAST_SPLIT_M
        ends = (rows[[road.start, road.end]], placed[[road.start, road.end]])
        pieces = _road_pieces(world, network, survey, i, as_one.get(i, -1), moved, cut, ends)
        out += [
            Piece(p.road, p.road_s, p.xy, p.nodes, worsened(p.tags, world.osm, tags_rng), p.twin, p.twin_s)
            for p in pieces
        ]
    return out


def _dual_as_one(world: World, network: Network) -> dict[int, int]:
    """Carriageway -> its twin, for pairs that OSM draws as one line."""
    rng = stream(world.seed, "osm_dual")
    pairs: dict[int, list[int]] = {}
    for i, road in enumerate(network.roads):
        if road.role == "dual":
            pairs.setdefault(road.pair, []).append(i)
    return {
        p[0]: p[1]
        for _, p in sorted(pairs.items())
        if rng.random() < world.osm.dual_as_one_share and len(p) == 2
        and network.roads[p[0]].start == network.roads[p[1]].end
    }  # fmt: skip


def _road_pieces(
    world: World, network: Network, survey: Survey, i: int, twin: int, moved: float, cut: bool,
    ends: tuple[Ints, Floats],
) -> list[Piece]:  # fmt: skip
    """One road cut where its tags change or OSM splits it; vertices that OSM leaves out never become nodes."""
    road = network.roads[i]
    xy = road.xyz[:, :2] if twin < 0 else _middle_line(road.xyz, network.roads[twin].xyz)
    drawn_s = lines.along(xy)
    sections = road.sections()
    borders = sorted({0.0, 1.0, *(f / road.length_m for f, _, _ in sections), *([0.5] if cut else [])})
    share = np.unique(np.concatenate([drawn_s / drawn_s[-1], borders]))
    line = lines.at(xy, share * drawn_s[-1])
    if moved:
        line = lines.shifted(line, moved * np.sin(np.pi * share) ** 2)
    rows = _kept(line, np.searchsorted(share, borders), world.osm.thin_m)
    inner, inner_xy = survey.put(line[rows[1:-1]])
    nodes = np.concatenate([ends[0][:1], inner, ends[0][1:]])
    placed = np.vstack([ends[1][:1], inner_xy, ends[1][1:]])
    lanes = road.forward + road.backward + (network.roads[twin].forward if twin >= 0 else 0)
    out = []
    for a, b in pairwise(borders):
        part = np.flatnonzero((share[rows] >= a - 1e-12) & (share[rows] <= b + 1e-12))
        section = next(t for f, _, t in reversed(sections) if f <= a * road.length_m + 1e-9)
        s = share[rows][part]
        twin_s = (1.0 - s) * network.roads[twin].length_m if twin >= 0 else np.empty(0)
        out.append(
            Piece(
                i, s * road.length_m, placed[part], nodes[part], road_tags(road, section, lanes), twin, twin_s
            )
        )
    return out


def _middle_line(one: Floats, other: Floats) -> Floats:
    """Halfway between two carriageways that run against each other."""
    share = np.linspace(0.0, 1.0, len(one))
    back = other[::-1, :2]
    return np.asarray(
        (lines.at(one[:, :2], share * lines.along(one)[-1]) + lines.at(back, share * lines.along(back)[-1]))
        / 2
    )


def _kept(line: Floats, border_rows: Ints, thin_m: float) -> Ints:
    """Vertices that OSM keeps: ends, borders, and what the line's form needs."""
    keep = {0, len(line) - 1}
    for a, b in pairwise(border_rows.tolist()):
        keep |= {a + k for k in lines.thinned(line[a : b + 1], thin_m)}
    return np.array(sorted(keep), dtype=np.int64)


def other_lines(world: World, network: Network, survey: Survey) -> list[tuple[Ints, dict[str, str]]]:
    """Roads beside real ones that nobody ever built, and pavements that somebody did."""
    rng, out = stream(world.seed, "osm_invented"), []
    for road in network.roads:
        lot, side, gap = rng.random(), float(rng.choice([-1.0, 1.0])), float(rng.uniform(9.0, 14.0))
        if road.length_m < LEAST_PARALLEL_M or road.role:
            continue
        part = lines.cut(road.xyz[:, :2], 0.2 * road.length_m, 0.8 * road.length_m)
        if lot < world.osm.invented_share:
            line = lines.resample(lines.shifted(part, side * (road.width_m / 2 + gap)), 20.0)
            out.append((survey.put(line)[0], {"highway": "service", "name": "Planweg"}))
        if world.osm.footways and road.highway != "motorway":
            line = lines.resample(lines.shifted(part, -side * (road.width_m / 2 + 2.0)), 25.0)
            out.append((survey.put(line)[0], {"highway": "footway", "footway": "sidewalk"}))
    return out
