"""Stop lines, lights, signs and crosswalks, and pieces of lane that stand for nothing."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.chance import stream
from flexmap_tasks.simulate.hd_coverage import Piece
from flexmap_tasks.simulate.hd_drawing import Drawing, DrawnLanelet
from flexmap_tasks.simulate.lanes import LaneNetwork
from flexmap_tasks.simulate.world import World

FRAGMENT_M = 8.0


def put_furniture(drawing: Drawing, lanes: LaneNetwork, roads: dict[int, list[Piece]]) -> None:
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
                _crosswalk(drawing, lanes, road, at_end)


def _stop_line(drawing: Drawing, lanes: LaneNetwork, ahead: list[tuple[int, int]], light: bool) -> None:
    """A stop line across the lanes, the light or sign behind it, and the rule that joins them."""
    ends = []
    for side in ("left", "right"):
        outer = [lanes.xyz[getattr(lanes.strips[k], side)[-2:]] for k, _ in ahead]
        ends.append(
            [
                p[1] + (p[0] - p[1]) * min(0.5, 0.6 / max(float(np.hypot(*(p[0] - p[1])[:2])), 0.1))
                for p in outer
            ]
        )
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
    sign = drawing.line(
        board, *(("traffic_light", "red_yellow_green") if light else ("traffic_sign", "stop_sign"))
    )
    rule = len(drawing.draft.relation_ids)
    members = [("way", sign, "refers"), ("way", stop, "ref_line")]
    subtype = "traffic_light" if light else "traffic_sign"
    drawing.draft.relation(rule, members, {"type": "regulatory_element", "subtype": subtype})
    for _, row in ahead:
        drawing.regulatory.setdefault(row, []).append(rule)


def _crosswalk(drawing: Drawing, lanes: LaneNetwork, road: int, at_end: bool) -> None:
    """A crossing of 3 m over the whole road, 2 m before the junction begins."""
    line = lanes.network.roads[road]
    trim = lanes.trims[road, at_end]
    if line.length_m < trim + 20.0:
        return
    here = np.array(
        [line.length_m - trim - 2.0, line.length_m - trim - 5.0] if at_end else [trim + 5.0, trim + 2.0]
    )
    middle = lines.at(line.xyz, here)
    way = middle[0] - middle[1]
    normal = np.array([-way[1], way[0], 0.0]) / np.hypot(*way[:2]) * (line.width_m / 2 + 0.5)
    bounds = [np.array([drawing.point(m + normal), drawing.point(m - normal)]) for m in middle]
    left, right = (drawing.line(b, "pedestrian_marking", "") for b in bounds)
    drawing.lanelets.append(DrawnLanelet(0, -1, 0, 1, left, right, "crosswalk", False))


def put_fragments(
    world: World, drawing: Drawing, lanes: LaneNetwork, roads: dict[int, list[Piece]], stubs: set[int]
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
        ways = [drawing.line(np.array([drawing.point(p) for p in b]), "line_thin", "solid") for b in both]
        drawing.lanelets.append(DrawnLanelet(0, -1, 0, len(part) - 1, ways[0], ways[1], "fragment", False))
