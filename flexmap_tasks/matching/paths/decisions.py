"""From what is known of every sample to runs on one road, and their parts way by way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.geometry.lanelets import join
from flexmap_tasks.geometry.segments import running_maximum
from flexmap_tasks.matching.paths.inference import Posterior
from flexmap_tasks.matching.paths.road_graph import RoadGraph
from flexmap_tasks.matching.paths.samples import Samples
from flexmap_tasks.matching.paths.states import States, best_states
from flexmap_tasks.model.arrays import Bools, Floats, Ints

BRIDGE_SLACK_M, BRIDGE_SLACK_SHARE = 5.0, 0.2
"""By how much a road may be longer or shorter than the lane where it is believed without fitting."""
JUNCTION_REACH_M = 15.0
"""A run that ends this near to a junction, where the next begins, reaches up to it."""


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Stretches of a bundle on one link in one direction, or on none; together they cover every bundle.

    bundle : (r,) int64; first, last : (r,) int64, samples, both included
    from_m, to_m : (r,) float64 along the bundle
    link, direction : (r,) int64, link -1 where there is no counterpart
    s_from_m, s_to_m : (r,) float64 along the link at from_m and to_m
    probability : (r,) float64, mean over the samples; distance_m, angle_deg : (r,) float64, means
    """

    bundle: Ints
    first: Ints
    last: Ints
    from_m: Floats
    to_m: Floats
    link: Ints
    direction: Ints
    s_from_m: Floats
    s_to_m: Floats
    probability: Floats
    distance_m: Floats
    angle_deg: Floats


@dataclass(frozen=True, slots=True, eq=False)
class RunParts:
    """Parts of runs on one way each.

    run : (p,) int64; from_m, to_m : (p,) float64 along the bundle, without gap
    way : (p,) int64, row, -1 none; way_from_m, way_to_m : (p,) float64, NaN where there is none
    """

    run: Ints
    from_m: Floats
    to_m: Floats
    way: Ints
    way_from_m: Floats
    way_to_m: Floats


def chosen_states(samples: Samples, posterior: Posterior) -> Ints:
    """(n,) the likeliest state of every sample, with the last word on turns for what lies at their ends.

    A junction connector belongs to the road it comes from up to its middle, then to the one it leads to. Where
    one of them does not exist the geometry of the turn alone would let the other have all of it; where both
    exist no part of it is without a road.
    """
    states = posterior.states
    best = best_states(states, posterior.probability)
    nowhere = states.offset[1:] - 1
    probability = posterior.probability.copy()
    probability[nowhere] = -1.0
    on_road = best_states(states, probability)
    ahead, behind = _ends_nowhere(samples, states.link[best] < 0)
    bundle = samples.bundle
    place = np.arange(len(samples)) - samples.offset[bundle]
    late = 2 * place + 1 > np.diff(samples.offset)[bundle]
    lost = np.where(late, ahead[bundle] & ~behind[bundle], behind[bundle] & ~ahead[bundle])
    whole = ~ahead[bundle] & ~behind[bundle]
    turned = np.where(lost, nowhere, np.where(whole, on_road, best))
    return _bridged(samples, states, np.where(samples.connector, turned, best))


def _bridged(samples: Samples, states: States, best: Ints) -> Ints:
    """Put stretches without a counterpart on the road that runs on before and after them as far as the lane does.

    A road does not end and begin again on the same link: it is drawn badly there.
    """
    run, link, first, last = _stretches(samples, states, best)
    inner = np.flatnonzero((link[:-2] == link[2:]) & (link[1:-1] < 0) & (link[2:] >= 0)) + 1
    a, b = last[inner - 1], first[inner + 1]
    inner = inner[
        (samples.bundle[a] == samples.bundle[b]) & (states.direction[best[a]] == states.direction[best[b]])
    ]
    a, b = last[inner - 1], first[inner + 1]
    driven = (states.s_m[best[b]] - states.s_m[best[a]]) * states.direction[best[a]]
    drawn = (b - a) * samples.step_m[a]
    inner = inner[np.abs(driven - drawn) <= BRIDGE_SLACK_M + BRIDGE_SLACK_SHARE * drawn]
    wanted = np.full(len(link), -2, dtype=np.int64)
    wanted[inner] = link[inner - 1]
    of = states.sample
    hit = np.flatnonzero(states.link == wanted[run[of]])
    found = np.zeros(len(best), dtype=np.int64)
    found[of[hit]] = 1
    whole = np.bincount(run, weights=found, minlength=len(link)) == last - first + 1
    hit = hit[whole[run[of[hit]]]]
    out = best.copy()
    out[of[hit]] = hit
    return out


def _stretches(samples: Samples, states: States, best: Ints) -> tuple[Ints, Ints, Ints, Ints]:
    """Neighbouring samples of a bundle on one link (or none): number per sample; link, first and last per stretch."""
    link, n = states.link[best], len(samples)
    new = np.append(True, (samples.bundle[1:] != samples.bundle[:-1]) | (link[1:] != link[:-1]))[:n]
    first = np.flatnonzero(new)
    return np.cumsum(new) - 1, link[first], first, np.append(first[1:], n)[: len(first)] - 1


def _certainty(samples: Samples, graph: RoadGraph, posterior: Posterior, best: Ints) -> Floats:
    """(n,) probability of the chosen states; in a turn, of any of the roads that it joins.

    Where inside a junction one road ends and the next begins is a matter of drawing, and no doubt.
    """
    states = posterior.states
    link = states.link[best]
    crossing = samples.bundle[samples.edges[:, 0]] != samples.bundle[samples.edges[:, 1]]
    a, b = samples.edges[crossing].T
    base = len(graph) + 1
    joined = np.concatenate(
        [samples.bundle * base + link, samples.bundle[a] * base + link[b], samples.bundle[b] * base + link[a]]
    )
    of = states.sample
    counts = (states.link >= 0) & np.isin(samples.bundle[of] * base + states.link, joined)
    either = np.bincount(of[counts], weights=posterior.probability[counts], minlength=len(samples))
    certain: Floats = np.where(samples.connector & (link >= 0), either, posterior.probability[best])
    nowhere = states.offset[1:] - 1
    bridged = (
        (link >= 0) & (posterior.probability[best] < posterior.probability[nowhere]) & ~samples.connector
    )
    certain = np.where(bridged, certain + posterior.probability[nowhere], certain)
    return np.minimum(certain, 1.0)


def _ends_nowhere(samples: Samples, missing: Bools) -> tuple[Bools, Bools]:
    """Per bundle: nothing that it leads to, nothing that leads to it, lies on a road."""
    a, b = samples.edges[samples.bundle[samples.edges[:, 0]] != samples.bundle[samples.edges[:, 1]]].T
    n = len(samples.length_m)
    on_road = [
        np.bincount(samples.bundle[here], weights=~missing[there], minlength=n)
        for here, there in ((a, b), (b, a))
    ]
    return on_road[0] == 0, on_road[1] == 0


def runs_of(samples: Samples, graph: RoadGraph, posterior: Posterior) -> Runs:
    """The likeliest place of every sample, neighbours on the same road joined."""
    states = posterior.states
    best = chosen_states(samples, posterior)
    link, direction = states.link[best], states.direction[best]
    n = len(samples)
    same = (samples.bundle[1:] == samples.bundle[:-1]) & (link[1:] == link[:-1])
    same &= direction[1:] == direction[:-1]
    # On a ring the end of the link is next to its start: going round past it begins a new run.
    s = states.s_m[best]
    same &= (s[1:] - s[:-1]) * direction[1:] > -JUNCTION_REACH_M
    first = np.flatnonzero(np.append(True, ~same)[:n])
    last = np.append(first[1:], n)[: len(first)] - 1
    shifted = np.hypot(*(states.offset_m[best] - posterior.shift_m).T)
    size = last - first + 1

    def mean(value: Floats) -> Floats:
        return np.add.reduceat(value, first) / size if len(first) else np.zeros(0)

    bundle = samples.bundle[first]
    lo, hi, s_lo, s_hi = _borders(samples, graph, bundle, first, last, link, direction, s)
    return Runs(
        bundle, first, last, lo, hi, link[first], direction[first], s_lo, s_hi,
        mean(_certainty(samples, graph, posterior, best)), mean(shifted), mean(states.angle_deg[best]),
    )  # fmt: skip


def _borders(
    samples: Samples, graph: RoadGraph, bundle: Ints, first: Ints, last: Ints, link: Ints, direction: Ints,
    s: Floats,
) -> tuple[Floats, Floats, Floats, Floats]:  # fmt: skip
    """Where runs begin and end along the bundle and along their links.

    Between two roads that is where the junction lies between the last sample of one and the first of the other.
    """
    step = samples.step_m[first]
    place = (np.arange(len(samples)) - samples.offset[samples.bundle] + 0.5) * samples.step_m
    length = np.append(graph.length_m, 0.0)
    on = link[first] >= 0
    ahead = direction[first] > 0
    lead = np.where(ahead, s[first], length[link[first]] - s[first])
    left = np.where(ahead, length[link[last]] - s[last], s[last])
    inner = np.flatnonzero(bundle[1:] == bundle[:-1])
    both = inner[on[inner] & on[inner + 1]]
    share = np.full(len(first), 0.5)
    span = left[both] + lead[both + 1]
    share[both] = np.divide(left[both], span, out=np.full(len(both), 0.5), where=span > 0)
    to = place[last] + step * share
    start = np.append(True, bundle[1:] != bundle[:-1])[: len(first)]
    stop = np.append(start[1:], True)[: len(first)]
    to = np.where(stop, samples.length_m[bundle], to)
    low = np.where(start, 0.0, np.append(0.0, to[:-1])[: len(first)])
    back, fore = np.minimum(place[first] - low, lead), np.minimum(to - place[last], left)
    after, before = np.zeros(len(first), dtype=bool), np.zeros(len(first), dtype=bool)
    after[both + 1], before[both] = True, True
    back = np.where(after & (lead <= JUNCTION_REACH_M), lead, back)
    fore = np.where(before & (left <= JUNCTION_REACH_M), left, fore)
    sign = direction[first]
    return low, to, s[first] - sign * back, s[last] + sign * fore


def parts_of(samples: Samples, graph: RoadGraph, posterior: Posterior, runs: Runs) -> RunParts:
    """Runs cut where the link goes over from one way to the next."""
    run, travel, metres = _knots(samples, posterior, runs)
    cut_run, cut_travel = _way_changes(graph, runs)
    cut_at = _interpolated(run, travel, metres, cut_run, cut_travel)
    n = len(runs.bundle)
    every = np.concatenate([np.arange(n), cut_run])
    from_m = np.concatenate([runs.from_m, cut_at])
    start = np.concatenate([np.where(runs.link >= 0, runs.s_from_m * _sign(runs), 0.0), cut_travel])
    order = np.lexsort((start, from_m, every))
    every, from_m, start = every[order], from_m[order], start[order]
    final = np.append(every[1:] != every[:-1], True)[: len(every)]
    to_m = np.where(final, runs.to_m[every], np.append(from_m[1:], 0.0)[: len(every)])
    stop = np.where(final, (runs.s_to_m * _sign(runs))[every], np.append(start[1:], 0.0)[: len(every)])
    kept = to_m > from_m
    every, from_m, to_m, start, stop = (c[kept] for c in (every, from_m, to_m, start, stop))
    way, way_from, way_to = _on_ways(graph, runs, every, start, stop)
    return RunParts(every, from_m, to_m, way, way_from, way_to)


def _sign(runs: Runs) -> Floats:
    return np.where(runs.direction < 0, -1.0, 1.0)


def _knots(samples: Samples, posterior: Posterior, runs: Runs) -> tuple[Ints, Floats, Floats]:
    """(run, metres along the link in the direction of travel, metres along the bundle), never backwards."""
    states = posterior.states
    s = states.s_m[chosen_states(samples, posterior)]
    place = (np.arange(len(samples)) - samples.offset[samples.bundle] + 0.5) * samples.step_m
    n = len(runs.bundle)
    of = np.repeat(np.arange(n), runs.last - runs.first + 1)
    sign = _sign(runs)
    run = np.concatenate([np.arange(n), of, np.arange(n)])
    kind = np.concatenate([np.zeros(n), np.ones(len(of)), np.full(n, 2.0)])
    travel = np.concatenate([runs.s_from_m * sign, s * sign[of], runs.s_to_m * sign])
    metres = np.concatenate([runs.from_m, place, runs.to_m])
    order = np.lexsort((metres, kind, run))
    run, travel, metres = run[order], travel[order], metres[order]
    return run, running_maximum(travel, run), running_maximum(metres, run)


def _way_changes(graph: RoadGraph, runs: Runs) -> tuple[Ints, Floats]:
    """(run, metres in the direction of travel) where the way changes strictly inside a run."""
    change = np.flatnonzero((graph.link[1:] == graph.link[:-1]) & (graph.way[1:] != graph.way[:-1])) + 1
    run, at = join(runs.link, graph.link[change])
    s = graph.s_m[change[at]]
    low, high = np.minimum(runs.s_from_m, runs.s_to_m)[run], np.maximum(runs.s_from_m, runs.s_to_m)[run]
    inside = (s > low) & (s < high)
    return run[inside], (s * _sign(runs)[run])[inside]


def _interpolated(run: Ints, travel: Floats, metres: Floats, at_run: Ints, at_travel: Floats) -> Floats:
    """Metres along the bundle where the run has come as far as `at_travel`."""
    n, m = len(run), len(at_run)
    kind = np.concatenate([np.zeros(n), np.ones(m)])
    order = np.lexsort((kind, np.concatenate([travel, at_travel]), np.concatenate([run, at_run])))
    knot = np.maximum.accumulate(np.where(order < n, order, -1)) if n + m else np.zeros(0, dtype=np.int64)
    before = np.empty(n + m, dtype=np.int64)
    before[order] = knot
    i = np.minimum(before[n:], n - 2) if n > 1 else before[n:]
    gap = travel[i + 1] - travel[i]
    t = np.clip(np.divide(at_travel - travel[i], gap, out=np.zeros(m), where=gap > 0), 0.0, 1.0)
    place: Floats = metres[i] + t * (metres[i + 1] - metres[i])
    return place


def _on_ways(
    graph: RoadGraph, runs: Runs, run: Ints, start: Floats, stop: Floats
) -> tuple[Ints, Floats, Floats]:
    """The way of every part and metres along it, from metres in the direction of travel."""
    link, sign = runs.link[run], _sign(runs)[run]
    on = link >= 0
    way, way_from, way_to = np.full(len(run), -1), np.full(len(run), np.nan), np.full(len(run), np.nan)
    if not on.any():
        return way, way_from, way_to
    base = offsets_m(graph)
    key = base[graph.link] + graph.s_m
    link, s0, s1 = link[on], (start * sign)[on], (stop * sign)[on]
    seg = np.searchsorted(key, base[link] + (s0 + s1) / 2, side="right") - 1
    seg = np.clip(seg, graph.offset[link], graph.offset[link + 1] - 1)
    way[on] = graph.way[seg]
    rate = np.sign(graph.way_b_m[seg] - graph.way_a_m[seg])
    way_from[on] = graph.way_a_m[seg] + rate * (s0 - graph.s_m[seg])
    way_to[on] = graph.way_a_m[seg] + rate * (s1 - graph.s_m[seg])
    return way, way_from, way_to


def offsets_m(graph: RoadGraph) -> Floats:
    """(k + 1,) metres before each link when all are laid end to end."""
    return np.append(0.0, np.cumsum(graph.length_m))
