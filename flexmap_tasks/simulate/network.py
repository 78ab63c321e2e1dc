"""From the settings to a finished network with heights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.simulate import layouts, lines
from flexmap_tasks.simulate.chance import SmoothField, stream
from flexmap_tasks.simulate.features import build_features
from flexmap_tasks.simulate.roads import Draft, Network, Road
from flexmap_tasks.simulate.world import World

CURVED = ("roundabout", "island", "slip", "ramp", "cul_de_sac")
"""Roles whose lines bend sharply and need closer vertices."""


def make_network(world: World, draft: Draft | None = None) -> Network:
    """The town's roads; `draft` brings the roads of a real extract, drawn for traffic on the right."""
    plan = world.network
    if draft is None:
        draft = Draft()
        layout = {"grid": layouts.grid, "radial": layouts.radial, "organic": layouts.organic}
        layout.get(plan.layout, layouts.motorway)(draft, plan, stream(world.seed, "layout"))
    build_features(draft, plan, lambda name: stream(world.seed, name))
    side = 1 if world.driving_side == "right" else -1
    node_xy, roads = draft.finished(side)
    middle = node_xy.mean(axis=0) if plan.layout != "osm" else np.zeros(2)
    node_xy = node_xy - middle
    ground = SmoothField(stream(world.seed, "relief"), plan.relief_length_m, 1)
    raised = [_raised(replace(r, xyz=r.xyz - middle), ground, world) for r in roads]
    node_xyz = np.column_stack([node_xy, _height(node_xy, ground, plan.relief_m)])
    return _equipped(Network(node_xyz, tuple(raised), side), world)


def _height(xy: Floats, ground: SmoothField, relief_m: float) -> Floats:
    return np.asarray(ground(xy)[:, 0] * relief_m) if relief_m else np.zeros(len(xy))


def _raised(road: Road, ground: SmoothField, world: World) -> Road:
    """The road with even vertices and heights; a bridge rises from and falls to its ends."""
    spacing = world.hd_map.vertex_spacing_m
    xy = lines.resample(road.xyz, min(spacing, 2.5) if road.role in CURVED else spacing)
    z = _height(xy, ground, world.network.relief_m)
    if road.level:
        s = lines.along(xy)
        ease = np.clip(np.minimum(s, s[-1] - s) / (0.38 * s[-1]), 0.0, 1.0)
        z = z + road.level * world.network.clearance_m * ease * ease * (3 - 2 * ease)
    return replace(road, xyz=np.column_stack([xy, z]))


def _equipped(network: Network, world: World) -> Network:
    """Signals at the busiest junctions, stop signs and crosswalks at others."""
    plan = world.network
    arms = network.arms()
    plain = [
        n
        for n, here in enumerate(arms)
        if len(here) >= 3 and all(network.roads[i].role in ("", "dual", "overpass") for i, _ in here)
    ]
    lanes = {n: sum(network.roads[i].forward + network.roads[i].backward for i, _ in arms[n]) for n in plain}
    rank = sorted(plain, key=lambda n: (-lanes[n], float(np.hypot(*network.node_xyz[n, :2])), n))
    signals = frozenset(rank[: plan.signals])
    stops = frozenset(rank[plan.signals : plan.signals + plan.stop_signs])
    crossings = frozenset(rank[: plan.crosswalks])
    return replace(network, signal_nodes=signals, stop_nodes=stops, crosswalk_nodes=crossings)
