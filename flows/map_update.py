"""One recording becomes one map release, as a Prefect flow."""

from __future__ import annotations

import asyncio
from typing import Any

from prefect import flow
from prefect.client.schemas.objects import State
from prefect.futures import wait
from prefect.states import Failed
from prefect.task_runners import ThreadPoolTaskRunner

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.execute import Engine, Outcome
from flexmap_tasks.engine.graph import Graph
from flexmap_tasks.engine.local import REPAIRS
from flexmap_tasks.engine.release import Release
from flexmap_tasks.errors import FlexMapError
from flexmap_tasks.pipeline import map_update as map_update_graph
from flexmap_tasks.store.store import CorruptBlobError, Store
from flexmap_tasks.tasks import StageRuns
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
async def map_update(config: FlexMapConfig, store: str = "artifacts") -> Release | State[Any]:
    """Georeference and enrich one map; publishes a release below the store.

    config : everything the update needs, see configs/defaults.yaml
    store : folder of the artifact store
    """
    opened = Store.open(store)
    graph = map_update_graph(config)
    try:
        outcomes = await _run_stages(opened, graph, config.map)
        release = finish_run(opened, graph, outcomes, config.map)
    except FlexMapError as error:
        return Failed(message=str(error), data=error)  # a fault of the input is one line, not a traceback
    await publish_to_dashboard(config.map, outcomes, release)
    return release


async def _run_stages(store: Store, graph: Graph, map_name: str) -> dict[str, Outcome]:
    """All stages; starts over where a damaged blob was met, which the engine has removed by then."""
    for attempt in range(REPAIRS + 1):
        runs = StageRuns(Engine(store), graph, map_name)
        futures = runs.submit()
        await asyncio.to_thread(wait, futures)
        error = next(iter(runs.errors.values()), None)
        if error is None:
            return {name: runs.outcomes[name] for name in graph.nodes}
        if not isinstance(error, CorruptBlobError) or attempt == REPAIRS:
            raise error
    raise AssertionError("unreachable")
