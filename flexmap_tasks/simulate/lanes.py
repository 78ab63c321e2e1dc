"""Lanes of every road and the turns between them, with shared lines where they touch.

A strip is a lane between two junctions, or a turn inside one. Strips that follow each other share the end
points of both bounds; strips side by side share the line between them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.roads import Network, Road

BICYCLE_WIDTH_M, SHOULDER_WIDTH_M = 1.6, 2.5
MAX_TURN_RAD = 2.6
CLEAR_M = 1.0
"""No two points of a bound nearer than this: annotation noise would turn the step between them."""
STRAIGHT_RAD = 0.6

Arm = tuple[int, bool]


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    """One lane or turn.

    left, right : (n,) rows of the points of both bounds, in driving direction
    road, direction : the road it lies on and whether it runs along (+1) or against (-1) its line; for a turn
        the road it comes from
    to_road, to_direction : for a turn the road it leads to, else -1, 0
    lane : 0 for the lane nearest the middle of the road
    road_s : (n,) metres along the road's line of every pair of points; empty for a turn
    kind : "lane", "bus", "bicycle", "shoulder" or "turn"; turn : "left", "right", "straight" or ""
    node : the junction of a turn, -1 for a lane
    """

    left: Ints
    right: Ints
    road: int
    direction: int
    lane: int
    road_s: Floats
    kind: str = "lane"
    to_road: int = -1
    to_direction: int = 0
    turn: str = ""
    node: int = -1

    @property
    def drivable(self) -> bool:
        """Whether cars may use it as a lane."""
        return self.kind in ("lane", "bus", "turn")


@dataclass(slots=True)
class LaneNetwork:
    """All strips of a network.

    xyz : (n, 3) points; strips in a fixed order; followers : per strip the strips after it
    trims : (road, at_end) -> metres of the road's line that belong to the junction
    road_strips : rows of the lanes of every road, turns left out
    """

    network: Network
    xyz: Floats
    strips: list[Strip]
    followers: list[list[int]]
    trims: dict[Arm, float]
    road_strips: dict[int, list[int]]

    def centreline(self, strip: Strip) -> Floats:
        """(n, 3) mean of both bounds."""
        return np.asarray((self.xyz[strip.left] + self.xyz[strip.right]) / 2)


@dataclass(slots=True)
class _Builder:
    points: list[Floats] = field(default_factory=list)
    count: int = 0
    curves: dict[tuple[int, int], Ints] = field(default_factory=dict)

    def add(self, xyz: Floats) -> Ints:
        self.points.append(xyz)
        self.count += len(xyz)
        return np.arange(self.count - len(xyz), self.count, dtype=np.int64)


def make_lanes(network: Network, spacing_m: float, shoulders: bool) -> LaneNetwork:
    """Strips of every road, then the turns of every junction."""
    build, strips = _Builder(), list[Strip]()
    trims = _trims(network)
    ends: dict[tuple[int, int], list[int]] = {}
    for i, road in enumerate(network.roads):
        for strip in _road_strips(build, network, i, road, trims, shoulders):
            if strip.drivable:
                ends.setdefault((i, strip.direction), []).append(len(strips))
            strips.append(strip)
    by_road: dict[int, list[int]] = {}
    for k, strip in enumerate(strips):
        by_road.setdefault(strip.road, []).append(k)
    lanes = LaneNetwork(network, np.vstack(build.points), strips, [[] for _ in strips], trims, by_road)
    for node, arms in enumerate(network.arms()):
        _junction(build, lanes, ends, node, arms, spacing_m)
    lanes.xyz = np.vstack(build.points)
    return lanes


def _out_way(network: Network, arm: Arm) -> Floats:
    xyz = network.roads[arm[0]].xyz
    xyz = xyz[::-1] if arm[1] else xyz
    near = lines.at(xyz[:, :2], np.array([0.0, min(8.0, network.roads[arm[0]].length_m)]))
    return np.asarray((near[1] - near[0]) / max(np.hypot(*(near[1] - near[0])), 1e-9))


def _trims(network: Network) -> dict[Arm, float]:
    """How far each road keeps from its junctions so that the lanes of two roads do not cross."""
    trims: dict[Arm, float] = {}
    for arms in network.arms():
        ways = [_out_way(network, a) for a in arms]
        angle = [float(np.arctan2(w[1], w[0])) for w in ways]
        for k, arm in enumerate(arms):
            road = network.roads[arm[0]]
            need = 0.0 if len(arms) == 1 else 2.5
            for j, other in enumerate(arms):
                phi = abs((angle[j] - angle[k] + np.pi) % (2 * np.pi) - np.pi)
                if j == k or phi > 2.75:
                    continue
                mine, theirs = road.width_m / 2, network.roads[other[0]].width_m / 2
                reach = (theirs + mine * np.cos(phi)) / max(np.sin(phi), 0.2)
                need = max(need, reach + 2.5)
            trims[arm] = float(min(need, 45.0, 0.42 * road.length_m))
    return trims


def _road_strips(
    build: _Builder, network: Network, i: int, road: Road, trims: dict[Arm, float], shoulders: bool
) -> list[Strip]:
    """Lines from one edge of the road to the other, and the strips between them."""
    line = lines.cut(road.xyz, trims[i, False], road.length_m - trims[i, True], CLEAR_M)
    road_s = _road_s(road, trims[i, False], trims[i, True])
    total, w = road.width_m, road.lane_width_m
    offsets = list(total / 2 - w * np.arange(road.forward + road.backward + 1))
    kinds = ["bus" if road.bus and k == 0 and road.backward > 1 else "lane" for k in range(road.backward)]
    kinds += ["bus" if road.bus and k == road.forward - 1 > 0 else "lane" for k in range(road.forward)]
    extra = ("bicycle", BICYCLE_WIDTH_M) if road.bicycle else ("shoulder", SHOULDER_WIDTH_M)
    if road.bicycle or (shoulders and road.highway == "motorway"):
        offsets, kinds = [*offsets, offsets[-1] - extra[1]], [*kinds, extra[0]]
        if road.backward:
            offsets, kinds = [offsets[0] + extra[1], *offsets], [extra[0], *kinds]
    rows = [build.add(lines.shifted(line, network.side * float(o))) for o in offsets]
    split = road.backward + (1 if road.backward and kinds[0] in ("bicycle", "shoulder") else 0)
    strips = []
    for k, kind in enumerate(kinds):
        along = k >= split
        inner, outer = (rows[k], rows[k + 1]) if along else (rows[k + 1], rows[k])
        s, lane = road_s, k - split
        if not along:
            inner, outer, s, lane = inner[::-1], outer[::-1], road_s[::-1], split - 1 - k
        left, right = (inner, outer) if network.side > 0 else (outer, inner)
        strips.append(Strip(left, right, i, 1 if along else -1, lane, s, kind))
    return strips


def _road_s(road: Road, first_m: float, last_m: float) -> Floats:
    """Metres along the road of the vertices that `cut` keeps: its own, not those of the cut line."""
    s = lines.along(road.xyz)
    end = s[-1] - last_m
    return np.concatenate([[first_m], s[(s > first_m + CLEAR_M) & (s < end - CLEAR_M)], [end]])


def _junction(
    build: _Builder, lanes: LaneNetwork, ends: dict[tuple[int, int], list[int]], node: int, arms: list[Arm],
    spacing_m: float,
) -> None:  # fmt: skip
    """Turns from every road that arrives to every road that leaves."""
    network = lanes.network
    arriving = [(a, 1 if a[1] else -1) for a in arms if (a[0], 1 if a[1] else -1) in ends]
    leaving = [(a, -1 if a[1] else 1) for a in arms if (a[0], -1 if a[1] else 1) in ends]
    angle: dict[tuple[Arm, Arm], float] = {}
    for a, _ in arriving:
        into = -_out_way(network, a)
        for b, _ in leaving:
            out = _out_way(network, b)
            turn = float(np.arctan2(into[0] * out[1] - into[1] * out[0], into @ out)) * network.side
            twin = network.roads[a[0]].pair
            around = twin >= 0 and twin == network.roads[b[0]].pair
            if a != b and abs(turn) < MAX_TURN_RAD and not around:
                angle[a, b] = turn
    for (a, b), turn in angle.items():
        main = abs(turn) <= min(abs(v) for (p, q), v in angle.items() if p == a or q == b)
        first, second = ends[a[0], 1 if a[1] else -1], ends[b[0], -1 if b[1] else 1]
        for x, y in _turns(lanes, first, second, turn, main):
            _turn(build, lanes, x, y, node, turn * network.side, spacing_m)


def _turns(
    lanes: LaneNetwork, first: list[int], second: list[int], turn: float, main: bool
) -> list[tuple[int, int]]:
    """Lanes of one road that lead to lanes of another; bus lanes run on straight, or begin and end there."""
    cars, buses = (
        [sorted((k for k in side if lanes.strips[k].kind == kind), key=lambda k: lanes.strips[k].lane)
         for side in (first, second)] for kind in ("lane", "bus")
    )  # fmt: skip
    pairs = [(cars[0][x], cars[1][y]) for x, y in _pairs(len(cars[0]), len(cars[1]), turn, main)]
    if abs(turn) < STRAIGHT_RAD and main and (buses[0] or buses[1]):
        pairs.append(((buses[0] or cars[0])[-1], (buses[1] or cars[1])[-1]))
    return pairs


def _pairs(n: int, m: int, turn: float, main: bool) -> list[tuple[int, int]]:
    """Which of n arriving lanes lead to which of m leaving ones, 0 the innermost; turn > 0 is inward."""
    if abs(turn) < STRAIGHT_RAD and main:
        return [(min(k, n - 1), min(k, m - 1)) for k in range(max(n, m))]
    if abs(turn) < STRAIGHT_RAD:
        return [(n - 1, m - 1)]
    return [(0, 0)] if turn > 0 else [(n - 1, m - 1)]


def _turn(
    build: _Builder, lanes: LaneNetwork, a: int, b: int, node: int, turn: float, spacing_m: float
) -> None:
    """One strip through the junction; its bounds are shared with turns between the same points."""
    xyz, first, second = lanes.xyz, lanes.strips[a], lanes.strips[b]
    way_in = lines.tangents(xyz[first.left[-2:]])[-1]
    way_out = lines.tangents(xyz[second.left[:2]])[0]
    ends = [(int(first.left[-1]), int(second.left[0])), (int(first.right[-1]), int(second.right[0]))]
    chords = [float(np.hypot(*(xyz[t] - xyz[f])[:2])) for f, t in ends]
    if min(chords) < 0.3:
        return
    n = max(4, int(np.ceil(max(chords) * 1.15 / min(spacing_m, 2.5))) + 1)
    sides = []
    for f, t in ends:
        if (f, t) not in build.curves or len(build.curves[f, t]) != n:
            curve = lines.bezier(xyz[f, :2], way_in, xyz[t, :2], way_out, spacing_m, n)
            z = np.linspace(xyz[f, 2], xyz[t, 2], n)
            inner = build.add(np.column_stack([curve, z])[1:-1])
            build.curves[f, t] = np.concatenate([[f], inner, [t]]).astype(np.int64)
        sides.append(build.curves[f, t])
    word = "straight" if abs(turn) < STRAIGHT_RAD else "left" if turn > 0 else "right"
    lanes.followers[a].append(len(lanes.strips))
    lanes.followers.append([b])
    lanes.strips.append(
        Strip(sides[0], sides[1], first.road, first.direction, first.lane, np.empty(0), "turn", second.road,
              second.direction, word, node)
    )  # fmt: skip
