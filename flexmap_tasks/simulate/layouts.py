"""Plans of towns: grid, radial, organic, motorway."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.spatial import Delaunay

from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.roads import Draft, Road
from flexmap_tasks.simulate.world import NetworkSettings

STREETS = (
    "Linden",
    "Birken",
    "Garten",
    "Schul",
    "Bahnhof",
    "Wiesen",
    "Kirch",
    "Berg",
    "Mühl",
    "Ring",
    "Feld",
    "Au",
)
ENDS = ("straße", "weg", "gasse", "allee")


def street_name(number: int) -> str:
    """A name of its own for every street number."""
    base = STREETS[number % len(STREETS)] + ENDS[number // len(STREETS) % len(ENDS)]
    turn = number // (len(STREETS) * len(ENDS))
    return f"{base} {turn + 1}" if turn else base


def _street(
    draft: Draft, a: int, b: int, street: int, main: bool, rng: np.random.Generator, plan: NetworkSettings
) -> int:
    """A bowed two-way road between junctions, main or side road."""
    start, end = draft.nodes[a], draft.nodes[b]
    xy = lines.bowed(start, end, float(rng.uniform(-1, 1)) * plan.bend_m)
    width = plan.lane_width_m + float(rng.uniform(-1, 1)) * plan.lane_width_spread_m
    if main:
        lanes, highway, speed = plan.main_lanes, "secondary" if plan.main_lanes > 1 else "tertiary", 50
    else:
        lanes, highway, speed = 1, "residential", 30
    surface = "asphalt" if main or rng.random() < 0.7 else "paving_stones"
    return draft.road(
        Road(a, b, xy, highway, lanes, lanes, width, street_name(street), speed, surface)
    )  # fmt: skip


def grid(draft: Draft, plan: NetworkSettings, rng: np.random.Generator) -> None:
    """blocks_x by blocks_y blocks; every `main_every`-th line is a main road."""
    nx, ny = plan.blocks_x + 1, plan.blocks_y + 1
    place = {
        (i, j): draft.node(np.array([i, j]) * plan.block_m + rng.uniform(-1, 1, 2) * plan.jitter_m)
        for j in range(ny)
        for i in range(nx)
    }
    middle_x, middle_y = plan.blocks_x // 2, plan.blocks_y // 2
    for j in range(ny):
        for i in range(nx - 1):
            main = (j - middle_y) % plan.main_every == 0
            _street(draft, place[i, j], place[i + 1, j], j, main, rng, plan)
    for i in range(nx):
        for j in range(ny - 1):
            main = (i - middle_x) % plan.main_every == 0
            _street(draft, place[i, j], place[i, j + 1], ny + i, main, rng, plan)


def radial(draft: Draft, plan: NetworkSettings, rng: np.random.Generator) -> None:
    """blocks_y rings around a centre, cut by max(3, blocks_x) spokes that are main roads."""
    spokes = max(3, plan.blocks_x)
    centre = draft.node(np.zeros(2))
    turn = rng.uniform(0, 2 * np.pi) + np.arange(spokes) * 2 * np.pi / spokes
    inner = [centre] * spokes
    for ring in range(1, plan.blocks_y + 1):
        radius = ring * plan.block_m
        nodes = [
            draft.node(radius * np.array([np.cos(a), np.sin(a)]) + rng.uniform(-1, 1, 2) * plan.jitter_m)
            for a in turn
        ]
        for k in range(spokes):
            _street(draft, inner[k], nodes[k], k, True, rng, plan)
        for k in range(spokes):
            i = _street(draft, nodes[k], nodes[(k + 1) % spokes], spokes + ring, ring % 2 == 0, rng, plan)
            a, b = draft.nodes[nodes[k]], draft.nodes[nodes[(k + 1) % spokes]]
            sagitta = radius * (1 - np.cos(np.pi / spokes))
            draft.change(i, xyz=lines.bowed(a, b, -sagitta))
        inner = nodes


def organic(draft: Draft, plan: NetworkSettings, rng: np.random.Generator) -> None:
    """Scattered junctions, joined where no third junction lies between two (relative neighbours)."""
    xy = _scatter(plan, rng)
    nodes = [draft.node(p) for p in xy]
    edges = _relative_neighbours(xy)
    main = _long_way(xy, edges)
    for k, (a, b) in enumerate(edges.tolist()):
        _street(draft, nodes[a], nodes[b], k // 3, (a, b) in main, rng, plan)


def _scatter(plan: NetworkSettings, rng: np.random.Generator) -> Floats:
    """Points of a shaken hexagonal lattice: irregular, but never too close."""
    cells = [(i, j) for j in range(plan.blocks_y + 1) for i in range(plan.blocks_x + 1)]
    lattice = np.array([(i + 0.5 * (j % 2), j * 0.9) for i, j in cells]) * plan.block_m
    return np.asarray(lattice + rng.uniform(-0.28, 0.28, lattice.shape) * plan.block_m)


def _relative_neighbours(xy: Floats) -> Ints:
    """(e, 2) edges of the Gabriel graph: Delaunay edges whose circle holds no other point."""
    simplices = Delaunay(xy).simplices
    edges = np.unique(
        np.sort(np.vstack([simplices[:, [0, 1]], simplices[:, [1, 2]], simplices[:, [2, 0]]]), axis=1), axis=0
    )
    neighbours: dict[int, set[int]] = {}
    for a, b in edges.tolist():
        neighbours.setdefault(a, set()).add(b)
        neighbours.setdefault(b, set()).add(a)
    keep = []
    for a, b in edges.tolist():
        others = np.array(sorted((neighbours[a] | neighbours[b]) - {a, b}), dtype=np.int64)
        middle, radius = (xy[a] + xy[b]) / 2, np.hypot(*(xy[a] - xy[b])) / 2
        if not (np.hypot(*(xy[others] - middle).T) < 1.04 * radius).any():
            keep.append((a, b))
    return np.array(keep, dtype=np.int64)


def _long_way(xy: Floats, edges: Ints) -> set[tuple[int, int]]:
    """Edges that run mostly east through the middle third: the main road."""
    middle = (xy[edges[:, 0]] + xy[edges[:, 1]])[:, 1] / 2
    low, high = np.quantile(xy[:, 1], [0.4, 0.6])
    step = np.abs(xy[edges[:, 1]] - xy[edges[:, 0]])
    hit = (middle > low) & (middle < high) & (step[:, 0] > step[:, 1])
    return {(int(a), int(b)) for a, b in edges[hit].tolist()}


def motorway(draft: Draft, plan: NetworkSettings, rng: np.random.Generator) -> None:
    """A motorway of two carriageways with `blocks_x` diamond interchanges to roads that cross over it.

    At the roads' ends loops lead back, so that a drive can turn.
    """
    gap, spacing = 16.0, max(plan.block_m, 420.0)
    xs = (np.arange(plan.blocks_x, dtype=np.float64) + 1) * spacing
    ends = np.array([0.0, (plan.blocks_x + 1) * spacing])
    east, west = _carriageway(draft, plan, ends, xs, -gap / 2), _carriageway(draft, plan, ends, xs, gap / 2)
    for k, x in enumerate(xs.tolist()):
        _interchange(draft, plan, rng, x, k, east[k], west[k])


def _carriageway(
    draft: Draft, plan: NetworkSettings, ends: Floats, xs: Floats, y: float
) -> list[tuple[int, int]]:
    """One direction; returns per interchange the junctions of its exit and its entry in driving order."""
    east = y < 0
    stops = [ends[0], *[v for x in xs for v in (x - 170.0, x + 170.0)], ends[1]]
    nodes = [draft.node(np.array([x, y + 3.0 * np.sin(x / 300.0)])) for x in stops]
    order = nodes if east else nodes[::-1]
    lanes = max(2, plan.main_lanes)
    for a, b in pairwise(order):
        xs_line = np.linspace(draft.nodes[a][0], draft.nodes[b][0], 24)
        xy = np.column_stack([xs_line, y + 3.0 * np.sin(xs_line / 300.0)])
        draft.road(Road(a, b, xy, "motorway", lanes, 0, 3.75, "", 120, "asphalt", "motorway"))
    found = [(nodes[1 + 2 * k], nodes[2 + 2 * k]) for k in range(len(xs))]
    return found if east else [(b, a) for a, b in found]


def _interchange(
    draft: Draft, plan: NetworkSettings, rng: np.random.Generator, x: float,
    number: int, east: tuple[int, int], west: tuple[int, int],
) -> None:  # fmt: skip
    """A road over the motorway, four ramps, and a turning loop at both ends of the road."""
    south, north = draft.node(np.array([x, -95.0])), draft.node(np.array([x + rng.uniform(-8, 8), 95.0]))
    over = _street(draft, south, north, number, True, rng, plan)
    draft.change(over, level=1, forward=1, backward=1, highway="secondary", maxspeed=70)
    for tip, crossing in ((-1.0, south), (1.0, north)):
        far = draft.node(np.array([x, tip * 230.0]))
        i = _street(draft, crossing, far, number, True, rng, plan)
        draft.change(i, forward=1, backward=1, highway="secondary", maxspeed=70)
        _turning_loop(draft, far, np.array([x, tip * 290.0]), number)
    for (leave, join), crossing, way in ((east, south, 1.0), (west, north, -1.0)):
        _ramp(draft, leave, crossing, way, True)
        _ramp(draft, crossing, join, way, False)


def _turning_loop(draft: Draft, node: int, centre: Floats, number: int) -> None:
    """A two-way ring of residential road that starts and ends at `node`, through three corners."""
    start = draft.nodes[node]
    radius = float(np.hypot(*(centre - start)))
    angle0 = float(np.arctan2(*(start - centre)[::-1]))
    corners = [
        draft.node(centre + radius * np.array([np.cos(angle0 + t), np.sin(angle0 + t)])) for t in (2.1, 4.2)
    ]
    stops = [node, *corners, node]
    for k in range(3):
        t = angle0 + np.linspace(2.1 * k, 2.1 * (k + 1) if k < 2 else 2 * np.pi, 12)
        xy = centre + radius * np.column_stack([np.cos(t), np.sin(t)])
        draft.road(Road(stops[k], stops[k + 1], xy, "residential", 1, 1, 3.25, street_name(40 + number), 30))


def _ramp(draft: Draft, a: int, b: int, way: float, leaving: bool) -> None:
    """A one-way ramp between the motorway (tangent to it) and the crossing road's junction."""
    start, end = draft.nodes[a], draft.nodes[b]
    along = np.array([way, 0.0])
    side = np.array([way, -way * 0.16]) if leaving else np.array([way, way * 0.16])
    side /= np.hypot(*side)
    flat = along * 0.7 + np.array([0.0, (-way if leaving else way) * 0.7])
    flat /= np.hypot(*flat)
    first, last = (side, flat) if leaving else (flat, side)
    xy = lines.bezier(start, first, end, last, 8.0)
    draft.road(Road(a, b, xy, "motorway_link", 1, 0, 3.75, "", 60, "asphalt", "ramp"))
