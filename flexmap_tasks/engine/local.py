"""The local runner: stages one after the other in this process."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from flexmap_tasks.engine.execute import Engine, Outcome
from flexmap_tasks.engine.graph import Graph, Node
from flexmap_tasks.store.artifact import Artifact
from flexmap_tasks.store.store import CorruptBlobError, Store

REPAIRS = 20
"""How often a run starts over because a damaged blob was met; each time that blob is made anew."""

T = TypeVar("T")
OnStart = Callable[[Node], None]
OnDone = Callable[[Outcome], None]
OnItem = Callable[[Node, int, int], None]


def run_local(
    store: Store,
    graph: Graph,
    on_start: OnStart = lambda _node: None,
    on_done: OnDone = lambda _outcome: None,
    on_item: OnItem = lambda _node, _done, _all: None,
) -> dict[str, Outcome]:
    """Run the graph; outcomes by stage name, in order."""
    return heal(lambda: _run_once(Engine(store), graph, on_start, on_done, on_item))


def heal(work: Callable[[], T]) -> T:
    """The result of the work, begun again when it met a damaged blob: that blob is gone by then and is made anew."""
    for attempt in range(REPAIRS + 1):
        try:
            return work()
        except CorruptBlobError:
            if attempt == REPAIRS:
                raise
    raise AssertionError("unreachable")


def _run_once(
    engine: Engine, graph: Graph, on_start: OnStart, on_done: OnDone, on_item: OnItem
) -> dict[str, Outcome]:
    outcomes: dict[str, Outcome] = {}
    artifacts: dict[str, Artifact] = {}
    for node in graph:
        on_start(node)
        bound = {name: engine.bind(ref, artifacts) for name, ref in node.inputs.items()}
        outcome = engine.run(node, bound, lambda done, total, node=node: on_item(node, done, total))  # type: ignore[misc]
        outcomes[node.name], artifacts[node.name] = outcome, outcome.artifact
        on_done(outcome)
    return outcomes
