"""Matching by buffer growing (Zhang and Meng 2005; Leitenstern et al. 2024, section III-B)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.config import MatchParams
from flexmap_tasks.geometry.buffers import BufferShape
from flexmap_tasks.geometry.lanelets import gather
from flexmap_tasks.geometry.segments import first_of_groups
from flexmap_tasks.matching.buffers.candidates import RoadChains, chains_inside, near_nodes
from flexmap_tasks.matching.buffers.references import ReferenceLines
from flexmap_tasks.matching.buffers.similarity import Candidates, candidates_of
from flexmap_tasks.matching.road_segments import RoadSegments
from flexmap_tasks.model.arrays import Bools, Floats, Ints

OPEN, NO_ROAD, EXCLUDED, FOUND = 0, 1, 2, 3


@dataclass(frozen=True, slots=True, eq=False)
class Grown:
    """The best chain of road segments for every reference polyline.

    state : (r,) int64, NO_ROAD inside the buffers, all chains EXCLUDED by the limits, or FOUND
    half_width_m : (r,) float64, of the buffer that found it, else NaN
    candidates : (r,) int64, chains that passed the limits
    best : one row per FOUND reference, by reference; its `first` and `last` are rows of the following
    road : (n,) int64, row of the road segment; against : (n,) bool; a_m, b_m : (n, 2) float64, as walked
    """

    state: Ints
    half_width_m: Floats
    candidates: Ints
    best: Candidates
    road: Ints
    against: Bools
    a_m: Floats
    b_m: Floats


def grow(references: ReferenceLines, roads: RoadSegments, params: MatchParams) -> Grown:
    """Buffers around every reference polyline, enlarged round by round where no candidate survives."""
    n = len(references)
    state, count = np.full(n, OPEN, dtype=np.int64), np.zeros(n, dtype=np.int64)
    half_width = np.full(n, np.nan)
    shape = BufferShape(params.buffer_half_width_m, params.buffer_overshoot_m, params.buffer_corner)
    widest = shape.enlarged(params.enlargement_factor ** (params.enlargements - 1))
    near = near_nodes(references, roads, widest.reach_m)
    rounds: list[tuple[Candidates, RoadChains]] = []
    for _ in range(params.enlargements):
        found = chains_inside(references, roads, near, state != FOUND, shape)
        candidates = candidates_of(found, references, params)
        best = candidates.take(
            first_of_groups(
                candidates.reference, -np.round(candidates.score, 9), candidates.first, candidates.last
            )
        )
        state[found.reference] = EXCLUDED
        state[best.reference] = FOUND
        half_width[best.reference] = shape.half_width_m
        count += np.bincount(candidates.reference, minlength=n)
        rounds.append((best, found))
        shape = shape.enlarged(params.enlargement_factor)
    state[state == OPEN] = NO_ROAD
    return _collected(state, half_width, count, rounds)


def _collected(
    state: Ints, half_width: Floats, count: Ints, rounds: list[tuple[Candidates, RoadChains]]
) -> Grown:
    """The best chains of all rounds in one, by reference."""
    sizes = np.cumsum([0, *(len(chain.road) for _, chain in rounds)])
    fields = [
        np.concatenate([getattr(best, name) + shift for (best, _), shift in zip(rounds, sizes, strict=False)])
        for name in ("first", "last")
    ]
    first, last = fields
    rest = {
        name: np.concatenate([getattr(best, name) for best, _ in rounds])
        for name in ("reference", "angle_deg", "length_m", "chord_m", "area_m", "score")
    }
    order = np.argsort(rest["reference"], kind="stable")
    size = (last - first + 1)[order]
    bounds = np.stack([first[order], last[order] + 1], axis=1).ravel()
    _, rows = gather(bounds, np.arange(0, 2 * len(order), 2), np.zeros(len(order), dtype=bool))
    end = np.cumsum(size)
    best = Candidates(first=end - size, last=end - 1, **{k: v[order] for k, v in rest.items()})
    road, against, a_m, b_m = (
        np.concatenate([getattr(chain, name) for _, chain in rounds])[rows]
        for name in ("road", "against", "a_m", "b_m")
    )
    return Grown(state, half_width, count, best, road, against, a_m, b_m)
