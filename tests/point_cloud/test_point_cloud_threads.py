"""Tiles are warped side by side: the same bytes whatever the number of threads, and progress told for each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pcd_writer import pcd

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

PARAMS = PointCloudParams()


def bent_road() -> Warp:
    s = np.arange(-20.0, 120.0)
    n, still = len(s), RigidMotion(np.eye(2), np.zeros(2), 1.0, 1.0, 0.0)
    before, drift = np.column_stack([s, 0 * s]), np.column_stack([0.3 * np.sin(s / 40), np.sin(s / 60)])
    sigma = np.full(n, 0.02)
    return Warp(
        still, None,
        bend=Bend.level(before, before + drift, np.gradient(drift[:, 1]), np.ones(n), 0.1 * drift[:, 0], sigma,
                  sigma / 20, np.full(n, 15.0)),
    )  # fmt: skip


def digests(folder: Path, file: Path, told: list[tuple[int, int]]) -> list[str]:
    graph = Graph()
    tiles = graph.run(ingest_point_cloud, PARAMS, source=SourceRef(file))
    warped = graph.run_each(
        warp_tile, "tile", PARAMS, tile=tiles.field("tiles"), warp=Ref("warp", "warp"),
        narrow=lambda key, values: {"warp": values["warp"].restrict(tile_extent(key, PARAMS))},
    )  # fmt: skip
    graph.run_each(merge_tile, "parts", PcdParams(), parts=warped.transpose())
    engine = Engine(Store.open(str(folder)))
    files = {path: engine.store.put_blob(content) for path, content in encode(bent_road(), "warp")}
    artifacts = {"warp": Artifact.of(files)}
    for node in graph:
        bound = {name: engine.bind(ref, artifacts) for name, ref in node.inputs.items()}
        artifacts[node.name] = engine.run(
            node, bound, lambda done, total: told.append((done, total))
        ).artifact
    return [artifact.digest for artifact in artifacts.values()]


def test_the_same_bytes_whatever_the_number_of_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(2)
    records = np.zeros(20_000, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2")])
    for name, low, high in (("x", 0, 100), ("y", -30, 30), ("z", -1, 3), ("ring", 0, 64)):
        records[name] = rng.uniform(low, high, len(records))
    (tmp_path / "cloud.pcd").write_bytes(pcd(records, "binary"))
    found = []
    for threads in (1, 8):
        monkeypatch.setattr("os.cpu_count", lambda threads=threads: threads)
        told: list[tuple[int, int]] = []
        found.append(digests(tmp_path / f"store{threads}", tmp_path / "cloud.pcd", told))
        items = {total for _, total in told}
        assert len(items) == 2, "two stages run per tile"
        for total in items:
            assert [done for done, all_ in told if all_ == total] == list(range(total + 1))
    assert found[0] == found[1]
