"""Each stage as a Prefect task. Prefect shows, retries and schedules; the engine decides what to run.

Prefect's own caching stays off: its keys miss edited helpers and its result files carry no checksum
(CONTRIBUTING.md says what was measured).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any
from uuid import UUID

from prefect import Task, task
from prefect.artifacts import create_progress_artifact, update_progress_artifact
from prefect.cache_policies import NO_CACHE
from prefect.client.schemas.objects import State, TaskRun
from prefect.futures import PrefectFuture
from prefect.logging import get_run_logger
from prefect.states import Completed, Failed

from flexmap_tasks.engine.execute import Engine, Outcome, Progress
from flexmap_tasks.engine.graph import Graph, Node
from flexmap_tasks.errors import FlexMapError
from flexmap_tasks.formats.osm_fetch import OsmServerError
from flexmap_tasks.store.store import CorruptBlobError

ITEMS_FOR_A_BAR = 20
OUTSIDE_RETRIES = 3
OUTSIDE_RETRY_DELAYS_S = [2.0, 10.0, 30.0]


@dataclass(slots=True)
class StageRuns:
    """One walk over a graph: what its stages made, and the errors of those that failed by themselves."""

    engine: Engine
    graph: Graph
    map_name: str
    outcomes: dict[str, Outcome] = field(default_factory=dict)
    errors: dict[str, Exception] = field(default_factory=dict)
    tries: Counter[str] = field(default_factory=Counter)

    def submit(self) -> list[PrefectFuture[Any]]:
        """Submit every stage; each waits for those it needs, independent ones run at the same time."""
        futures: dict[str, PrefectFuture[Any]] = {}
        for node in self.graph:
            upstream = [futures[name] for name in dict.fromkeys(node.upstream())]
            futures[node.name] = self._task(node).submit(return_state=False, wait_for=upstream)
        return list(futures.values())

    def run_stage(self, node: Node) -> State[Any]:
        """The stage's state: `Cached` when the store has the result, `Completed` when it ran."""
        self.errors.pop(node.name, None)
        self.tries[node.name] += 1
        artifacts = {name: outcome.artifact for name, outcome in self.outcomes.items()}
        try:
            bound = {name: self.engine.bind(ref, artifacts) for name, ref in node.inputs.items()}
            outcome = self.engine.run(node, bound, _show_items(node, self.map_name))
        except (FlexMapError, CorruptBlobError) as error:
            self.errors[node.name] = error
            return Failed(message=str(error), data=error)  # one clear line in the log, no traceback
        except Exception as error:
            self.errors[node.name] = error
            raise
        self.outcomes[node.name] = outcome
        return Completed(
            name="Cached" if outcome.cached else "Completed", message=describe(outcome), data=outcome.key
        )

    def _task(self, node: Node) -> Task[[], State[Any]]:
        def run() -> State[Any]:
            return self.run_stage(node)

        def worth_a_retry(_task: Task[Any, Any], _run: TaskRun, state: State[Any]) -> bool:
            """A busy or failing server may recover; a wrong input never does."""
            return isinstance(state.data, OsmServerError) and self.tries[node.name] <= OUTSIDE_RETRIES

        return task(
            name=node.name,
            task_run_name=f"{self.map_name}: {node.name.replace('_', ' ')}",
            description=(node.stage.function.__doc__ or "").strip().split("\n")[0],
            cache_policy=NO_CACHE,
            persist_result=False,
            retries=OUTSIDE_RETRIES
            + 1,  # never used up: Prefect would log "NoneType: None" beside the one clear line
            retry_delay_seconds=OUTSIDE_RETRY_DELAYS_S,
            retry_condition_fn=worth_a_retry,
        )(run)


def describe(outcome: Outcome) -> str:
    """One line for people: cached or computed, and under which action."""
    if outcome.cached:
        return f"cached: action {outcome.key[:12]}, {outcome.seconds:.2f} s saved"
    items = f" ({outcome.computed} of {outcome.items} items ran)" if outcome.items > 1 else ""
    return f"computed in {outcome.seconds:.2f} s{items}: action {outcome.key[:12]}"


def _show_items(node: Node, map_name: str) -> Progress:
    """A line in the log and, where there is much to do, a bar on the dashboard, about every tenth of the way."""
    logger = get_run_logger()
    bar: list[UUID] = []

    def progress(done: int, total: int) -> None:
        if done != total and done % max(1, total // 10) != 0:
            return
        logger.info("%s: %d of %d items", node.name, done, total)
        if total >= ITEMS_FOR_A_BAR:
            share = 100.0 * done / total
            if bar:
                update_progress_artifact(bar[0], progress=share)
            else:
                text = f"{node.name} of {map_name}: {total} items"
                made: Any = create_progress_artifact(progress=share, description=text)
                bar.append(made)

    return progress
