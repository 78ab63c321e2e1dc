"""Several recordings of one area as one map update: what runs, what is released, what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.execute import Outcome
from flexmap_tasks.engine.graph import Graph
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.engine.release import publish_release
from flexmap_tasks.errors import ConfigError
from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.formats.track_text_write import tum_text
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.report.exports import export_layers
from flexmap_tasks.report.report import report
from flexmap_tasks.store.store import Store
from tests import drives

LENGTH_M, SEED = 700.0, 6


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three drives along one way, one of them with a GNSS that stood still."""
    folder = tmp_path_factory.mktemp("drives")
    driven = drives.driven(LENGTH_M, SEED)
    for number, name in enumerate(("main", "monday", "tuesday", "still")):
        rng = np.random.default_rng(number)
        slam = driven.slam.xyz_m + rng.normal(size=driven.slam.xyz_m.shape) * 0.01
        gnss = driven.gnss.xyz_m[:, :2] + rng.normal(size=(len(driven.gnss), 2)) * 0.01
        lonlat = drives.HERE.to_lonlat_deg(gnss)
        (folder / f"{name}.tum").write_text(tum_text(driven.slam.stamp_ns, slam, driven.slam.quaternion))
        rows = lonlat[:1].repeat(50, axis=0) if name == "still" else lonlat
        (folder / f"{name}.txt").write_text("".join(f"{lat:.9f} {lon:.9f}\n" for lon, lat in rows.tolist()))
    return folder


def config(folder: Path, *names: str, more: str = "") -> FlexMapConfig:
    text = (
        "map: town\ngnss: {file: main.txt}\nslam: {file: main.tum}\nevaluation: {held_out_block_m: 0}\n"
        + more
    )
    if names:
        text += "drives:\n"
    text += "".join(
        f"- {{name: {n}, gnss: {{file: {n.lower()}.txt}}, slam: {{file: {n.lower()}.tum}}}}\n" for n in names
    )
    (folder / "town.yaml").write_text(text)
    return load_config(FlexMapConfig, folder / "town.yaml")


def graph_of(config: FlexMapConfig) -> Graph:
    graph = map_update(config)
    graph.leave_out(report, export_layers)
    return graph


def table(store: Store, graph: Graph, outcomes: dict[str, Outcome], folder: Path) -> list[dict[str, Any]]:
    artifacts = {name: o.artifact for name, o in outcomes.items()}
    actions = {name: o.key for name, o in outcomes.items()}
    release = publish_release(store, graph, artifacts, actions, folder, "town").folder
    return pq.read_table(release / "drives.parquet").to_pylist()


def ran(outcomes: dict[str, Outcome]) -> set[str]:
    return {name for name, outcome in outcomes.items() if not outcome.cached}


def test_one_more_drive_runs_its_own_stages_and_those_below_fusion(recorded: Path, tmp_path: Path) -> None:
    store = Store.open(tmp_path / "store")
    alone = run_local(store, graph_of(config(recorded)))
    assert not any("drive" in name for name in alone)
    below = {"fuse_drives", "pose_graph_warp", "align_track", "evaluate"}

    def own(name: str) -> set[str]:
        return {f"{stage}.{name}" for stage in ("ingest_gnss", "ingest_slam", "align_drive", "gather_drives")}

    first = run_local(store, graph_of(config(recorded, "monday")))
    assert ran(first) == own("monday") | below
    graph = graph_of(config(recorded, "monday", "tuesday"))
    second = run_local(store, graph)
    assert ran(second) == own("tuesday") | below
    rows = table(store, graph, second, tmp_path / "releases")
    assert [(r["drive"], r["used"]) for r in rows] == [("", True), ("monday", True), ("tuesday", True)]
    assert sum(r["weight"] for r in rows) == pytest.approx(1.0)
    assert rows[1]["common_places"] > 100
    assert rows[1]["disagreement_sigmas"] < 5
    assert ran(run_local(store, graph)) == set()
    turned = run_local(store, graph_of(config(recorded, "tuesday", "monday")))
    assert turned["fuse_drives"].artifact == second["fuse_drives"].artifact


def test_a_drive_that_cannot_be_aligned_does_not_end_the_run(recorded: Path, tmp_path: Path) -> None:
    store = Store.open(tmp_path / "store")
    graph = graph_of(config(recorded, "still"))
    rows = table(store, graph, run_local(store, graph), tmp_path / "releases")
    assert [r["used"] for r in rows] == [True, False]
    assert rows[1]["reason"].startswith("cannot be aligned: ")


@pytest.mark.parametrize(
    ("names", "more", "message"),
    [
        (("monday", "Monday"), "", "stands twice in drives"),
        (("main",), "", "drive main is the same recording as another"),
        (("../monday",), "", "String should match pattern"),
        (("monday",), "alignment: {method: rigid}\n", "drives are fused by alignment.method pose_graph"),
    ],
)
def test_drives_are_refused_clearly(recorded: Path, names: tuple[str, ...], more: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        config(recorded, *names, more=more)
