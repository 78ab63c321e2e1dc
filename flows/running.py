"""Runs that have something to do. Importing this loads every stage; `commands` does so only when it must."""

from __future__ import annotations

import asyncio
import os
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
from flows.failures import remember_failure
from flows.finish import finish_run

PREFECT_SETTINGS = {
    "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "120",  # a cold server needs 10 to 35 s
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    "DO_NOT_TRACK": "1",
}


def plan_run(config: FlexMapConfig, store: Store) -> Plan:
    """What a run would do and why."""
    return make_plan(Engine(store), map_update(config), read_last_run(store, config.map))


def run_planned(config: FlexMapConfig, store: Store, *, through_prefect: bool) -> Release:
    """Plan, run what has to run, publish."""
    store.check_writable()
    graph = map_update(config)
    watched = watch(graph)
    plan = make_plan(Engine(store), graph, read_last_run(store, config.map))
    if plan.all_cached:
        release = heal(lambda: finish_run(store, graph, run_local(store, graph), config, watched))
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
            return heal(lambda: finish_run(store, graph, outcomes(), config, watched))
        except FlexMapError as error:
            remember_failure(store, config, watched, error)
            raise


def _run_prefect(config: FlexMapConfig, store: Store, plan: Plan) -> Release:
    """The flow, against the configured server or one of its own that ends with it."""
    for name, value in PREFECT_SETTINGS.items():
        os.environ.setdefault(name, value)
    waiting = sum(1 for s in plan.steps if s.state != "cached")
    console.say(f"{config.map}: {waiting} of {len(plan.steps)} stages may run; starting Prefect")
    from flows.map_update import map_update as flow  # noqa: PLC0415 - importing Prefect takes seconds

    flow_run: Any = flow(config, store.backend.url, str(store.releases.resolve()), return_state=True)
    state = asyncio.run(flow_run)
    result = state.result(raise_on_failure=False)
    if isinstance(result, BaseException):
        raise result
    return cast("Release", result)
