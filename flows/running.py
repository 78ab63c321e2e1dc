"""Runs that have something to do. Importing this loads every stage; `commands` does so only when it must."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Mapping, Sequence
from typing import Any, cast

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.execute import Engine, Outcome
from flexmap_tasks.engine.finished import watch
from flexmap_tasks.engine.local import heal, run_local
from flexmap_tasks.engine.plan import Plan, make_plan
from flexmap_tasks.engine.release import Release
from flexmap_tasks.engine.runs import read_last_run
from flexmap_tasks.errors import FlexMapError
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.store.store import Store
from flows import console
from flows.comparison import Comparison
from flows.failures import remember_failure
from flows.finish import finish_run
from flows.trials import compare_trials, trials_of, try_here

PREFECT_SETTINGS = {
    "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "120",  # a cold server needs 10 to 35 s
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    "DO_NOT_TRACK": "1",
}


def plan_run(config: FlexMapConfig, store: Store) -> Plan:
    """What a run would do and why."""
    return make_plan(Engine(store), map_update(config), read_last_run(store, config.map))


def run_planned(
    config: FlexMapConfig, store: Store, *, through_prefect: bool, trial: bool = False
) -> Release:
    """Plan, run what has to run, publish; a trial is not published."""
    store.check_writable()
    graph = map_update(config)
    watched = watch(graph)
    plan = make_plan(Engine(store), graph, read_last_run(store, config.map))
    if plan.all_cached:
        release = heal(
            lambda: finish_run(store, graph, run_local(store, graph), config, watched, trial=trial)
        )
        console.say(
            f"{config.map}: nothing changed, all {len(plan.steps)} stages are cached; no flow was started"
        )
        return release
    if through_prefect:
        return _run_prefect(config, store, plan)
    with console.StageProgress(len(graph.nodes)) as progress:

        def outcomes() -> dict[str, Outcome]:
            return run_local(store, graph, progress.start, progress.done, progress.item)

        try:
            return heal(lambda: finish_run(store, graph, outcomes(), config, watched, trial=trial))
        except FlexMapError as error:
            remember_failure(store, config, watched, error)
            raise


def run_trials(
    config: FlexMapConfig,
    grid: Mapping[str, Sequence[Any]],
    store: Store,
    best_by: str | None,
    *,
    through_prefect: bool,
) -> Comparison:
    """A release per combination of settings, none of them published, and how they compare."""
    store.check_writable()
    trials = trials_of(config, grid)
    console.say(f"{config.map}: {len(trials)} combinations of {', '.join(grid)}")
    if not through_prefect:

        def run(settings: FlexMapConfig) -> str:
            return run_planned(settings, store, through_prefect=False, trial=True).id

        return compare_trials(store, config, try_here(trials, run), best_by)
    _prepare_prefect()
    from flows.map_trials import map_trials as flow  # noqa: PLC0415 - importing Prefect takes seconds

    tried = _result_of(flow(config, dict(grid), *_places(store), best_by, return_state=True))
    return compare_trials(store, config, tried, best_by)


def _run_prefect(config: FlexMapConfig, store: Store, plan: Plan) -> Release:
    """The flow, against the configured server or one of its own that ends with it."""
    _prepare_prefect()
    waiting = sum(1 for s in plan.steps if s.state != "cached")
    console.say(f"{config.map}: {waiting} of {len(plan.steps)} stages may run; starting Prefect")
    from flows.map_update import map_update as flow  # noqa: PLC0415 - importing Prefect takes seconds

    return cast("Release", _result_of(flow(config, *_places(store), return_state=True)))


def _prepare_prefect() -> None:
    for name, value in PREFECT_SETTINGS.items():
        os.environ.setdefault(name, value)


def _places(store: Store) -> tuple[str, str]:
    return store.backend.url, str(store.releases.resolve())


def _result_of(flow_run: Any) -> Any:
    """What a flow made; the error that ended it is raised."""
    state = asyncio.run(flow_run)
    result = state.result(raise_on_failure=False)
    if isinstance(result, BaseException):
        raise result
    return result
