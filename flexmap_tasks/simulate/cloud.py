"""The lidar's view: ground, kerbs, facades and poles along the drawn roads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.simulate.chance import stream
from flexmap_tasks.simulate.roads import Network
from flexmap_tasks.simulate.slam import SlamTrack
from flexmap_tasks.simulate.world import World

CHUNK = 1_000_000
KERB_HEIGHT_M, POLE_EVERY_M, POLE_HEIGHT_M, POLE_RADIUS_M = 0.12, 30.0, 6.0, 0.12
SHARES = np.array([0.62, 0.12, 0.22, 0.04])
"""Of the points on ground, kerb, facade and pole."""
INTENSITY = np.array([20.0, 60.0, 110.0, 180.0])


@dataclass(frozen=True, slots=True, eq=False)
class CloudChunk:
    """Points in the order of the file.

    first : number of the first one; town_xyz_m, slam_xyz_m : (n, 3); intensity : (n,) float32
    """

    first: int
    town_xyz_m: Floats
    slam_xyz_m: Floats
    intensity: np.ndarray[tuple[int], np.dtype[np.float32]]


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """Segments of all roads that are seen, end to end, for drawing points by length."""

    start: Floats
    step: Floats
    edge: Floats
    half_width: Floats

    @classmethod
    def of(cls, network: Network, roads: list[int]) -> Surfaces:
        """The surfaces beside the given roads."""
        starts, steps, half = [], [], []
        for i in roads:
            xyz = network.roads[i].xyz
            starts.append(xyz[:-1])
            steps.append(np.diff(xyz, axis=0))
            half.append(np.full(len(xyz) - 1, network.roads[i].width_m / 2))
        step = np.vstack(steps)
        length = np.hypot(*step[:, :2].T)
        edge = np.concatenate([[0.0], np.cumsum(length)])
        return cls(np.vstack(starts), step, edge, np.concatenate(half))

    def sample(self, rng: np.random.Generator, count: int, corridor_m: float) -> tuple[Floats, Ints]:
        """Places (n, 3) on the surfaces, and which surface each lies on."""
        surface = np.searchsorted(np.cumsum(SHARES)[:-1], rng.uniform(size=count)).astype(np.int64)
        s = rng.uniform(0.0, self.edge[-1], count)
        pole = surface == 3
        s[pole] = np.minimum(np.round(s[pole] / POLE_EVERY_M) * POLE_EVERY_M, self.edge[-1] - 1e-6)
        row = np.clip(np.searchsorted(self.edge, s, side="right") - 1, 0, len(self.start) - 1)
        length = self.edge[row + 1] - self.edge[row]
        share = (s - self.edge[row]) / np.maximum(length, 1e-9)
        xyz = self.start[row] + share[:, None] * self.step[row]
        normal = np.column_stack([-self.step[row, 1], self.step[row, 0]]) / np.maximum(length, 1e-9)[:, None]
        side = np.where(rng.uniform(size=count) < 0.5, -1.0, 1.0)
        half, across, up = self.half_width[row], rng.uniform(size=count), rng.uniform(size=count)
        off = np.select(
            [surface == 0, surface == 1, surface == 2],
            [across * corridor_m, half + 0.3, half + 5.0 + 2.0 * np.sin(np.floor(s / 15.0))],
            half + 1.0,
        )
        height = np.select(
            [surface == 0, surface == 1, surface == 2],
            [
                np.where(off > half + 0.3, KERB_HEIGHT_M, 0.0),
                up * KERB_HEIGHT_M,
                up * (8.0 + 3.0 * np.cos(np.floor(s / 15.0))),
            ],
            up * POLE_HEIGHT_M,
        )
        xyz[:, :2] += normal * (side * off)[:, None]
        xyz[:, 2] += height
        turn = 2 * np.pi * across[pole]
        xyz[pole, :2] += POLE_RADIUS_M * np.column_stack([np.cos(turn), np.sin(turn)])
        return xyz, surface


def make_cloud(world: World, network: Network, roads: list[int], slam: SlamTrack) -> Iterator[CloudChunk]:
    """The point cloud map in chunks, so that any size fits into memory; same world, same points."""
    surfaces = Surfaces.of(network, roads)
    rng = stream(world.seed, "cloud")
    for first in range(0, world.cloud.points, CHUNK):
        count = min(CHUNK, world.cloud.points - first)
        town, surface = surfaces.sample(rng, count, world.cloud.corridor_m)
        town += rng.normal(0.0, 1.0, town.shape) * world.cloud.noise_m
        glow = (INTENSITY[surface] + rng.normal(0.0, 8.0, count)).clip(0, 255).astype(np.float32)
        yield CloudChunk(first, town, slam.to_slam(town), glow)
