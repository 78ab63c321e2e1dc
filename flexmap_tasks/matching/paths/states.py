"""Where on the road graph every sample could lie, and how well each place fits on its own."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import shapely

from flexmap_tasks.config import PathParams
from flexmap_tasks.geometry.lanelets import offsets
from flexmap_tasks.geometry.segments import least_of_groups, project
from flexmap_tasks.matching.paths.road_graph import RoadGraph, layer_of, one_way_of, tag
from flexmap_tasks.matching.paths.samples import Samples
from flexmap_tasks.model.arrays import Bools, Floats, Ints
from flexmap_tasks.model.maps import RoadNetwork

TURN_ABSENCE, STRAY_ABSENCE = 0.8, 0.5
"""By how much less likely than elsewhere a road is at a right-angled turn; how likely for a stray lanelet."""
TURN_ANGLE = 0.4
"""Degrees by which headings scatter more in a junction connector, per degree that it turns."""
SMALL_HIGHWAYS = ("service", "living_street", "track", "road")
COUNT = re.compile(r"[1-9]")
ANGLE_MISFIT_MAX = 8.0
"""Heading alone cannot say more than this against a place."""


@dataclass(frozen=True, slots=True, eq=False)
class Near:
    """Pairs of a sample and a segment of the road graph.

    sample, segment : (p,) int64, ordered by sample
    """

    sample: Ints
    segment: Ints


@dataclass(frozen=True, slots=True, eq=False)
class States:
    """Candidates of every sample, the last of each being "no counterpart" (link -1).

    offset : (n + 1,) int64; link, direction : (m,) int64; s_m : (m,) float64 along the link
    cost : (m,) float64 >= 0
    offset_m : (m, 2) float64, from where the road is expected to where it is
    angle_deg : (m,) float64, between the headings
    """

    offset: Ints
    link: Ints
    direction: Ints
    s_m: Floats
    cost: Floats
    offset_m: Floats
    angle_deg: Floats

    @property
    def sample(self) -> Ints:
        """(m,) the sample of every state."""
        return np.repeat(np.arange(len(self.offset) - 1), np.diff(self.offset))


def best_states(states: States, probability: Floats) -> Ints:
    """(n,) the likeliest state of every sample, the first of equals."""
    return least_of_groups(states.offset[:-1], -np.round(probability, 9))


def near_segments(samples: Samples, graph: RoadGraph, radius_m: float) -> Near:
    """All segments within the radius of every sample, through a spatial index."""
    if not len(graph.link) or not len(samples):
        return Near(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))
    tree = shapely.STRtree(shapely.linestrings(np.stack([graph.a_m, graph.b_m], axis=1)))
    sample, segment = tree.query(shapely.points(samples.point_m), predicate="dwithin", distance=radius_m)
    order = np.lexsort((segment, sample))
    return Near(sample[order].astype(np.int64), segment[order].astype(np.int64))


def link_costs(network: RoadNetwork, graph: RoadGraph, params: PathParams) -> Floats:
    """(k,) what speaks against a link as such: private, service and unfinished roads carry fewer lanes."""
    service = np.isin(tag(network, graph, "service"), ("parking_aisle", "driveway", "drive-through"))
    closed = np.isin(tag(network, graph, "access"), ("no", "private"))
    cost: Floats = service * params.minor_cost + closed * params.minor_cost
    return cost


def near_costs(
    samples: Samples, graph: RoadGraph, network: RoadNetwork, near: Near, params: PathParams
) -> Floats:
    """(p,) what speaks against a pair whatever its distance: the kind of road, and the wrong one of two levels."""
    n, link = len(samples), graph.link[near.segment]
    layer = layer_of(network, graph)[link]
    highest, lowest = np.full(n, -99), np.full(n, 99)
    np.maximum.at(highest, near.sample, layer)
    np.minimum.at(lowest, near.sample, layer)
    level = samples.level[near.sample]
    narrow = (samples.lanes > 1)[near.sample] & _narrow(network)[graph.way[near.segment]]
    wrong = ((level > 0) & (layer < highest[near.sample])) | ((level < 0) & (layer > lowest[near.sample]))
    cost: Floats = link_costs(network, graph, params)[link] + params.level_cost * wrong
    return cost + params.narrow_cost * narrow


def _narrow(network: RoadNetwork) -> Bools:
    """(w,) ways with one lane in each direction at most, by OSM's count of lanes, else by their class."""
    text, number = np.unique(network.tags.column("lanes").astype(str), return_inverse=True)
    lanes = np.array([int(t) if COUNT.fullmatch(t) else 0 for t in text], dtype=np.int64)[number.ravel()]
    small = np.isin(network.tags.column("highway").astype(str), SMALL_HIGHWAYS)
    return np.asarray(np.where(lanes > 0, lanes <= np.where(one_way_of(network) != 0, 1, 2), small))


def states_of(
    samples: Samples, graph: RoadGraph, near: Near, near_cost: Floats, shift_m: Floats, sigma_m: float,
    params: PathParams, absent_cost: float,
) -> States:  # fmt: skip
    """Best place per sample and link, the cheapest `params.candidates` of each sample, and no counterpart.

    shift_m : (n, 2) float64, by how much roads are displaced against the lanelets here; sigma_m : the scatter
    about it. Expected is a two-way road in the middle between both directions (between the sample's own middle
    and its inner edge where no lane comes towards it), a one-way road between there and the middle of the
    sample's own lanes.
    """
    fits = _fits(samples, graph, near, near_cost, shift_m, sigma_m, params)
    sample, n = near.sample, len(samples)
    # Pairs are ordered by sample and segment, segments by link.
    new = (sample[1:] != sample[:-1]) | (fits.link[1:] != fits.link[:-1])
    place = least_of_groups(np.flatnonzero(np.append(True, new)[: len(sample)]), fits.cost)
    place = place[_cheapest(sample[place], np.round(fits.cost[place], 9), params.candidates)]
    of = sample[place]
    offset = offsets(np.bincount(of, minlength=n) + 1)
    at, total = np.arange(len(place)) + of, int(offset[-1])
    weight = samples.step_m / params.correlation_m
    out = States(
        offset, np.full(total, -1, dtype=np.int64), np.zeros(total, dtype=np.int64), np.zeros(total),
        np.zeros(total), np.zeros((total, 2)), np.zeros(total),
    )  # fmt: skip
    out.link[at], out.direction[at], out.s_m[at] = fits.link[place], fits.direction[place], fits.s_m[place]
    out.cost[at] = weight[of] * fits.cost[place]
    out.cost[offset[1:] - 1] = weight * absent_cost * _absence(samples)
    out.offset_m[at], out.angle_deg[at] = fits.offset_m[place], fits.angle_deg[place]
    return out


def _cheapest(sample: Ints, cost: Floats, most: int) -> Ints:
    """Rows of the cheapest `most` of every sample, the first of equals, in the order they came in."""
    rows = np.arange(len(sample))
    crowded = np.flatnonzero((np.bincount(sample) > most)[sample]) if len(sample) else rows
    order = crowded[np.lexsort((crowded, cost[crowded], sample[crowded]))]
    rank = np.arange(len(order)) - np.searchsorted(sample[order], sample[order])
    kept = np.ones(len(sample), dtype=bool)
    kept[order[rank >= most]] = False
    return rows[kept]


@dataclass(frozen=True, slots=True, eq=False)
class _Fits:
    """How every pair of sample and segment fits; fields as in `States`, cost per independent sample."""

    link: Ints
    direction: Ints
    s_m: Floats
    cost: Floats
    offset_m: Floats
    angle_deg: Floats


def _fits(
    samples: Samples, graph: RoadGraph, near: Near, near_cost: Floats, shift_m: Floats, sigma_m: float,
    params: PathParams,
) -> _Fits:  # fmt: skip
    sample, segment = near.sample, near.segment
    point = samples.point_m[sample] + shift_m[sample]
    t, _ = project(point, graph.a_m[segment], graph.b_m[segment])
    run = graph.b_m[segment] - graph.a_m[segment]
    length = np.hypot(*run.T)
    heading = samples.heading[sample]
    cos = np.einsum("ij,ij->i", heading, run) / length
    direction = np.where(cos >= 0, 1, -1)
    link = graph.link[segment]
    along_way = direction * graph.one_way[link]
    off = graph.a_m[segment] + t[:, None] * run - point
    right = np.stack([heading[:, 1], -heading[:, 0]], axis=1)
    low, high = _expected(samples, sample, along_way != 0)
    rest = off - np.clip(np.einsum("ij,ij->i", off, right), low, high)[:, None] * right
    spread2 = sigma_m**2 + _junction_m(samples)[sample] ** 2
    angle = np.degrees(np.arccos(np.clip(np.abs(cos), 0.0, 1.0)))
    angle_scale = params.angle_sigma_deg + TURN_ANGLE * np.minimum(samples.turn_deg, 120.0)[sample]
    # Student's t with three degrees of freedom: here and there a road is far more displaced than the rest.
    cost = 2.0 * np.log1p(np.einsum("ij,ij->i", rest, rest) / spread2 / 3.0)
    cost = cost + np.minimum((angle / angle_scale) ** 2 / 2, ANGLE_MISFIT_MAX)
    cost = cost + near_cost + params.wrong_way_cost * (along_way < 0)
    return _Fits(link, direction, graph.s_m[segment] + t * length, cost, rest + shift_m[sample], angle)


def _expected(samples: Samples, sample: Ints, directed: Bools) -> tuple[Floats, Floats]:
    """Where the road should lie to the right of the sample, from and to, metres."""
    inner = -samples.inner_m[sample]
    low = np.where(samples.lone[sample], np.minimum(inner, 0.0), 0.0)
    high = np.where(samples.lone[sample], np.maximum(inner, 0.0), 0.0)
    # Where both directions lie side by side a one-way road is one carriageway, or the tag is wrong.
    own = samples.aside_m[sample]
    return np.where(directed, np.minimum(own, 0.0), low), np.where(directed, np.maximum(own, 0.0), high)


def _absence(samples: Samples) -> Floats:
    """How easily a sample may have no counterpart, 1 for a lane of a road.

    A turn leaves one road before it reaches the next, which may not exist; a short lanelet that leads nowhere
    may stand for nothing.
    """
    turning = 1.0 - TURN_ABSENCE * np.minimum(samples.turn_deg, 90.0) / 90.0
    share: Floats = np.where(samples.stray, STRAY_ABSENCE, turning)
    return share


def _junction_m(samples: Samples) -> Floats:
    """How much further a turn keeps from the roads it joins, which meet in a corner."""
    extra: Floats = np.where(samples.connector, 1.0 + 4.0 * np.minimum(samples.turn_deg, 120.0) / 90.0, 0.0)
    return extra
