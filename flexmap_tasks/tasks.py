"""Each stage as a Prefect task. Prefect shows, retries and schedules; the engine decides what to run.

Prefect's own caching stays off: its keys miss edited helpers and its result files carry no checksum
(CONTRIBUTING.md says what was measured).
"""

from __future__ import annotations

from typing import Any

from prefect import Task, task
from prefect.cache_policies import NO_CACHE
from prefect.client.schemas.objects import State, TaskRun
from prefect.futures import PrefectFuture
from prefect.logging import get_run_logger
from prefect.states import Completed

from flexmap_tasks.engine.execute import Engine, Outcome
from flexmap_tasks.engine.graph import Graph, Node
from flexmap_tasks.formats.osm_fetch import OsmServerError

OUTSIDE_RETRIES = 3
OUTSIDE_RETRY_DELAYS_S = [2.0, 10.0, 30.0]


def submit_stages(
    engine: Engine, graph: Graph, map_name: str, outcomes: dict[str, Outcome]
) -> list[PrefectFuture[Any]]:
    """Submit every stage; each waits for those it needs, independent ones run at the same time.

    `outcomes` fills up as stages end.
    """
    futures: dict[str, PrefectFuture[Any]] = {}
    for node in graph:
        upstream = [futures[name] for name in dict.fromkeys(node.upstream())]
        futures[node.name] = stage_task(engine, node, map_name, outcomes).submit(
            return_state=False, wait_for=upstream
        )
    return list(futures.values())


def stage_task(
    engine: Engine, node: Node, map_name: str, outcomes: dict[str, Outcome]
) -> Task[[], State[Any]]:
    """The Prefect task of one stage: `Cached` when the store has the result, `Completed` when it ran."""

    def run_stage() -> State[Any]:
        artifacts = {name: outcome.artifact for name, outcome in outcomes.items()}
        bound = {name: engine.bind(ref, artifacts) for name, ref in node.inputs.items()}
        outcome = engine.run(node, bound, _log_items(node))
        outcomes[node.name] = outcome
        state_name = "Cached" if outcome.cached else "Completed"
        return Completed(name=state_name, message=describe(outcome), data=outcome.key)

    return task(
        name=node.name,
        task_run_name=f"{map_name}: {node.name.replace('_', ' ')}",
        description=(node.stage.function.__doc__ or "").strip().split("\n")[0],
        cache_policy=NO_CACHE,
        persist_result=False,
        retries=OUTSIDE_RETRIES if node.stage.outside else 0,
        retry_delay_seconds=OUTSIDE_RETRY_DELAYS_S,
        retry_condition_fn=_worth_a_retry,
    )(run_stage)


def _worth_a_retry(_task: Task[Any, Any], _run: TaskRun, state: State[Any]) -> bool:
    """A busy or failing server may recover; a wrong input never does."""
    return isinstance(state.result(raise_on_failure=False), OsmServerError)


def describe(outcome: Outcome) -> str:
    """One line for people: cached or computed, and under which action."""
    if outcome.cached:
        return f"cached: action {outcome.key[:12]}, {outcome.seconds:.2f} s saved"
    items = f" ({outcome.computed} of {outcome.items} items ran)" if outcome.items > 1 else ""
    return f"computed in {outcome.seconds:.2f} s{items}: action {outcome.key[:12]}"


def _log_items(node: Node) -> Any:
    logger = get_run_logger()

    def progress(done: int, total: int) -> None:
        if done == total or done % max(1, total // 10) == 0:
            logger.info("%s: %d of %d items", node.name, done, total)

    return progress
