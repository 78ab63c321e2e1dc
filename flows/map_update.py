"""One recording becomes one map release, as a Prefect flow."""

from __future__ import annotations

import asyncio
from typing import Any

from prefect import flow
from prefect.futures import PrefectFuture
from prefect.task_runners import ThreadPoolTaskRunner

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.execute import Engine, Outcome
from flexmap_tasks.engine.local import REPAIRS
from flexmap_tasks.engine.release import Release
from flexmap_tasks.pipeline import map_update as map_update_graph
from flexmap_tasks.store.store import CorruptBlobError, Store
from flexmap_tasks.tasks import submit_stages
from flows.dashboard import publish_to_dashboard
from flows.finish import finish_run

MAX_STAGES_AT_ONCE = 4


@flow(
    name="map_update",
    flow_run_name="{config.map}",
    persist_result=False,
    validate_parameters=True,
    task_runner=ThreadPoolTaskRunner(max_workers=MAX_STAGES_AT_ONCE),  # type: ignore[arg-type]
)
async def map_update(config: FlexMapConfig, store: str = "artifacts") -> Release:
    """Georeference and enrich one map; publishes a release below the store.

    config : everything the update needs, see configs/defaults.yaml
    store : folder of the artifact store
    """
    opened = Store.open(store)
    graph = map_update_graph(config)
    outcomes = await _run_stages(opened, config)
    release = finish_run(opened, graph, outcomes, config.map)
    await publish_to_dashboard(config.map, outcomes, release)
    return release


async def _run_stages(store: Store, config: FlexMapConfig) -> dict[str, Outcome]:
    """All stages; starts over where a damaged blob was met, which the engine has removed by then."""
    graph = map_update_graph(config)
    for attempt in range(REPAIRS + 1):
        done: dict[str, Outcome] = {}
        futures = submit_stages(Engine(store), graph, config.map, done)
        error = await asyncio.to_thread(_first_error, futures)
        if error is None:
            return {name: done[name] for name in graph.nodes}
        if not isinstance(error, CorruptBlobError) or attempt == REPAIRS:
            raise error
    raise AssertionError("unreachable")


def _first_error(futures: list[PrefectFuture[Any]]) -> BaseException | None:
    """Wait for all; the error of the first stage that failed by itself."""
    errors: list[BaseException] = []
    for future in futures:
        future.wait()
        if future.state.is_failed() or future.state.is_crashed():
            result = future.state.result(raise_on_failure=False)
            errors.append(
                result if isinstance(result, BaseException) else RuntimeError(str(future.state.message))
            )
    return errors[0] if errors else None
