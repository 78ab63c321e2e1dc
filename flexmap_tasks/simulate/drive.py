"""The vehicle's way: which lanes, how fast, and where it is at any time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from flexmap_tasks.errors import ConfigError
from flexmap_tasks.model.arrays import Bools, Floats, Ints
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.chance import stream
from flexmap_tasks.simulate.lanes import LaneNetwork
from flexmap_tasks.simulate.world import World

STEP_M = 0.5
SMOOTHING_M = 2.0
START_STAND_S = 3.0
FEATURE_PULL_M = 250.0
"""How much nearer a bridge, a roundabout or an island seems to whoever plans the drive."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """The true motion, in the town's frame.

    strips : lanes and turns in the order they were driven
    s_m, time_s, xyz_m, yaw_rad, pitch_rad : (n,) or (n, 3), sampled at STEP_M; time rises while it stands
    stands_s : (k, 2) begin and end of every standstill
    """

    strips: tuple[int, ...]
    s_m: Floats
    time_s: Floats
    xyz_m: Floats
    yaw_rad: Floats
    pitch_rad: Floats
    stands_s: Floats

    @property
    def duration_s(self) -> float:
        """Time from start to end."""
        return float(self.time_s[-1])

    def at(self, time_s: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Place (n, 3), yaw, pitch and arc length at the given times."""
        s = np.interp(time_s, self.time_s, self.s_m)
        xyz = np.column_stack([np.interp(s, self.s_m, self.xyz_m[:, k]) for k in range(3)])
        return xyz, np.interp(s, self.s_m, self.yaw_rad), np.interp(s, self.s_m, self.pitch_rad), s

    def stands(self, time_s: Floats) -> Bools:
        """Whether the vehicle stands at the given times."""
        out = np.zeros(len(time_s), dtype=bool)
        for begin, end in self.stands_s:
            out |= (time_s >= begin) & (time_s <= end)
        return out


def make_drive(world: World, lanes: LaneNetwork) -> Drive:
    """A drive that covers lanes not seen before as long as it can reach them."""
    route = _route(world, lanes)
    xyz = _path(lanes, route)
    s = lines.along(xyz)
    length = min(float(s[-1]), world.drive.length_m) if not world.drive.return_to_start else float(s[-1])
    even = np.arange(0.0, length, STEP_M)
    xyz = lines.at(xyz, even)
    smooth = gaussian_filter1d(xyz, SMOOTHING_M / STEP_M, axis=0, mode="nearest")
    s = lines.along(smooth)
    yaw = np.unwrap(np.arctan2(*lines.tangents(smooth).T[::-1]))
    pitch = -np.arctan(np.gradient(smooth[:, 2]) / np.maximum(np.gradient(s), 1e-9))
    time, stands = _timed(world, s, yaw)
    return Drive(tuple(route), *_with_stands(s, time, smooth, yaw, pitch, stands))


def _route(world: World, lanes: LaneNetwork) -> list[int]:
    """Strips in driving order: always on to the nearest lane not driven yet."""
    rng = stream(world.seed, "route")
    n = len(lanes.strips)
    length = np.array([lines.along(lanes.centreline(s))[-1] for s in lanes.strips])
    for_cars = [s.kind in ("lane", "turn") for s in lanes.strips]
    steps = [(a, b) for a, after in enumerate(lanes.followers) for b in after if for_cars[a] and for_cars[b]]
    heads, tails = np.array(steps, dtype=np.int64).reshape(-1, 2).T
    graph = csr_array((length[tails] + 0.01, (heads, tails)), shape=(n, n))
    _, part = connected_components(graph, connection="strong")
    size = np.bincount(part, weights=length, minlength=n)
    home = part == int(np.argmax(size))
    fresh = home & np.array([s.kind == "lane" for s in lanes.strips])
    if not fresh.any() or not len(heads):
        raise ConfigError("world", "the roads have no loop that a drive could follow", "network")
    bonus = np.array([FEATURE_PULL_M if lanes.network.roads[s.road].role else 0.0 for s in lanes.strips])
    here = int(rng.choice(np.flatnonzero(fresh)))
    route, driven = [here], float(length[here])
    fresh[here] = False
    while driven < world.drive.length_m + 5.0:
        leg = _nearest(graph, here, fresh if fresh.any() else home & (np.arange(n) != here), bonus)
        route += leg
        driven += float(length[leg].sum())
        here = leg[-1]
        fresh[leg] = False
    if world.drive.return_to_start:
        target = np.zeros(n, dtype=bool)
        target[route[0]] = True
        route += _nearest(graph, here, target, bonus) if here != route[0] else []
    return route


def _nearest(graph: csr_array, here: int, wanted: Bools, bonus_m: Floats) -> list[int]:
    """The way from `here` to the nearest wanted strip, without `here`; a bonus makes a strip seem nearer."""
    limit = 2 * FEATURE_PULL_M
    while True:
        found = dijkstra(graph, indices=np.array([here]), return_predecessors=True, limit=limit)
        distance, before = found[0][0], found[1][0]
        reached = np.flatnonzero(wanted & np.isfinite(distance) & (np.arange(len(distance)) != here))
        if len(reached) or limit > 1e9:
            break
        limit *= 8
    leg = [int(reached[np.argmin((distance - bonus_m)[reached])])]
    while leg[-1] != here:
        leg.append(int(before[leg[-1]]))
    return leg[-2::-1]


def _path(lanes: LaneNetwork, route: list[int]) -> Floats:
    """The middle of the lanes in a row."""
    parts = [lanes.centreline(lanes.strips[k]) for k in route]
    return np.vstack([p[:-1] for p in parts[:-1]] + [parts[-1]])


def _timed(world: World, s: Floats, yaw: Floats) -> tuple[Floats, list[tuple[float, float]]]:
    """Time at every step without standstills, and where (arc length) it stands for how long."""
    plan, rng = world.drive, stream(world.seed, "speed")
    curvature = np.abs(np.gradient(gaussian_filter1d(yaw, 4.0))) / np.maximum(np.gradient(s), 1e-6)
    limit = np.minimum(
        plan.speed_max_m_s, np.sqrt(plan.lateral_acceleration_m_s2 / np.maximum(curvature, 1e-4))
    )
    total = float(s[-1])
    count = int(rng.poisson(plan.stops_per_km * total / 1000.0)) if plan.stops_per_km else 0
    places = np.sort(rng.uniform(20.0, max(21.0, total - 20.0), count))
    stops = [(0.0, START_STAND_S), *((float(p), float(rng.uniform(0.4, 1.6)) * plan.stop_s) for p in places)]
    for place, _ in [*stops, (total, 0.0)]:
        limit = np.minimum(limit, np.sqrt(2 * plan.acceleration_m_s2 * np.abs(s - place)))
    square = limit**2
    gain = 2 * plan.acceleration_m_s2 * np.diff(s)
    for i in range(1, len(s)):
        square[i] = min(square[i], square[i - 1] + gain[i - 1])
    for i in range(len(s) - 2, -1, -1):
        square[i] = min(square[i], square[i + 1] + gain[i])
    speed = np.maximum(np.sqrt(square), 0.3)
    time = np.concatenate([[0.0], np.cumsum(2 * np.diff(s) / (speed[:-1] + speed[1:]))])
    return time, stops


def _with_stands(
    s: Floats, time: Floats, xyz: Floats, yaw: Floats, pitch: Floats, stops: list[tuple[float, float]]
) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """Each standstill as two rows with equal place and its own time."""
    row = np.searchsorted(s, [p for p, _ in stops])
    row = np.minimum(row, len(s) - 1)
    wait = np.zeros(len(s))
    np.add.at(wait, row, [d for _, d in stops])
    begin = time + np.concatenate([[0.0], np.cumsum(wait)[:-1]])
    held = np.flatnonzero(wait > 0)
    stands = np.column_stack([begin[held], begin[held] + wait[held]])
    at: Ints = held + 1
    columns = [np.insert(c, at, c[held], axis=0) for c in (s, xyz, yaw, pitch)]
    times = np.insert(begin, at, stands[:, 1])
    return columns[0], times, columns[1], columns[2], columns[3], stands
