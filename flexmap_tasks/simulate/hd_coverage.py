"""What the annotator drew, and what was left out."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from flexmap_tasks.simulate.chance import stream
from flexmap_tasks.simulate.drive import Drive
from flexmap_tasks.simulate.lanes import LaneNetwork, Strip
from flexmap_tasks.simulate.world import World

Piece = tuple[int, int]
"""First and last vertex of a road's trimmed line, both included."""


def coverage(world: World, lanes: LaneNetwork, drive: Drive) -> tuple[dict[int, list[Piece]], set[int]]:
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
    return list(pairwise(edges))


def missing_lanes(world: World, lanes: LaneNetwork, drive: Drive) -> set[int]:
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


def joins(lanes: LaneNetwork, turn: Strip, roads: dict[int, list[Piece]]) -> bool:
    """Whether both roads of a turn are drawn at its junction."""
    for road, at_end in ((turn.road, turn.direction > 0), (turn.to_road, turn.to_direction < 0)):
        if road not in roads:
            return False
        size = len(lanes.strips[lanes.road_strips[road][0]].left)
        if not any((last == size - 1) if at_end else (first == 0) for first, last in roads[road]):
            return False
    return True
