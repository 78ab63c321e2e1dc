"""Commands about worlds with known truth: simulate one, score a release in it, sweep its noise."""

from __future__ import annotations

import json
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from cyclopts import App

from flexmap_tasks.errors import ConfigError, StoreError
from flows import console
from flows.store_commands import STORE, Set, StoreUrl

# What a command needs is imported by that command: `flexmap run` must not wait for what others load.


def add_world_commands(app: App) -> None:
    """Give the `flexmap` command those of this module."""
    for command in (simulate, evaluate, sweep):
        app.command(command)


def simulate(world: Path, out: Path, *, set_: Set = ()) -> None:
    """Write a simulated world: recording, maps, extract, cloud, and the exact truth (docs/simulation.md).

    Parameters
    ----------
    world
        YAML file of a world, such as configs/worlds/small_town.yaml.
    out
        Folder to write to; made if it is not there.
    set_
        Settings to override, as key.path=value.
    """
    from flexmap_tasks.formats.config_file import load_config  # noqa: PLC0415
    from flexmap_tasks.simulate.world import World  # noqa: PLC0415
    from flexmap_tasks.simulate.write import write_world  # noqa: PLC0415

    settings = load_config(World, world, set_)
    try:
        write_world(settings, out)
    except OSError as error:
        raise StoreError(f"{out}: cannot be written ({error.strerror})") from error
    console.say(f"{settings.name}: recording, maps and truth are in")
    console.say(str(out))


def evaluate(release: Path, world: Path, *, out: Path | None = None) -> None:
    """Score a release against the truth of the simulated world it was made from (docs/evaluation.md).

    Parameters
    ----------
    release
        Folder of the release.
    world
        Folder that `flexmap simulate` wrote (or its truth folder).
    out
        Folder for evaluation.json, evaluation.md and the plots; ./evaluation unless given.
    """
    from flexmap_tasks.scoring import score_release  # noqa: PLC0415

    town = world.parent if world.name == "truth" else world
    _write(score_release(release, town), out or Path("evaluation"), "evaluation.md")


def sweep(
    world: Path,
    *,
    noise: str = "0,1,2,3,5,8",
    seeds: int = 5,
    set_: Set = (),
    out: Path | None = None,
    store: StoreUrl = STORE,
    jobs: int | None = None,
) -> None:
    """Score the pipeline over growing noise of OpenStreetMap, several seeds each; every run is cached in the store.

    Parameters
    ----------
    world
        YAML file of a world.
    noise
        Standard deviations of OpenStreetMap's displacement field in metres, separated by commas.
    seeds
        Worlds per noise level.
    set_
        Settings of the world to override, as key.path=value.
    out
        Folder for sweep.json, sweep.md and sweep.svg; ./sweep unless given.
    store
        Folder of the artifact store.
    jobs
        Runs at the same time; one per core unless given.
    """
    from flexmap_tasks.evaluation.sweep import sweep_report, sweep_run  # noqa: PLC0415
    from flexmap_tasks.formats.config_file import load_config  # noqa: PLC0415
    from flexmap_tasks.simulate.world import World  # noqa: PLC0415

    base = load_config(World, world, set_)
    cases = [(sigma, base.seed + i) for sigma in _numbers(noise) for i in range(seeds)]
    runs = []
    with ProcessPoolExecutor(max_workers=jobs or os.cpu_count()) as pool:
        worlds = [
            base.changed(osm={"field_sigma_m": sigma}, seed=seed).model_dump_json() for sigma, seed in cases
        ]
        for (sigma, seed), content in zip(cases, pool.map(score, worlds, [store] * len(worlds)), strict=True):
            runs.append(sweep_run(sigma, seed, content))
            console.say(f"noise {sigma:g} m, seed {seed}: done ({len(runs)} of {len(cases)})")
    _write(sweep_report(runs), out or Path("sweep"), "sweep.md")


def score(world_json: str, store_url: str) -> bytes:
    """`evaluation.json` of one world, from the store when it was scored before."""
    from flexmap_tasks.engine.graph import Graph  # noqa: PLC0415
    from flexmap_tasks.engine.local import run_local  # noqa: PLC0415
    from flexmap_tasks.scoring import ScoreParams, score_world  # noqa: PLC0415
    from flexmap_tasks.store.store import Store  # noqa: PLC0415

    graph, store = Graph(), Store.open(store_url)
    graph.run(score_world, ScoreParams(world=json.loads(world_json)))
    outcome = run_local(store, graph)["score_world"]
    return store.read_blob(dict(outcome.artifact.files)["evaluation.json"])


def _numbers(text: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise ConfigError(
            "--noise", f'expected metres separated by commas such as "0,1,2", got "{text}"'
        ) from None
    return values


def _write(files: dict[str, bytes], out: Path, shown: str) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            (out / name).write_bytes(content)
    except OSError as error:
        raise StoreError(f"{out}: cannot be written ({error.strerror})") from error
    console.write(files[shown].decode())
    console.say(str(out))
