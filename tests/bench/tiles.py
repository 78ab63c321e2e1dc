"""One control point moved under a tiled cloud: which tiles are made anew, and what it costs beside a cold run."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from flexmap_tasks.config import FlexMapConfig, PointCloudParams
from flexmap_tasks.engine.execute import Engine, Outcome
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.georeferencing.cloud import tile_extent
from flexmap_tasks.model.alignment import Warp
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.simulate.world import World
from flexmap_tasks.simulate.write import write_world
from flexmap_tasks.store.store import Store
from tests.bench.measure import PROJECT, show

TILE_M, POINTS, PAIRS = 35, 10_000_000, 100
MOVED_M, METRES_PER_DEG = 0.10, 111_200.0
NO_CHANGE_M = 0.001
WORLD = {
    "network": {"blocks_x": 4, "blocks_y": 4},
    "drive": {"length_m": 5000.0},
    "cloud": {"points": POINTS},
    "control_points": {"count": PAIRS},
}


def run() -> None:
    """The pair in the middle of the file moved by ten centimetres, for the sheet and the pose graph."""
    with tempfile.TemporaryDirectory(prefix="flexmap-bench-") as name:
        folder = Path(name)
        write_world(load_config(World, PROJECT / "configs/worlds/small_town.yaml").changed(**WORLD), folder)
        rows: list[tuple[str, str, str]] = []
        for method in ("rubber_sheet", "pose_graph"):
            rows += _moved(folder, method)
    show(
        f"One of {PAIRS} control points moved by {100 * MOVED_M:.0f} cm, {POINTS / 1e6:.0f} million points",
        rows,
    )


def _moved(folder: Path, method: str) -> list[tuple[str, str, str]]:
    config = FlexMapConfig.model_validate(
        {
            "map": "town",
            "gnss": {"file": folder / "recording.mcap"},
            "slam": {"file": folder / "recording.mcap"},
            "point_cloud": {"file": folder / "pointcloud_map.pcd", "tile_size_m": TILE_M},
            "alignment": {"method": method, "control_points_file": folder / "control_points.csv"},
            "evaluation": {"held_out_block_m": 0},
        }
    )
    pairs = folder / "control_points.csv"
    text = pairs.read_text()
    try:
        return _figures(config, text)
    finally:
        pairs.write_text(text)


def _figures(config: FlexMapConfig, text: str) -> list[tuple[str, str, str]]:
    """The best of two cold runs, and of two reruns after the pair moved one way and the other."""
    pairs, method = config.alignment.control_points_file, config.alignment.method
    assert pairs is not None
    cold, warm = [], []
    for shift_m in (MOVED_M, -MOVED_M):
        with tempfile.TemporaryDirectory(prefix="flexmap-bench-") as name:
            engine = Engine(Store.open(name))
            pairs.write_text(text)
            seconds, outcomes = _timed(engine.store, config)
            cold.append(seconds)
            before = _warp(engine, config, outcomes)
            pairs.write_text(_with_a_pair_moved(text, shift_m))
            seconds, outcomes = _timed(engine.store, config)
            warm.append(seconds)
            after = _warp(engine, config, outcomes)
    tiles, merged = outcomes["warp_tile"], outcomes["merge_tile"]
    moved = sum(
        _apart_m(before, after, key) > NO_CHANGE_M for key in tiles.artifact.sub("warped_tile/").items()
    )
    return [
        (f"{method}: tiles moved by over a millimetre", f"{moved} of {tiles.items}", ""),
        ("  tiles warped anew", f"{tiles.computed} of {tiles.items}", f"{moved}"),
        ("  map tiles written anew", f"{merged.computed} of {merged.items}", ""),
        ("  a run into an empty store", f"{min(cold):.2f} s CPU", ""),
        ("  the rerun", f"{min(warm):.2f} s CPU", ""),
        ("  the rerun beside it", f"{min(warm) / min(cold):.1%}", "at most 10 %"),
    ]


def _timed(store: Store, config: FlexMapConfig) -> tuple[float, dict[str, Outcome]]:
    clock = time.process_time()
    outcomes = run_local(store, map_update(config))
    return time.process_time() - clock, dict(outcomes)


def _with_a_pair_moved(text: str, shift_m: float) -> str:
    lines = text.splitlines()
    k = len(lines) // 2
    cells = lines[k].split(",")
    cells[1] = f"{float(cells[1]) + shift_m / METRES_PER_DEG:.10f}"
    return "\n".join([*lines[:k], ",".join(cells), *lines[k + 1 :], ""])


def _warp(engine: Engine, config: FlexMapConfig, outcomes: Mapping[str, Outcome]) -> Warp:
    artifacts = {name: outcome.artifact for name, outcome in outcomes.items()}
    warp: Warp = engine.load(
        engine.bind(map_update(config).nodes["warp_tile"].inputs["warp"], artifacts), Warp
    )
    return warp


def _apart_m(before: Warp, after: Warp, key: str) -> float:
    """The most by which any of 25 places in a tile lies elsewhere."""
    box = tile_extent(key, PointCloudParams(tile_size_m=TILE_M))
    x, y = np.linspace(box.x_min_m, box.x_max_m, 5), np.linspace(box.y_min_m, box.y_max_m, 5)
    places = np.array([(a, b, 0.0) for a in x for b in y])
    apart = before.apply(places) - after.apply(places)
    return float(np.hypot(apart[:, 0], apart[:, 1]).max())
