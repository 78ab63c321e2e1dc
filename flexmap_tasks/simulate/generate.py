"""A whole world, from its settings to everything that is known about it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.simulate.chance import stream
from flexmap_tasks.simulate.drive import Drive, make_drive
from flexmap_tasks.simulate.frame import TownFrame
from flexmap_tasks.simulate.gnss import GnssMessages, make_gnss
from flexmap_tasks.simulate.hd_map import HdMap, draw_map
from flexmap_tasks.simulate.lanes import LaneNetwork, make_lanes
from flexmap_tasks.simulate.network import make_network
from flexmap_tasks.simulate.osm import OsmTown, make_osm
from flexmap_tasks.simulate.roads import Draft, Network
from flexmap_tasks.simulate.slam import SlamTrack, make_slam
from flexmap_tasks.simulate.world import World

BOX_MARGIN_M = 60.0
CANDIDATES_PER_PICK, LEAST_APART_M = 4, 15.0


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """Everything about a world except its points, which are made as they are written.

    osm_later : the extract of the second date, None when the settings ask for one date
    """

    world: World
    frame: TownFrame
    network: Network
    lanes: LaneNetwork
    drive: Drive
    gnss: GnssMessages
    slam: SlamTrack
    hd_map: HdMap
    osm: OsmTown
    osm_later: OsmTown | None


def simulate(world: World, topology: Draft | None = None) -> Simulation:
    """Build the world; the same settings give the same world.

    topology : roads of a real extract, for layout "osm" (see `topology.read_topology`)
    Raises ConfigError when the roads have no loop to drive on.
    """
    place = world.place
    frame = TownFrame.at(place.lat_deg, place.lon_deg, place.height_m)
    network = make_network(world, topology)
    lanes = make_lanes(network, world.hd_map.vertex_spacing_m, world.hd_map.shoulders)
    drive = make_drive(world, lanes)
    frame = frame.anchored(drive.xyz_m[0])
    gnss = make_gnss(world, drive)
    low, high = lanes.xyz[:, :2].min(axis=0) - BOX_MARGIN_M, lanes.xyz[:, :2].max(axis=0) + BOX_MARGIN_M
    slam = make_slam(world, drive, low, high)
    hd_map = draw_map(world, lanes, drive, slam)
    osm, later = make_osm(world, network, frame)
    return Simulation(world, frame, network, lanes, drive, gnss, slam, hd_map, osm, later)


def picked_rows(simulation: Simulation) -> Ints:
    """Poses a person would pick as control points: at bends, spread over the town, no two at one place."""
    slam, count = simulation.slam, simulation.world.control_points.count
    step = np.gradient(slam.s_m)
    bend = np.where(step > 0.05, np.abs(np.gradient(slam.true_yaw_rad)) / np.maximum(step, 0.05), -1.0)
    edges = np.linspace(0.0, slam.s_m[-1] + 1e-6, CANDIDATES_PER_PICK * count + 1)
    parts = [np.flatnonzero((slam.s_m >= a) & (slam.s_m < b)) for a, b in pairwise(edges)]
    rows = np.array([part[np.argmax(bend[part])] for part in parts if len(part)], dtype=np.int64)
    if not len(rows):
        return rows
    xy = slam.true_xyz_m[rows, :2]
    picked = [int(np.argmax(bend[rows]))]
    while len(picked) < count:
        distance = np.min([np.hypot(*(xy - xy[k]).T) for k in picked], axis=0)
        if distance.max() < LEAST_APART_M:
            break
        picked.append(int(np.argmax(distance)))
    return np.sort(rows[picked])


def picked_targets(simulation: Simulation, rows: Ints) -> Floats:
    """(k, 2) lon, lat of the true places of the picked poses, as well as a person can point at them."""
    rng = stream(simulation.world.seed, "control_points")
    xyz = simulation.slam.true_xyz_m[rows].copy()
    xyz[:, :2] += rng.normal(0.0, 1.0, (len(rows), 2)) * simulation.world.control_points.sigma_m
    return simulation.frame.geodetic(xyz)[:, :2]
