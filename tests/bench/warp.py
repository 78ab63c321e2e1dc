"""Points through the warp: rigid, rubber sheet and pose graph, beside scipy's interpolator and open3d's transform."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from open3d import core, t
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import cKDTree

from flexmap_tasks.geometry import blend
from flexmap_tasks.geometry.triangulation import delaunay
from flexmap_tasks.model.alignment import Extent, RigidMotion, RubberSheet, Warp
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.bend import Bend
from tests.bench.measure import best_cpu_s, show

POINTS, SIDE_M, TILE_M, SWATHE_M = 4_000_000, 1000.0, 100.0, 2.0
STILL = RigidMotion(np.eye(2), np.zeros(2), 1.0, 1.0, 0.0)


def run() -> None:
    """Million points a second of one core, output included; every row says in which order the points come."""
    rng = np.random.default_rng(1)
    scattered = rng.uniform(0, SIDE_M, (POINTS, 3))
    tile, swathe = np.floor(scattered[:, :2] / TILE_M), np.floor(scattered[:, 1] / SWATHE_M)
    orders = {
        "in any order": scattered,
        "tile by tile": scattered[np.lexsort([tile[:, 1], tile[:, 0]])],
        "in scan order": scattered[np.lexsort([scattered[:, 0], swathe])],
    }
    sheet, bend = _sheet(rng), _bend(rng)
    rows = []
    for order, xyz in orders.items():
        rigid, transform = _rate(Warp(STILL, None).apply, xyz), _rate(_transform(xyz), xyz)
        by_sheet, by_bend = _rate(sheet.apply, xyz), _rate(bend.apply, xyz)
        interpolator = _rate(_interpolator(sheet), xyz[: POINTS // 8])
        rows += [
            (f"rigid, {order}", f"{rigid:.0f} Mpt/s", ""),
            ("  open3d's transform, 32 bits in place", f"{transform:.0f} Mpt/s", ""),
            (f"sheet of 54 vertices, {order}", f"{by_sheet:.0f} Mpt/s", "at least 100 Mpt/s"),
            ("  scipy's interpolator", f"{interpolator:.1f} Mpt/s", ""),
            ("  the sheet beside it", f"{by_sheet / interpolator:.1f} times", "at least 30 times"),
            (f"pose graph of 1000 poses, {order}", f"{by_bend:.0f} Mpt/s", "at least 50 Mpt/s"),
        ]
    show(f"{POINTS / 1e6:.0f} million points through the warp (CPU, one core)", rows)
    _tile(sheet, orders["tile by tile"])
    _lattice()


def _tile(sheet: Warp, xyz: Floats) -> None:
    """What a stage pays for one tile: its part of the sheet, the grid over it, and its points."""
    tile = xyz[(xyz[:, :2] // TILE_M == SIDE_M // TILE_M // 2).all(axis=1)]
    low = tile[:, :2].min(axis=0)
    box = Extent(low[0], low[1], *tile[:, :2].max(axis=0))
    part = sheet.restrict(box)
    ready, fresh = best_cpu_s(lambda: part.apply(tile)), best_cpu_s(lambda: sheet.restrict(box).apply(tile))
    show(
        f"A tile of {len(tile):,} points through its part of the sheet (CPU, one core)",
        [
            ("moved", f"{1000 * ready:.2f} ms = {len(tile) / ready / 1e6:.0f} Mpt/s", ""),
            ("cut out of the sheet, made ready, moved", f"{1000 * fresh:.2f} ms", ""),
        ],
    )


def _rate(work: Callable[[Floats], object], xyz: Floats) -> float:
    return len(xyz) / best_cpu_s(lambda: work(xyz)) / 1e6


def _sheet(rng: np.random.Generator) -> Warp:
    corners = np.array([[-1, -1], [2, -1], [2, 2], [-1, 2]]) * SIDE_M
    source = np.concatenate([rng.uniform(0, SIDE_M, (50, 2)), corners])
    target = source + rng.uniform(-0.5, 0.5, source.shape)
    return Warp(STILL, RubberSheet(source, target, delaunay(source), np.zeros(2)))


def _bend(rng: np.random.Generator, poses: int = 1000) -> Warp:
    """A drive to and fro over the square, every pose with a correction of its own."""
    along = np.linspace(0, 10 * SIDE_M, poses)
    x = np.abs((along + SIDE_M) % (2 * SIDE_M) - SIDE_M)
    source = np.column_stack([x, 100 * np.floor(along / SIDE_M) + 50])
    shift = np.cumsum(rng.normal(0, 0.02, (poses, 2)), axis=0)
    one = np.ones(poses)
    return Warp(
        STILL,
        None,
        bend=Bend.level(source, source + shift, 0.001 * one, one, 0 * one, one, 0.001 * one, 8 * one),
    )


def _interpolator(warp: Warp) -> Callable[[Floats], object]:
    sheet = warp.sheet
    assert sheet is not None
    by_scipy = LinearNDInterpolator(sheet.source_xy_m, sheet.target_xy_m)
    return lambda xyz: by_scipy(xyz[:, :2])


def _transform(xyz: Floats) -> Callable[[Floats], object]:
    """open3d's transform, in place, of a cloud that it holds already in its own 32 bits: no output to allocate."""
    cloud = t.geometry.PointCloud(core.Tensor(xyz.astype(np.float32)))
    motion = core.Tensor(np.eye(4))
    return lambda _: cloud.transform(motion)


def _lattice() -> None:
    """What the lattice costs before the first point moves; it grows with the area that is asked for."""
    rows = []
    for poses in (1000, 4000):
        bend = _bend(np.random.default_rng(1), poses).bend
        assert bend is not None
        motions, tree = bend.motions(), cKDTree(bend.source_xy_m)
        cpu = best_cpu_s(lambda m=motions, t=tree: [blend.block(m, t, i, 3) for i in range(30)]) / 30
        size = f"{blend.BLOCK_M:.0f} m x {blend.BLOCK_M:.0f} m"
        rows.append((f"{poses} poses on 10 km", f"{1000 * cpu:.2f} ms a block of {size}", ""))
    show("Lattice of a pose graph's warp", rows)
