"""Reruns of one map with other settings beside each other, as a Prefect flow; the table goes to the dashboard."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

from prefect import flow
from prefect.artifacts import acreate_markdown_artifact, acreate_table_artifact
from prefect.client.schemas.objects import State
from prefect.states import Completed, Failed

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.release import Release
from flexmap_tasks.errors import FlexMapError
from flexmap_tasks.store.store import Store
from flows.comparison import Comparison, markdown
from flows.dashboard import artifact_key, name_run
from flows.map_update import map_update
from flows.trials import Trial, Tried, compare_trials, trials_of


@flow(name="map_trials", flow_run_name="{config.map}: trials", persist_result=False, validate_parameters=True)
async def map_trials(
    config: FlexMapConfig,
    grid: dict[str, list[Any]],
    store: str = "artifacts",
    releases: str | None = None,
    best_by: str | None = None,
) -> State[Any]:
    """Make a release per combination of settings, publish none, and compare them.

    config : everything the update needs, see configs/defaults.yaml
    grid : values to try by setting, such as {"alignment.pose_graph.blend_sigma_m": [4, 8, 16]}
    store : folder of the artifact store, or s3://bucket/prefix
    releases : folder of the releases; below the store when empty
    best_by : figure of quality.json that says which is best
    """
    opened = Store.open(store, Path(releases) if releases else None)
    try:
        trials = trials_of(config, grid)
        tried = [await _try(trial, store, releases) for trial in trials]
        comparison = compare_trials(opened, config, tried, best_by)
    except FlexMapError as error:
        return Failed(message=str(error), data=error)
    await _show(config, comparison)
    return Completed(message=comparison.headline(), data=tried)


async def _try(trial: Trial, store: str, releases: str | None) -> Tried:
    """One combination as a run of its own below this one; a fault of it stops no other."""
    started = datetime.now(UTC)
    run: Any = map_update(trial.config, store, releases, trial=True, return_state=True)
    state = await run
    result = await state.aresult(raise_on_failure=False)
    if isinstance(result, FlexMapError):
        return Tried(trial, started, "", str(result).replace("\n", " "))
    if isinstance(result, BaseException):
        raise result
    return Tried(trial, started, cast("Release", result).id)


async def _show(config: FlexMapConfig, comparison: Comparison) -> None:
    key = artifact_key(config.map)
    await acreate_table_artifact(
        key=f"{key}-trials", table=comparison.cells(), description=comparison.headline()
    )
    await acreate_markdown_artifact(key=f"{key}-trials-report", markdown=markdown(comparison))
    await name_run(comparison.headline())
