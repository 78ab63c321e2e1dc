"""Values of a run that a page needs: what is not in the store yet is computed, and nothing else."""

from __future__ import annotations

import typing
from collections.abc import Iterable
from typing import Any

from flexmap_tasks.engine.execute import Engine
from flexmap_tasks.engine.graph import Graph, Ref
from flexmap_tasks.engine.keys import arguments, input_types
from flexmap_tasks.engine.local import heal
from flexmap_tasks.store.artifact import Artifact
from flexmap_tasks.store.store import Store


def values_of(store: Store, graph: Graph, stages: Iterable[str]) -> dict[str, Any]:
    """What the named stages return, as far as the graph has them."""
    wanted = [name for name in stages if name in graph.nodes]
    return heal(lambda: _values(Engine(store), graph, wanted))


def inputs_of(store: Store, graph: Graph, stage: str) -> dict[str, Any]:
    """What a stage is called with, its params left out; the stage itself does not run."""
    return heal(lambda: _inputs(Engine(store), graph, stage))


def _values(engine: Engine, graph: Graph, wanted: list[str]) -> dict[str, Any]:
    artifacts = _artifacts(engine, graph, set(wanted))
    values = {}
    for name in wanted:
        stage = graph.nodes[name].stage
        kind = typing.get_type_hints(stage.function)["return"]
        values[name] = engine.load(engine.bind(Ref(name, stage.artifact), artifacts), kind)
    return values


def _inputs(engine: Engine, graph: Graph, stage: str) -> dict[str, Any]:
    node = graph.nodes[stage]
    artifacts = _artifacts(engine, graph, set(node.upstream()))
    kinds = input_types(node.stage)
    bound = {name: engine.bind(ref, artifacts) for name, ref in node.inputs.items()}
    return arguments(node.stage, {name: engine.load(b, kinds[name]) for name, b in bound.items()})


def _artifacts(engine: Engine, graph: Graph, wanted: set[str]) -> dict[str, Artifact]:
    """Artifacts of the wanted nodes and of all they wait for."""
    needed = set(wanted)
    for node in reversed(list(graph)):
        if node.name in needed:
            needed |= set(node.upstream())
    artifacts: dict[str, Artifact] = {}
    for node in graph:
        if node.name in needed:
            bound = {name: engine.bind(ref, artifacts) for name, ref in node.inputs.items()}
            artifacts[node.name] = engine.run(node, bound).artifact
    return artifacts
