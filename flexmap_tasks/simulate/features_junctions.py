"""Features of junctions: overpasses, roundabouts, slip lanes."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.features_pick import direction_out, shuffled
from flexmap_tasks.simulate.roads import Draft, Road
from flexmap_tasks.simulate.world import NetworkSettings


def overpasses(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    """Crossings of four roads become a road over a road without a junction."""
    for node in shuffled(range(len(draft.nodes)), rng):
        arms = draft.arms(node)
        if count == 0:
            return
        if len(arms) != 4 or any(draft.get(i).role or draft.get(i).level for i, _ in arms):
            continue
        arms.sort(key=lambda a: float(np.arctan2(*direction_out(draft, a)[::-1])))
        if len({i for i, _ in arms}) < 4:
            continue
        _join(draft, arms[0], arms[2], 0)
        _join(draft, arms[1], arms[3], 1)
        count -= 1


def _join(draft: Draft, a: tuple[int, bool], b: tuple[int, bool], level: int) -> None:
    """One road out of two that met in a junction."""
    first, second = draft.get(a[0]), draft.get(b[0])
    head = first.xyz if a[1] else first.xyz[::-1]
    tail = second.xyz[::-1] if b[1] else second.xyz
    start = first.start if a[1] else first.end
    end = second.start if b[1] else second.end
    lanes = (first.forward, first.backward) if a[1] else (first.backward, first.forward)
    draft.remove(a[0])
    draft.remove(b[0])
    xy = np.vstack([head[:-1], tail])
    draft.road(
        Road(start, end, lines.rounded(xy), first.highway, *lanes, first.lane_width_m, first.name, first.maxspeed,
             first.surface, "overpass" if level else "underpass", level=level)
    )  # fmt: skip


def roundabouts(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    """Junctions of three or more two-way roads become a ring driven counter-clockwise."""
    for node in _near_middle(draft, rng):
        if count == 0:
            return
        arms = draft.arms(node)
        fits = all(
            (r := draft.get(i)).role == "" and r.level == 0 and r.backward and r.length_m > 70
            for i, _ in arms
        )
        if len(arms) < 3 or not fits or len({i for i, _ in arms}) < len(arms) or _tightest(draft, arms) < 0.9:
            continue
        lanes = max(max(draft.get(i).forward, draft.get(i).backward) for i, _ in arms)
        _ring(draft, node, arms, float(rng.uniform(14.0, 18.0)) + 5.0 * (lanes - 1))
        count -= 1


def _near_middle(draft: Draft, rng: np.random.Generator) -> list[int]:
    """Junctions, those of the middle first with some chance."""
    xy = np.array(draft.nodes)
    distance = np.hypot(*(xy - xy.mean(axis=0)).T)
    return [int(i) for i in np.argsort(distance * rng.uniform(0.6, 1.4, len(xy)), kind="stable")]


def _tightest(draft: Draft, arms: list[tuple[int, bool]]) -> float:
    angles = np.sort([float(np.arctan2(*direction_out(draft, a)[::-1])) for a in arms])
    return float(np.min(np.diff(np.append(angles, angles[0] + 2 * np.pi))))


def _ring(draft: Draft, node: int, arms: list[tuple[int, bool]], radius: float) -> None:
    centre = draft.nodes[node]
    gates: list[tuple[float, int]] = []
    for i, at_end in arms:
        road = draft.get(i)
        outward = road.xyz[::-1] if at_end else road.xyz
        outward = lines.resample(outward, 1.0)
        s = float(lines.along(outward)[int(np.argmax(np.hypot(*(outward - centre).T) >= radius))])
        kept = (
            lines.cut(road.xyz, 0.0, road.length_m - s) if at_end else lines.cut(road.xyz, s, road.length_m)
        )
        point = kept[-1] if at_end else kept[0]
        gate = draft.node(point)
        draft.change(i, xyz=kept, **({"end": gate} if at_end else {"start": gate}))
        gates.append((float(np.arctan2(*(point - centre)[::-1])), gate))
    gates.sort()
    name = draft.get(arms[0][0]).name
    for (a, from_gate), (b, to_gate) in zip(
        gates, [*gates[1:], (gates[0][0] + 2 * np.pi, gates[0][1])], strict=True
    ):
        reach = np.hypot(*(draft.nodes[from_gate] - centre)), np.hypot(*(draft.nodes[to_gate] - centre))
        t = np.linspace(a, b, max(5, int((b - a) * radius / 2.0)))
        r = np.linspace(*reach, len(t))
        xy = centre + r[:, None] * np.column_stack([np.cos(t), np.sin(t)])
        draft.road(Road(from_gate, to_gate, xy, "tertiary", 1, 0, 4.5, name, 30, "asphalt", "roundabout"))


def slip_lanes(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    """Right turns get a road of their own that passes the junction."""
    for node in _near_middle(draft, rng):
        if count == 0:
            return
        arms = draft.arms(node)
        if len(arms) < 3 or any(
            draft.get(i).role or draft.get(i).level or draft.get(i).length_m < 90 for i, _ in arms
        ):
            continue
        for a in arms:
            b = _right_neighbour(draft, a, arms)
            if b and _can_leave(draft, a, False) and _can_leave(draft, b, True):
                _slip(draft, a, b)
                count -= 1
                break


def _can_leave(draft: Draft, arm: tuple[int, bool], outward: bool) -> bool:
    road = draft.get(arm[0])
    return bool((road.forward if arm[1] != outward else road.backward) > 0)


def _right_neighbour(
    draft: Draft, a: tuple[int, bool], arms: list[tuple[int, bool]]
) -> tuple[int, bool] | None:
    """The arm a right turn from `a` leads to, when it turns by 60 to 120 degrees."""
    out = direction_out(draft, a)
    for b in arms:
        ahead = direction_out(draft, b)
        turn = np.arctan2(out[0] * ahead[1] - out[1] * ahead[0], float(out @ ahead))
        if b[0] != a[0] and np.pi / 3 < turn < 2 * np.pi / 3:
            return b
    return None


def _slip(draft: Draft, a: tuple[int, bool], b: tuple[int, bool]) -> None:
    """A one-way road from 34 m before the junction on `a` to 34 m behind it on `b`."""
    gates = []
    for i, at_end in (a, b):
        road = draft.get(i)
        node, far = draft.split(i, road.length_m - 34.0 if at_end else 34.0)
        gates.append((node, _towards(draft, far if at_end else i, at_end)))
    (start, into), (end, back) = gates
    turn_in, turn_out = _rotated(into, -0.35), _rotated(-back, -0.35)
    xy = lines.bezier(draft.nodes[start], turn_in, draft.nodes[end], turn_out, 3.0)
    road = draft.get(a[0])
    draft.road(Road(start, end, xy, road.highway + "_link" if road.highway != "residential" else road.highway,
                    1, 0, 3.5, road.name, road.maxspeed, road.surface, "slip"))  # fmt: skip


def _towards(draft: Draft, i: int, at_end: bool) -> Floats:
    """Direction towards the junction at one end of a short road."""
    xy = draft.get(i).xyz
    step = xy[-1] - xy[0] if at_end else xy[0] - xy[-1]
    return np.asarray(step / np.hypot(*step))


def _rotated(way: Floats, angle: float) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * way[0] - s * way[1], s * way[0] + c * way[1]])
