"""What makes a plan a town: roundabouts, islands, slip lanes, frontage roads, overpasses and the rest.

Every feature takes the draft, its count and its own chance, and changes the first places that fit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.layouts import street_name
from flexmap_tasks.simulate.roads import Draft, Road
from flexmap_tasks.simulate.world import NetworkSettings

AISLE_EVERY_M = 17.0

Feature = Callable[[Draft, int, np.random.Generator, NetworkSettings], None]


def build_features(draft: Draft, plan: NetworkSettings, rng_of: Callable[[str], np.random.Generator]) -> None:
    """Everything the settings ask for, in a fixed order, each with its own stream."""
    order: tuple[tuple[str, Feature], ...] = (
        ("overpasses", _overpasses),
        ("roundabouts", _roundabouts),
        ("one_way_pairs", _one_way_pairs),
        ("dual_carriageways", _dual_carriageways),
        ("islands", _islands),
        ("slip_lanes", _slip_lanes),
        ("frontage_roads", _frontage_roads),
        ("parking_aisles", _parking_aisles),
        ("cul_de_sacs", _cul_de_sacs),
        ("living_streets", _living_streets),
        ("bus_lanes", _bus_lanes),
        ("bicycle_lanes", _bicycle_lanes),
        ("tag_changes", _tag_changes),
    )
    for name, feature in order:
        count = getattr(plan, name)
        if count:
            feature(draft, count, rng_of(name), plan)


def _shuffled(items: Iterable[int], rng: np.random.Generator) -> list[int]:
    rows = np.array(sorted(items), dtype=np.int64)
    return [int(v) for v in rng.permutation(rows)]


def _plain(draft: Draft, least_m: float, two_way: bool = True) -> list[int]:
    """Ordinary roads of some length on the ground."""
    return [
        i
        for i in draft.living()
        if (r := draft.get(i)).length_m >= least_m
        and r.role == "" and r.level == 0 and (not two_way or r.backward > 0)
    ]  # fmt: skip


def _direction_out(draft: Draft, arm: tuple[int, bool]) -> Floats:
    """Unit direction in which a road leaves the junction of this arm."""
    xy = draft.get(arm[0]).xyz
    xy = xy[::-1] if arm[1] else xy
    step = lines.at(xy, np.array([min(12.0, lines.along(xy)[-1])]))[0] - xy[0]
    return np.asarray(step / np.hypot(*step))


def _overpasses(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    """Crossings of four roads become a road over a road without a junction."""
    for node in _shuffled(range(len(draft.nodes)), rng):
        arms = draft.arms(node)
        if count == 0:
            return
        if len(arms) != 4 or any(draft.get(i).role or draft.get(i).level for i, _ in arms):
            continue
        arms.sort(key=lambda a: float(np.arctan2(*_direction_out(draft, a)[::-1])))
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
        Road(start, end, _rounded(xy), first.highway, *lanes, first.lane_width_m, first.name, first.maxspeed,
             first.surface, "overpass" if level else "underpass", level=level)
    )  # fmt: skip


def _rounded(xy: Floats) -> Floats:
    """A line without the kink that a junction had."""
    fine = lines.resample(xy, 4.0)
    padded = np.vstack([np.repeat(fine[:1], 6, axis=0), fine, np.repeat(fine[-1:], 6, axis=0)])
    kernel = np.hanning(15)[1:-1] / np.hanning(15)[1:-1].sum()
    smooth = np.column_stack([np.convolve(padded[:, k], kernel, mode="valid") for k in range(2)])
    smooth[0], smooth[-1] = fine[0], fine[-1]
    return smooth


def _roundabouts(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
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
    angles = np.sort([float(np.arctan2(*_direction_out(draft, a)[::-1])) for a in arms])
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


def _one_way_pairs(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    """Two parallel side streets each become one-way, in opposite directions."""
    streets: dict[str, list[int]] = {}
    for i in _plain(draft, 30.0):
        if draft.get(i).highway == "residential":
            streets.setdefault(draft.get(i).name, []).append(i)
    names = [n for n in streets if len(streets[n]) >= 2]
    for first, second in list(zip(names, names[1:], strict=False))[::2][:count]:
        for name, flip in ((first, False), (second, True)):
            for i in streets[name]:
                road = draft.get(i)
                if flip:
                    draft.change(i, start=road.end, end=road.start, xyz=road.xyz[::-1].copy())
                draft.change(i, forward=1, backward=0, lane_width_m=4.0)


def _split_carriageways(
    draft: Draft, i: int, s_from: float, s_to: float, gap_m: float, role: str, taper: float
) -> None:
    """Between two places of a road its directions run apart, `gap_m` more than before."""
    road = draft.get(i)
    second, _ = draft.split(i, s_to)
    first, middle = draft.split(i, s_from)
    part = lines.resample(draft.get(middle).xyz, 3.0)
    s = lines.along(part)
    ease = np.clip(np.minimum(s, s[-1] - s) / taper, 0.0, 1.0)
    ease = ease * ease * (3 - 2 * ease)
    pair = draft.new_pair()
    right = lines.shifted(part, -ease * (road.backward * road.lane_width_m + gap_m) / 2)
    left = lines.shifted(part, ease * (road.forward * road.lane_width_m + gap_m) / 2)
    draft.change(middle, backward=0, xyz=right, role=role, pair=pair)
    twin = draft.get(middle)
    draft.road(
        Road(second, first, left[::-1].copy(), twin.highway, road.backward, 0, road.lane_width_m, twin.name,
             twin.maxspeed, twin.surface, role, pair)
    )  # fmt: skip


def _dual_carriageways(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    """Main roads run as two carriageways with a median between their junctions."""
    roads = [i for i in _plain(draft, 100.0) if draft.get(i).highway in ("secondary", "tertiary", "primary")]
    for i in _shuffled(roads, rng)[:count]:
        length = draft.get(i).length_m
        _split_carriageways(draft, i, 22.0, length - 22.0, float(rng.uniform(4.0, 9.0)), "dual", 16.0)


def _islands(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    """Traffic islands of 15 to 25 m inside two-way roads, as a pedestrian's refuge."""
    for i in _shuffled(_plain(draft, 80.0), rng)[:count]:
        length = draft.get(i).length_m
        s, half = length * float(rng.uniform(0.35, 0.65)), float(rng.uniform(8.0, 12.5))
        _split_carriageways(draft, i, s - half, s + half, 2.5, "island", 6.0)


def _slip_lanes(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
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
    out = _direction_out(draft, a)
    for b in arms:
        way = _direction_out(draft, b)
        turn = np.arctan2(out[0] * way[1] - out[1] * way[0], float(out @ way))
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


def _frontage_roads(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    """A narrow road beside a main road, close and parallel, joined at both ends."""
    roads = [i for i in _plain(draft, 100.0) if draft.get(i).highway != "residential"] or _plain(draft, 100.0)
    for k, i in enumerate(_shuffled(roads, rng)[:count]):
        road = draft.get(i)
        b, _ = draft.split(i, road.length_m - 24.0)
        a, middle = draft.split(i, 24.0)
        part = lines.resample(draft.get(middle).xyz, 3.0)
        s = lines.along(part)
        ease = np.clip(np.minimum(s, s[-1] - s) / 16.0, 0.0, 1.0)
        away = -(road.width_m / 2 + float(rng.uniform(6.0, 8.0)))
        xy = lines.shifted(part, ease * ease * (3 - 2 * ease) * away)
        draft.road(Road(a, b, xy, "service", 1, 1, 2.75, street_name(60 + k), 30, "asphalt", "frontage"))


def _away_from_roads(draft: Draft, xy: Floats, least_m: float, but: int) -> bool:
    """Whether a line keeps its distance from every other road (its first 20 m left out)."""
    line = lines.resample(xy, 5.0)
    line = line[lines.along(line) > 20.0]
    low, high = line.min(axis=0) - least_m, line.max(axis=0) + least_m
    for i in draft.living():
        other = draft.get(i).xyz
        if (other.min(axis=0) > high).any() or (other.max(axis=0) < low).any():
            continue
        other = lines.resample(other, 5.0)
        gap = np.hypot(*(line[:, None] - other[None]).transpose(2, 0, 1))
        if gap.min() < (least_m if i != but else 15.0):
            return False
    return True


def _branch(draft: Draft, i: int, share: float, length_m: float, side: float) -> tuple[float, Floats]:
    road = draft.get(i)
    s = road.length_m * share
    root = lines.at(road.xyz, np.array([s]))[0]
    ahead = lines.at(road.xyz, np.array([s + 1.0]))[0] - root
    ahead /= np.hypot(*ahead)
    tip = root + length_m * side * np.array([-ahead[1], ahead[0]])
    return s, lines.bowed(root, tip, 2.0)


def _cul_de_sacs(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    """Dead ends of 35 to 60 m into the blocks."""
    for k, i in enumerate(_shuffled(_plain(draft, 70.0), rng)):
        if count == 0:
            return
        length, share, side = (
            float(rng.uniform(35, 60)),
            float(rng.uniform(0.4, 0.6)),
            float(rng.choice([-1.0, 1.0])),
        )
        s, xy = _branch(draft, i, share, length, side)
        if not _away_from_roads(draft, xy, 14.0, i):
            continue
        node, _far = draft.split(i, s)
        end = draft.node(xy[-1])
        draft.road(
            Road(
                node,
                end,
                xy,
                "residential",
                1,
                1,
                2.75,
                street_name(80 + k),
                30,
                "paving_stones",
                "cul_de_sac",
            )
        )
        count -= 1


def _parking_aisles(draft: Draft, count: int, rng: np.random.Generator, plan: NetworkSettings) -> None:
    """Car parks: an access road into the block, and aisles 17 m apart that leave it at right angles."""
    for i in _shuffled(_plain(draft, 100.0), rng):
        if count <= 0:
            return
        s, xy = _branch(draft, i, 0.5, plan.block_m * 0.42, float(rng.choice([-1.0, 1.0])))
        if not _away_from_roads(draft, xy, 25.0, i):
            continue
        node, _ = draft.split(i, s)
        end = draft.node(xy[-1])
        trunk = draft.road(Road(node, end, xy, "service", 1, 1, 3.0, "", 10, "asphalt", "parking"))
        aisles = min(count, max(1, int((draft.get(trunk).length_m - 22.0) // AISLE_EVERY_M)))
        for k in range(aisles):
            _aisle(draft, trunk, k, plan.block_m * 0.25)
        count -= aisles


def _aisle(draft: Draft, trunk: int, number: int, length_m: float) -> None:
    """One aisle to the left of a car park's access road: the first at its end, each other one nearer."""
    road = draft.get(trunk)
    gate = road.end if number == 0 else draft.split(trunk, road.length_m - AISLE_EVERY_M)[0]
    way = lines.tangents(road.xyz)[-1]
    tip = draft.nodes[gate] + length_m * np.array([-way[1], way[0]])
    xy = lines.bowed(draft.nodes[gate], tip, 0.0)
    draft.road(Road(gate, draft.node(tip), xy, "service", 1, 1, 2.75, "", 10, "asphalt", "parking_aisle"))


def _living_streets(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    roads = [i for i in _plain(draft, 20.0, two_way=False) if draft.get(i).highway == "residential"]
    for i in _shuffled(roads, rng)[:count]:
        draft.change(i, highway="living_street", maxspeed=7, surface="paving_stones")


def _bus_lanes(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    roads = [i for i in _plain(draft, 60.0) if min(draft.get(i).forward, draft.get(i).backward) >= 2]
    for i in _shuffled(roads, rng)[:count]:
        draft.change(i, bus=True)


def _bicycle_lanes(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    for i in _shuffled(_plain(draft, 60.0), rng)[:count]:
        draft.change(i, bicycle=True)


def _tag_changes(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    """Between junctions the limit, the surface or the name changes."""
    for k, i in enumerate(_shuffled(_plain(draft, 80.0, two_way=False), rng)[:count]):
        road = draft.get(i)
        share = round(float(rng.uniform(0.35, 0.65)), 3)
        slower = 30 if road.maxspeed > 30 else 20
        change = (
            ("maxspeed", str(slower)),
            ("surface", "cobblestone" if road.surface != "cobblestone" else "asphalt"),
            ("name", f"Am {road.name}"),
        )[k % 3]
        draft.change(i, changes=(*road.changes, (share, *change)))
