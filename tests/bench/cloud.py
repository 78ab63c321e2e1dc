"""A cloud of any size, tiled and warped, in a process of its own: points a second, memory, input and output apart.

FLEXMAP_BENCH_POINTS sets the number of points (20 million when unset). The warp is a pose graph's along 2 km of road.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from flexmap_tasks.config import PcdParams, PointCloudParams
from flexmap_tasks.engine.execute import Engine
from flexmap_tasks.engine.graph import Graph, Ref, SourceRef
from flexmap_tasks.formats.artifacts import encode
from flexmap_tasks.georeferencing.cloud import merge_tile, tile_extent, warp_tile
from flexmap_tasks.ingest.point_cloud import ingest_point_cloud
from flexmap_tasks.model.alignment import RigidMotion, Warp
from flexmap_tasks.model.bend import Bend
from flexmap_tasks.store.artifact import Artifact
from flexmap_tasks.store.store import Store
from tests.bench.measure import show

POINTS = int(os.environ.get("FLEXMAP_BENCH_POINTS", "20000000"))
CHUNK = 1_000_000
ROAD_M, CORRIDOR_M = 2_000.0, 30.0
MEMORY_GOAL_GB = 4.0


def run() -> None:
    """Tile, warp and write a cloud; what reading and writing alone cost beside it."""
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as folder:
        command = [sys.executable, "-m", "tests.bench.cloud", folder, str(POINTS)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    found: dict[str, float] = json.loads(done.stdout)
    million = POINTS / 1e6

    def row(name: str, what: str) -> tuple[str, str, str]:
        wall, cpu = found[f"{name}_wall_s"], found[f"{name}_cpu_s"]
        return what, f"{wall:.1f} s on the clock, {cpu:.1f} s CPU = {million / max(cpu, 1e-9):.1f} Mpt/s", ""

    show(
        f"A cloud of {million:.0f} million points (x y z intensity ring), tiled and warped",
        [
            row("tile", "read, tiled, stored as Parquet"),
            row("warp", "warped and cut, stored"),
            row("merge", "merged into PCD tiles, stored"),
            row("read", "beside it: reading the file alone"),
            row("write", "beside it: writing as many bytes as the store holds, without sync"),
            ("tiles of the SLAM frame, of the map", f"{found['tiles_in']:.0f}, {found['tiles_out']:.0f}", ""),
            ("store", f"{found['store_gb']:.2f} GB for {found['cloud_gb']:.2f} GB of PCD", ""),
            ("memory at most", f"{found['peak_gb']:.2f} GB", f"under {MEMORY_GOAL_GB:g} GB"),
        ],
    )


def _chunks(points: int) -> Any:
    """Points along the road, in the order a car drives it."""
    kind = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2")])
    rng = np.random.default_rng(1)
    for first in range(0, points, CHUNK):
        n = min(CHUNK, points - first)
        out = np.empty(n, kind)
        out["x"] = (first + np.arange(n)) / points * ROAD_M + rng.normal(0, 10, n)
        out["y"] = rng.uniform(-CORRIDOR_M, CORRIDOR_M, n)
        out["z"], out["ring"] = rng.normal(0, 1, n), rng.integers(0, 64, n)
        out["intensity"] = rng.uniform(0, 255, n)
        yield out


def _write_cloud(path: Path, points: int) -> None:
    with path.open("wb") as file:
        file.write(
            f"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity ring\nSIZE 4 4 4 4 2\nTYPE F F F F U\nCOUNT 1 1 1 1 1\n"
            f"WIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA binary\n".encode()
        )
        for chunk in _chunks(points):
            file.write(chunk.tobytes())


def _warp() -> Warp:
    """A bend through poses every metre that drift off by some metres, turn and are scaled."""

    s = np.arange(-50.0, ROAD_M + 50.0)
    n, still = len(s), RigidMotion(np.eye(2), np.zeros(2), 1.0, 1.0, 0.0)
    before = np.column_stack([s, np.zeros(n)])
    drift = np.column_stack([0.5 * np.sin(s / 90), 3.0 * np.sin(s / 250)])
    turn = np.gradient(drift[:, 1])
    lift, sigma = 0.2 * np.sin(s / 70), np.full(n, 0.02)
    bend = Bend.level(before, before + drift, turn, np.ones(n), lift, sigma, sigma / 20, np.full(n, 15.0))
    return Warp(still, None, bend=bend)


def _child(folder: Path, points: int) -> dict[str, float]:

    file, params = folder / "cloud.pcd", PointCloudParams()
    _write_cloud(file, points)
    graph = Graph()
    tiles = graph.run(ingest_point_cloud, params, source=SourceRef(file))
    warped = graph.run_each(
        warp_tile, "tile", params, tile=tiles.field("tiles"), warp=Ref("warp", "warp"),
        narrow=lambda key, values: {"warp": values["warp"].restrict(tile_extent(key, params))},
    )  # fmt: skip
    graph.run_each(merge_tile, "parts", PcdParams(), parts=warped.transpose())
    engine, out = Engine(Store.open(str(folder / "store"))), dict[str, float]()
    files = {path: engine.store.put_blob(content) for path, content in encode(_warp(), "warp")}
    artifacts = {"warp": Artifact.of(files)}
    names = {"ingest_point_cloud": "tile", "warp_tile": "warp", "merge_tile": "merge"}
    for node in graph:
        wall, cpu = time.perf_counter(), time.process_time()
        bound = {name: engine.bind(ref, artifacts) for name, ref in node.inputs.items()}
        outcome = engine.run(node, bound)
        artifacts[node.name] = outcome.artifact
        if node.name in names:
            out[f"{names[node.name]}_wall_s"] = time.perf_counter() - wall
            out[f"{names[node.name]}_cpu_s"] = time.process_time() - cpu
            out["tiles_in" if node.name == "warp_tile" else "tiles_out"] = float(outcome.items)
    out["peak_gb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    stored = sum(f.stat().st_size for f in (folder / "store").rglob("*") if f.is_file())
    out |= {"store_gb": stored / 1e9, "cloud_gb": file.stat().st_size / 1e9}
    return out | _input_output(file, folder / "copy", stored)


def _input_output(file: Path, copy: Path, stored: int) -> dict[str, float]:
    """The same bytes read and written with nothing in between."""
    wall, cpu = time.perf_counter(), time.process_time()
    buffer = bytearray(16 << 20)
    with file.open("rb") as stream:
        while stream.readinto(buffer):
            pass
    read = time.perf_counter() - wall, time.process_time() - cpu
    wall, cpu = time.perf_counter(), time.process_time()
    with copy.open("wb") as stream:
        for _ in range(stored // len(buffer)):
            stream.write(buffer)
    write = time.perf_counter() - wall, time.process_time() - cpu
    return {"read_wall_s": read[0], "read_cpu_s": read[1], "write_wall_s": write[0], "write_cpu_s": write[1]}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_child(Path(sys.argv[1]), int(sys.argv[2]))))
