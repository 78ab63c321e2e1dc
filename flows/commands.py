"""What the commands do."""

from __future__ import annotations

import time
from collections.abc import Iterable
from pathlib import Path

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.finished import still_finished
from flexmap_tasks.engine.gate import read_verdict
from flexmap_tasks.engine.release import Release
from flexmap_tasks.errors import FlexMapError
from flexmap_tasks.formats.config_file import dump_config, load_config
from flexmap_tasks.store.artifact import seal
from flexmap_tasks.store.store import Store
from flows import console
from flows.verdicts import not_published

PROJECT = Path(__file__).resolve().parents[1]

# What loads the stages is imported where it is needed: a run that finds nothing to do takes no longer than it must.

DEMO_FAULTS = ("osm.wrong_share=0.12", "hd_map.fragment_share=0.2")
"""What the demo's two maps get wrong, so that something is left for a person to decide."""


def run(
    file: Path, overrides: Iterable[str], store: str, releases: Path | None = None, *, through_prefect: bool
) -> None:
    """Plan, run what has to run, publish."""
    config = load_config(FlexMapConfig, file, overrides)
    run_config(config, Store.open(store, releases), through_prefect=through_prefect)


def run_config(config: FlexMapConfig, store: Store, *, through_prefect: bool) -> Release:
    """The same for settings already read."""
    clock = time.perf_counter()
    finished = still_finished(store, config, store.releases)
    if finished is not None:
        release = finished.release
        console.say(
            f"{config.map}: nothing changed, all {finished.stages} stages are cached; no flow was started"
        )
    else:
        from flows.running import run_planned  # noqa: PLC0415 - see above

        release = run_planned(config, store, through_prefect=through_prefect)
    console.show_summary(config.map, release, time.perf_counter() - clock)
    stopped = not_published(read_verdict(store, config.map, release.id))
    if stopped is not None:
        raise stopped
    return release


def run_grid(
    file: Path,
    overrides: Iterable[str],
    grid: Iterable[str],
    store: Store,
    table: Path | None,
    best_by: str | None,
    *,
    through_prefect: bool,
) -> None:
    """A trial per combination of settings, and a table of what came out."""
    from flows.comparison import write_comparison  # noqa: PLC0415 - see above
    from flows.running import run_trials  # noqa: PLC0415
    from flows.trials import parse_grid  # noqa: PLC0415

    config = load_config(FlexMapConfig, file, overrides)
    comparison = run_trials(config, parse_grid(grid), store, best_by, through_prefect=through_prefect)
    console.show_comparison(comparison)
    beside = store.releases / config.map / "trials"
    for target in (table,) if table else (beside.with_suffix(".md"), beside.with_suffix(".parquet")):
        write_comparison(comparison, target)
        console.say(str(target))
    if not any(row["release"] for row in comparison.facts):
        raise FlexMapError(f"{config.map}: all {len(comparison.facts)} combinations failed")


def plan(file: Path, overrides: Iterable[str], store: str) -> None:
    """Print the plan."""
    from flows.running import plan_run  # noqa: PLC0415 - see above

    config = load_config(FlexMapConfig, file, overrides)
    console.show_plan(config.map, plan_run(config, Store.open(store)))


def show_config(file: Path, overrides: Iterable[str]) -> None:
    """Print the effective configuration."""
    console.write(dump_config(load_config(FlexMapConfig, file, overrides)))


def defaults() -> None:
    """Print the reference of all settings."""
    from flexmap_tasks.formats.config_defaults import defaults_yaml  # noqa: PLC0415 - see above

    console.write(defaults_yaml(FlexMapConfig))


def demo(store: str, *, through_prefect: bool) -> None:
    """Simulate the small town once, then make its map."""
    folder = Path("artifacts" if "://" in store else store) / "demo"
    _write_demo_town(folder)
    _write_empty_decisions(folder)
    overrides = demo_inputs(folder)
    run(PROJECT / "configs" / "demo.yaml", overrides, store, through_prefect=through_prefect)


def demo_inputs(folder: Path) -> list[str]:
    """The settings that name the demo's files in that folder."""
    inputs = {
        "gnss.file": "recording.mcap",
        "slam.file": "recording.mcap",
        "lanelet_map.file": "lanelet2_map.osm",
        "point_cloud.file": "pointcloud_map.pcd",
        "osm.file": "osm_extract.osm",
        "alignment.control_points_file": "control_points.csv",
        "conflation.review_file": "review_decisions.csv",
    }
    return [f"{key}={folder / name}" for key, name in inputs.items()]


def _write_empty_decisions(folder: Path) -> None:
    """The two files that the editor saves to, unless a person has saved something already."""
    from flexmap_tasks.formats import control_points_csv, review_decisions_csv  # noqa: PLC0415 - see above

    headers = {
        "control_points.csv": control_points_csv.WRITTEN,
        "review_decisions.csv": review_decisions_csv.HEADER,
    }
    for name, header in headers.items():
        if not (folder / name).exists():
            (folder / name).write_text(",".join(header) + "\n")


def _write_demo_town(folder: Path) -> None:
    """The town's files, unless they are there already, made by the same world and the same code."""
    from flexmap_tasks.engine.fingerprint import code_fingerprint  # noqa: PLC0415 - see above
    from flexmap_tasks.simulate.world import World  # noqa: PLC0415
    from flexmap_tasks.simulate.write import write_world  # noqa: PLC0415

    world = load_config(World, PROJECT / "configs" / "worlds" / "small_town.yaml", DEMO_FAULTS)
    made_by = code_fingerprint("flexmap_tasks.simulate.write")
    label = seal({"world": world.model_dump(mode="json"), "code": made_by})
    mark = folder / "made_by.json"
    if mark.is_file() and mark.read_bytes() == label:
        return
    console.say(f"simulating {world.name} into {folder}")
    write_world(world, folder)
    mark.write_bytes(label)
