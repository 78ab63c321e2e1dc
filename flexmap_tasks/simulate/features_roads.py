"""Features of roads: one-way pairs, carriageways, islands, frontage roads, dead ends, car parks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.features_pick import plain_roads, shuffled
from flexmap_tasks.simulate.layouts import street_name
from flexmap_tasks.simulate.roads import Draft, Road
from flexmap_tasks.simulate.world import NetworkSettings

AISLE_EVERY_M = 17.0


def one_way_pairs(draft: Draft, count: int, _rng: np.random.Generator, _: NetworkSettings) -> None:
    """Two parallel side streets each become one-way, in opposite directions."""
    streets: dict[str, list[int]] = {}
    for i in plain_roads(draft, 30.0):
        if draft.get(i).highway == "residential":
            streets.setdefault(draft.get(i).name, []).append(i)
    names = [n for n in streets if len(streets[n]) >= 2]
    for first, second in list(pairwise(names))[::2][:count]:
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
    second = draft.split(i, s_to)[0]
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


def dual_carriageways(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    """Main roads run as two carriageways with a median between their junctions."""
    roads = [
        i for i in plain_roads(draft, 100.0) if draft.get(i).highway in ("secondary", "tertiary", "primary")
    ]
    for i in shuffled(roads, rng)[:count]:
        length = draft.get(i).length_m
        _split_carriageways(draft, i, 22.0, length - 22.0, float(rng.uniform(4.0, 9.0)), "dual", 16.0)


def islands(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    """Traffic islands of 15 to 25 m inside two-way roads, as a pedestrian's refuge."""
    for i in shuffled(plain_roads(draft, 80.0), rng)[:count]:
        length = draft.get(i).length_m
        s, half = length * float(rng.uniform(0.35, 0.65)), float(rng.uniform(8.0, 12.5))
        _split_carriageways(draft, i, s - half, s + half, 2.5, "island", 6.0)


def frontage_roads(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    """A narrow road beside a main road, close and parallel, joined at both ends."""
    roads = [i for i in plain_roads(draft, 100.0) if draft.get(i).highway != "residential"] or plain_roads(
        draft, 100.0
    )
    for k, i in enumerate(shuffled(roads, rng)[:count]):
        road = draft.get(i)
        b = draft.split(i, road.length_m - 24.0)[0]
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


def cul_de_sacs(draft: Draft, count: int, rng: np.random.Generator, _: NetworkSettings) -> None:
    """Dead ends of 35 to 60 m into the blocks."""
    for k, i in enumerate(shuffled(plain_roads(draft, 70.0), rng)):
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
        node = draft.split(i, s)[0]
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


def parking_aisles(draft: Draft, count: int, rng: np.random.Generator, plan: NetworkSettings) -> None:
    """Car parks: an access road into the block, and aisles 17 m apart that leave it at right angles."""
    for i in shuffled(plain_roads(draft, 100.0), rng):
        if count <= 0:
            return
        s, xy = _branch(draft, i, 0.5, plan.block_m * 0.42, float(rng.choice([-1.0, 1.0])))
        if not _away_from_roads(draft, xy, 25.0, i):
            continue
        node = draft.split(i, s)[0]
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
