"""Values of a run that a page needs: what is not in the store yet is computed, and nothing else."""

from __future__ import annotations

import typing
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from flexmap_tasks.engine.execute import Engine, Outcome
from flexmap_tasks.engine.graph import Graph, Node, Ref
from flexmap_tasks.engine.keys import arguments, input_types
from flexmap_tasks.engine.local import OnDone, heal
from flexmap_tasks.store.artifact import Artifact
from flexmap_tasks.store.store import Store


def values_of(store: Store, graph: Graph, stages: Iterable[str]) -> dict[str, Any]:
    """What the named stages return, as far as the graph has them."""
    wanted = [name for name in stages if name in graph.nodes]
    return heal(lambda: _values(Engine(store), graph, wanted))


def inputs_of(
    store: Store, graph: Graph, stage: str, without: Iterable[str] = (), done: OnDone = lambda _outcome: None
) -> tuple[dict[str, Any], list[Outcome]]:
    """What a stage is called with, its params left out, and what became of the stages before; it does not run.

    without : inputs that it can do without, for which nothing is computed; done : told of every stage as it ends
    """
    node = graph.nodes[stage]
    fed = {name: ref for name, ref in node.inputs.items() if name not in set(without)}
    return heal(lambda: _inputs(Engine(store), graph, replace(node, inputs=fed), done))


def _values(engine: Engine, graph: Graph, wanted: list[str]) -> dict[str, Any]:
    artifacts = {
        outcome.name: outcome.artifact
        for outcome in _outcomes(engine, graph, set(wanted), lambda _outcome: None)
    }
    values = {}
    for name in wanted:
        stage = graph.nodes[name].stage
        kind = typing.get_type_hints(stage.function)["return"]
        values[name] = engine.load(engine.bind(Ref(name, stage.artifact), artifacts), kind)
    return values


def _inputs(engine: Engine, graph: Graph, node: Node, done: OnDone) -> tuple[dict[str, Any], list[Outcome]]:
    outcomes = _outcomes(engine, graph, set(node.upstream()), done)
    artifacts = {outcome.name: outcome.artifact for outcome in outcomes}
    kinds = input_types(node.stage)
    bound = {name: engine.bind(ref, artifacts) for name, ref in node.inputs.items()}
    given = arguments(node.stage, {name: engine.load(b, kinds[name]) for name, b in bound.items()})
    return given, outcomes


def _outcomes(engine: Engine, graph: Graph, wanted: set[str], done: OnDone) -> list[Outcome]:
    """The wanted nodes and all they wait for, in the order in which they ran."""
    needed = set(wanted)
    for node in reversed(list(graph)):
        if node.name in needed:
            needed |= set(node.upstream())
    artifacts: dict[str, Artifact] = {}
    outcomes = []
    for node in graph:
        if node.name in needed:
            bound = {name: engine.bind(ref, artifacts) for name, ref in node.inputs.items()}
            outcomes.append(engine.run(node, bound))
            artifacts[node.name] = outcomes[-1].artifact
            done(outcomes[-1])
    return outcomes
