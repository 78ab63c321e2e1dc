"""The whole paper on the original's own route: figures, harm, and what a rerun computes."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.execute import Engine, Outcome
from flexmap_tasks.engine.finished import watch
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.engine.plan import make_plan
from flexmap_tasks.engine.runs import read_last_run
from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.store.store import Store
from flows.finish import finish_run

PROJECT = Path(__file__).resolve().parents[2]
CONFIG = PROJECT / "configs" / "garching.yaml"
FROM_CONTROL_POINTS_DOWN = {
    "control_points", "rubber_sheet", "judge_points", "align_track", "georeference_map", "collapse", "match", "transfer",
    "georeference", "evaluate", "report", "export_layers", "check_bundle", "find_gaps",
}  # fmt: skip


@pytest.fixture(scope="module")
def inputs(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copies of the inputs that a test may edit."""
    folder = tmp_path_factory.mktemp("garching")
    for name in ("route_1_GPS.txt", "route1_pose_kitti.txt", "lanelet2_route_1.osm", "osm_2023.osm",
                 "control_points_peer.csv"):  # fmt: skip
        shutil.copyfile(shared_data / "garching" / name, folder / name)
    return folder


@pytest.fixture
def config(inputs: Path) -> FlexMapConfig:
    return load_config(FlexMapConfig, CONFIG, overrides(inputs))


def overrides(folder: Path) -> list[str]:
    return [
        f"gnss.file={folder / 'route_1_GPS.txt'}",
        f"slam.file={folder / 'route1_pose_kitti.txt'}",
        f"lanelet_map.file={folder / 'lanelet2_route_1.osm'}",
        f"osm.file={folder / 'osm_2023.osm'}",
        f"alignment.control_points_file={folder / 'control_points_peer.csv'}",
    ]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return Store.open(tmp_path_factory.mktemp("store"))


def run(store: Store, config: FlexMapConfig) -> tuple[dict[str, Outcome], Path]:
    graph = map_update(config)
    watched = watch(graph)
    outcomes = run_local(store, graph)
    return outcomes, finish_run(store, graph, outcomes, config, watched).folder


def executed(outcomes: dict[str, Outcome]) -> set[str]:
    return {name for name, o in outcomes.items() if not o.cached}


def states(store: Store, config: FlexMapConfig) -> dict[str, str]:
    plan = make_plan(Engine(store), map_update(config), read_last_run(store, config.map))
    return {s.node.name: s.state for s in plan.steps}


def edited(file: Path, edit: Callable[[str], str]) -> Callable[[], None]:
    """Edit a file; the returned function puts it back."""
    before = file.read_text()
    after = edit(before)
    assert after != before
    file.write_text(after)
    return lambda: file.write_text(before) and None


def test_figures_of_the_paper(store: Store, config: FlexMapConfig) -> None:
    _, release = run(store, config)
    measures = json.loads((release / "quality.json").read_text())
    measures = measures["measures"] if isinstance(measures, dict) else measures
    quality: dict[str, Any] = {m["name"]: m["value"] for m in measures}
    # limits: the peer measured the same way has 0.963, 1.596, 1.864; the paper 1.08, 1.61, 1.93
    assert quality["deviation_after_all_mean"] <= 1.00
    assert quality["deviation_after_all_std"] <= 1.61
    assert quality["deviation_after_all_rmse"] <= 1.90
    assert quality["match_rate"] >= 0.83
    assert quality["match_rate_by_length"] >= 0.88


def test_the_finished_map_is_unharmed(store: Store, config: FlexMapConfig, judge: Path, inputs: Path) -> None:
    lanelet2 = pytest.importorskip("lanelet2", reason="the lanelet2 wheel has no build for this platform")
    _, release = run(store, config)
    before, after = inputs / "lanelet2_route_1.osm", release / "lanelet2_map.osm"
    verdict = subprocess.run(
        [sys.executable, str(judge), "--moved", str(before), str(after)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert verdict.stdout.strip().splitlines()[-1] == "total harm: 0", verdict.stdout
    projector = lanelet2.projection.UtmProjector(lanelet2.io.Origin(48.264, 11.669))
    maps = [lanelet2.io.loadRobust(str(m), projector) for m in (before, after)]
    assert maps[1][1] == []
    elements = [sorted(e.id for e in m.regulatoryElementLayer) for m, _ in maps]
    assert elements[0] == elements[1]


def test_a_second_run_executes_nothing_and_starts_no_flow(
    store: Store, config: FlexMapConfig, inputs: Path
) -> None:
    run(store, config)
    again, _ = run(store, config)
    assert executed(again) == set()
    command = [sys.executable, "-m", "flows.cli", "run", str(CONFIG), "--store", str(store.backend.root)]
    for override in overrides(inputs):
        command += ["--set", override]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=PROJECT)
    assert "nothing changed" in done.stdout
    assert "no flow was started" in done.stdout
    assert "prefect" not in done.stderr.lower()


def test_a_moved_control_point_reruns_exactly_what_is_below(
    store: Store, config: FlexMapConfig, inputs: Path
) -> None:
    run(store, config)
    restore = edited(inputs / "control_points_peer.csv", lambda t: t.replace("48.264158129", "48.264162129"))
    planned = states(store, config)
    outcomes, _ = run(store, config)
    restore()
    below = FROM_CONTROL_POINTS_DOWN & set(planned)
    assert executed(outcomes) == below
    assert {name for name, state in planned.items() if state != "cached"} == below
    assert planned["control_points"] == "run"
    assert {planned[name] for name in below - {"control_points"}} == {"depends"}


def test_an_osm_edit_off_the_roads_is_cut_off_early(
    store: Store, config: FlexMapConfig, inputs: Path
) -> None:
    run(store, config)

    def edit(text: str) -> str:
        return re.sub(r"(<tag k=\"building\" v=\")yes", r"\g<1>garage", text, count=1)

    restore = edited(inputs / "osm_2023.osm", edit)
    planned = states(store, config)
    outcomes, _ = run(store, config)
    restore()
    assert planned["ingest_osm_roads"] == "run"
    assert planned["match"] == "depends"
    assert executed(outcomes) == {"ingest_osm_roads"}


def permuted_ids(text: str) -> tuple[str, dict[int, int]]:
    """The same map under other ids, and new id by old; every element keeps its place in the file."""
    ids = sorted({int(i) for i in re.findall(r'(?:<node|<way|<relation) id="(\d+)"', text)})
    shuffled = ids.copy()
    random.Random(3).shuffle(shuffled)
    new = dict(zip(ids, shuffled, strict=True))
    return re.sub(r' (id|ref)="(\d+)"', lambda m: f' {m[1]}="{new[int(m[2])]}"', text), new


def test_ids_do_not_matter(store: Store, config: FlexMapConfig, inputs: Path) -> None:
    _, release = run(store, config)
    mapping: dict[int, int] = {}

    def edit(text: str) -> str:
        changed, new = permuted_ids(text)
        mapping.update(new)
        return changed

    restore = edited(inputs / "lanelet2_route_1.osm", edit)
    _, other = run(store, config)
    restore()

    def rows(folder: Path, new: dict[int, int]) -> list[tuple[Any, ...]]:
        table = pq.read_table(folder / "matches.parquet").to_pylist()
        return sorted(
            (new.get(r["lanelet_id"], r["lanelet_id"]), round(r["s_from_m"], 6), round(r["s_to_m"], 6), r["way_id"],
             r["direction"], r["decision"], round(r["score"], 9))
            for r in table
        )  # fmt: skip

    assert rows(release, mapping) == rows(other, {})


def released(folder: Path) -> dict[str, bytes]:
    return {
        p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }


def test_killed_runs_end_with_the_same_bytes(
    tmp_path: Path, store: Store, config: FlexMapConfig, inputs: Path
) -> None:
    _, undisturbed = run(store, config)
    command = [
        sys.executable,
        "-m",
        "flows.cli",
        "run",
        str(CONFIG),
        "--no-prefect",
        "--store",
        str(tmp_path / "s"),
    ]
    for override in overrides(inputs):
        command += ["--set", override]
    started = time.perf_counter()
    rng = random.Random(5)
    for _ in range(6):
        process = subprocess.Popen(command, cwd=PROJECT, stdout=subprocess.DEVNULL)
        time.sleep(rng.uniform(1.0, 3.5))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    assert time.perf_counter() - started > 6
    subprocess.run(command, cwd=PROJECT, stdout=subprocess.DEVNULL, check=True)
    folder = (tmp_path / "s" / "releases" / "garching" / "latest").resolve()
    assert released(folder) == released(undisturbed)


def test_the_map_stays_where_slam_is_the_master(store: Store, config: FlexMapConfig, inputs: Path) -> None:
    alignment = config.alignment.model_copy(update={"master": "slam"})
    _, release = run(store, config.model_copy(update={"alignment": alignment, "map": "garching-slam"}))
    assert "projector_type: Local\n" in (release / "map_projector_info.yaml").read_text()
    before = (inputs / "lanelet2_route_1.osm").read_text()
    after = (release / "lanelet2_map.osm").read_text()
    node = '<node id="93" lat="47.84819088742739" lon="10.33850333544957">'
    assert node in before
    assert node in after
    quality = {m["name"]: m["value"] for m in json.loads((release / "quality.json").read_text())["measures"]}
    assert quality["match_rate"] >= 0.83


def test_tracks_alone_are_enough(store: Store, config: FlexMapConfig) -> None:
    bare = config.model_copy(update={"lanelet_map": None, "osm": None, "map": "garching-tracks"})
    _, release = run(store, bare)
    assert (release / "slam_track_after.parquet").is_file()
    assert not (release / "lanelet2_map.osm").exists()
