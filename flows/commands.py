"""What the commands do."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, cast

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.execute import Engine, Outcome
from flexmap_tasks.engine.fingerprint import code_fingerprint
from flexmap_tasks.engine.graph import Graph
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.engine.plan import Plan, make_plan, read_last_run
from flexmap_tasks.engine.release import Release
from flexmap_tasks.formats.config_defaults import defaults_yaml
from flexmap_tasks.formats.config_file import dump_config, load_config
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.simulate.world import World
from flexmap_tasks.simulate.write import write_world
from flexmap_tasks.store.artifact import seal
from flexmap_tasks.store.store import Store
from flows import console
from flows.finish import finish_run

PROJECT = Path(__file__).resolve().parents[1]

PREFECT_SETTINGS = {
    "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "120",  # a cold server needs 10 to 35 s
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    "DO_NOT_TRACK": "1",
}


def run(file: Path, overrides: Iterable[str], store: Path, *, through_prefect: bool) -> None:
    """Plan, run what has to run, publish."""
    run_config(load_config(FlexMapConfig, file, overrides), store, through_prefect=through_prefect)


def run_config(config: FlexMapConfig, store_path: Path, *, through_prefect: bool) -> Release:
    """The same for settings already read."""
    clock = time.perf_counter()
    store = Store.open(store_path)
    store.check_writable()
    graph = map_update(config)
    plan_ = make_plan(Engine(store), graph, read_last_run(store, config.map))
    if plan_.all_cached:
        outcomes = {
            s.node.name: Outcome(
                s.node.name, s.record.key, s.record.output, cached=True, seconds=s.record.seconds
            )
            for s in plan_.steps
            if s.record is not None
        }
        release = finish_run(store, graph, outcomes, config.map)
        console.say(
            f"{config.map}: nothing changed, all {len(outcomes)} stages are cached; no flow was started"
        )
    elif through_prefect:
        release = _run_prefect(config, store_path, plan_)
    else:
        outcomes = _run_here(store, graph)
        release = finish_run(store, graph, outcomes, config.map)
    console.show_summary(config.map, release, time.perf_counter() - clock)
    return release


def plan(file: Path, overrides: Iterable[str], store: Path) -> None:
    """Print the plan."""
    config = load_config(FlexMapConfig, file, overrides)
    opened = Store.open(store)
    console.show_plan(
        config.map, make_plan(Engine(opened), map_update(config), read_last_run(opened, config.map))
    )


def show_config(file: Path, overrides: Iterable[str]) -> None:
    """Print the effective configuration."""
    console.write(dump_config(load_config(FlexMapConfig, file, overrides)))


def defaults() -> None:
    """Print the reference of all settings."""
    console.write(defaults_yaml(FlexMapConfig))


def demo(store: Path, *, through_prefect: bool) -> None:
    """Simulate the small town once, then make its map."""
    folder = store / "demo"
    _write_demo_town(folder)
    inputs = {
        "gnss.file": "recording.mcap",
        "slam.file": "recording.mcap",
        "lanelet_map.file": "lanelet2_map.osm",
        "point_cloud.file": "pointcloud_map.pcd",
        "osm.file": "osm_extract.osm",
        "alignment.control_points_file": "control_points.csv",
    }
    overrides = [f"{key}={folder / name}" for key, name in inputs.items()]
    run(PROJECT / "configs" / "demo.yaml", overrides, store, through_prefect=through_prefect)


def _write_demo_town(folder: Path) -> None:
    """The town's files, unless they are there already, made by the same world and the same code."""
    world = load_config(World, PROJECT / "configs" / "worlds" / "small_town.yaml")
    made_by = code_fingerprint("flexmap_tasks.simulate.write")
    label = seal({"world": world.model_dump(mode="json"), "code": made_by})
    mark = folder / "made_by.json"
    if mark.is_file() and mark.read_bytes() == label:
        return
    console.say(f"simulating {world.name} into {folder}")
    write_world(world, folder)
    mark.write_bytes(label)


def _run_here(store: Store, graph: Graph) -> dict[str, Outcome]:
    with console.StageProgress(len(graph.nodes)) as progress:
        return run_local(store, graph, progress.start, progress.done, progress.item)


def _run_prefect(config: FlexMapConfig, store: Path, plan_: Plan) -> Release:
    """The flow, against the configured server or one of its own that ends with it."""
    for name, value in PREFECT_SETTINGS.items():
        os.environ.setdefault(name, value)
    waiting = sum(1 for s in plan_.steps if s.state != "cached")
    console.say(f"{config.map}: {waiting} of {len(plan_.steps)} stages may run; starting Prefect")
    from flows.map_update import map_update as flow  # noqa: PLC0415 - importing Prefect takes seconds

    flow_run: Any = flow(config, str(store.resolve()), return_state=True)
    state = asyncio.run(flow_run)
    result = state.result(raise_on_failure=False)
    if isinstance(result, BaseException):
        raise result
    return cast("Release", result)
