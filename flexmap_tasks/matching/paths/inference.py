"""Which candidate every sample lies on, decided by all samples together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.config import PathParams
from flexmap_tasks.geometry.beliefs import beliefs
from flexmap_tasks.geometry.transitions import Net, pair_weights
from flexmap_tasks.matching.paths.offsets import displacement
from flexmap_tasks.matching.paths.road_graph import RoadGraph, node_distances
from flexmap_tasks.matching.paths.samples import Samples
from flexmap_tasks.matching.paths.states import States, near_costs, near_segments, states_of
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.maps import RoadNetwork

DISTANCE_LIMIT_M = 40.0
SWEEPS, LAST_SWEEPS = 3, 8
"""Sweeps while displacement is being estimated, and for the outcome."""


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """What is known of every sample.

    states : the candidates; probability : (m,) float64, summing to 1 per sample
    shift_m : (n, 2) float64, displacement of the roads; sigma_m : scatter about it
    """

    states: States
    probability: Floats
    shift_m: Floats
    sigma_m: float


def infer(samples: Samples, graph: RoadGraph, network: RoadNetwork, params: PathParams) -> Posterior:
    """Hidden Markov model over the whole graph of lanelet paths, solved by belief propagation.

    States are places on links (or none), the fit of a place is by distance and heading, and places follow each
    other as far apart on the road graph as the samples are on the lanelets. Displacement and scatter of the
    roads are estimated from the outcome, round by round. Until they are known a road far off is believed more
    easily than its absence: else a place where all roads are far displaced would lose them all at once.
    """
    near = near_segments(samples, graph, params.radius_m)
    cost = near_costs(samples, graph, network, near, params)
    net = Net(graph.tail, graph.head, graph.length_m, *node_distances(graph, DISTANCE_LIMIT_M))
    turning = np.maximum(samples.connector[samples.edges[:, 0]], samples.connector[samples.edges[:, 1]])
    scale = np.where(turning, 2.0, 1.0) * params.detour_m
    shift, sigma = np.zeros((len(samples), 2)), params.sigma_start_m
    for k in range(params.rounds):
        last = k + 1 == params.rounds
        absent = params.absent_cost if last else params.absent_cost_start
        states = states_of(samples, graph, near, cost, shift, sigma, params, absent)
        offset, pair = pair_weights(
            states.offset, states.link, states.direction, states.s_m, samples.edges, samples.edge_m, scale,
            net, params.jump_cost, params.gap_cost,
        )  # fmt: skip
        sweeps = LAST_SWEEPS if last else SWEEPS
        probability = beliefs(states.offset, np.exp(-states.cost), samples.edges, offset, pair, sweeps)
        if not last:
            shift, sigma = displacement(samples, states, probability)
    return Posterior(states, probability, shift, sigma)
