"""One recording becomes one map release, as a Prefect flow."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from prefect import flow
from prefect.client.schemas.objects import State
from prefect.futures import wait
from prefect.states import Completed, Failed
from prefect.task_runners import ThreadPoolTaskRunner

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.execute import Engine, Outcome
from flexmap_tasks.engine.finished import Watched, watch
from flexmap_tasks.engine.gate import read_verdict
from flexmap_tasks.engine.graph import Graph
from flexmap_tasks.engine.local import REPAIRS
from flexmap_tasks.engine.release import Release
from flexmap_tasks.errors import FlexMapError, RejectedError
from flexmap_tasks.pipeline import map_update as map_update_graph
from flexmap_tasks.store.store import CorruptBlobError, Store
from flexmap_tasks.tasks import StageRuns
from flows.dashboard import publish_to_dashboard, savings
from flows.failures import remember_failure
from flows.finish import finish_run
from flows.verdicts import not_published

MAX_STAGES_AT_ONCE = 4


@flow(
    name="map_update",
    flow_run_name="{config.map}",
    persist_result=False,
    validate_parameters=True,
    task_runner=ThreadPoolTaskRunner(max_workers=MAX_STAGES_AT_ONCE),  # type: ignore[arg-type]
)
async def map_update(
    config: FlexMapConfig, store: str = "artifacts", releases: str | None = None, trial: bool = False
) -> State[Any]:
    """Georeference and enrich one map; publishes a release.

    config : everything the update needs, see configs/defaults.yaml
    store : folder of the artifact store, or s3://bucket/prefix
    releases : folder of the releases; below the store when empty
    trial : only make the release, whatever its quality; nothing is published
    """
    opened = Store.open(store, Path(releases) if releases else None)
    graph = map_update_graph(config)
    watched = watch(graph)
    try:
        outcomes, release = await _run(opened, graph, config, watched, trial)
    except FlexMapError as error:
        remember_failure(opened, config, watched, error)
        return Failed(message=str(error), data=error)  # a fault of the input is one line, not a traceback
    verdict = None if trial else read_verdict(opened, config.map, release.id)
    await publish_to_dashboard(config, outcomes, release, verdict, trial=trial)
    if trial:
        return Completed(message=f"release {release.id} is a trial; {savings(outcomes)}", data=release)
    stopped = not_published(verdict)
    if isinstance(stopped, RejectedError):
        return Failed(name="Rejected", message=str(stopped), data=stopped)
    if stopped is not None:
        return Completed(name="Held", message=str(stopped), data=release)
    return Completed(message=f"release {release.id} is published; {savings(outcomes)}", data=release)


async def _run(
    store: Store, graph: Graph, config: FlexMapConfig, watched: Watched, trial: bool
) -> tuple[dict[str, Outcome], Release]:
    """All stages and the release; begins again where a damaged blob was met, which is gone from the store by then."""
    for attempt in range(REPAIRS + 1):
        try:
            outcomes = await _run_stages(store, graph, config.map)
            return outcomes, finish_run(store, graph, outcomes, config, watched, trial=trial)
        except CorruptBlobError:
            if attempt == REPAIRS:
                raise
    raise AssertionError("unreachable")


async def _run_stages(store: Store, graph: Graph, map_name: str) -> dict[str, Outcome]:
    runs = StageRuns(Engine(store), graph, map_name)
    futures = runs.submit()
    await asyncio.to_thread(wait, futures)
    error = next(iter(runs.errors.values()), None)
    if error is not None:
        raise error
    return {name: runs.outcomes[name] for name in graph.nodes}
