"""The DAG as data: nodes that say which stage is fed by what. Runners give it meaning."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from flexmap_tasks.config import Params
from flexmap_tasks.engine.stage import AnyStage
from flexmap_tasks.store.artifact import Artifact


@dataclass(frozen=True, slots=True)
class SourceRef:
    """A file from outside, digested when a runner meets it."""

    path: Path

    @property
    def name(self) -> str:
        """The name for messages."""
        return self.path.name

    def __str__(self) -> str:
        return "file"


@dataclass(frozen=True, slots=True)
class Ref:
    """The artifact of a node, or a part of it.

    node : name of the node; base : artifact base name
    part : field of a composite; transposed : a collection of collections with its two keys swapped
    keys_only : of a collection only which keys it has, whatever lies behind them
    """

    node: str
    base: str
    part: str | None = None
    transposed: bool = False
    keys_only: bool = False

    def field(self, name: str) -> Ref:
        """One field of a composite value."""
        return replace(self, part=name)

    def transpose(self) -> Ref:
        """outer/inner files as inner/outer: regrouping without reading anything."""
        return replace(self, transposed=True)

    def keys(self) -> Ref:
        """The keys of a collection: a stage that takes them reruns only when keys come or go."""
        return replace(self, keys_only=True)

    def select(self, artifact: Artifact) -> Artifact:
        """What this reference means of the node's artifact."""
        chosen = artifact.field(self.base, self.part) if self.part else artifact
        return _transpose(chosen, self.name) if self.transposed else chosen

    @property
    def name(self) -> str:
        """Base name of the files this reference stands for."""
        return self.part or self.base

    def __str__(self) -> str:
        how = " by the inner key" if self.transposed else ", its keys" if self.keys_only else ""
        return f"{self.node}{f'.{self.part}' if self.part else ''}{how}"


Input = Ref | SourceRef
Narrow = Callable[[str, Mapping[str, Any]], Mapping[str, Any]]
"""(item key, inputs by name) -> the inputs as far as they concern that item."""


@dataclass(frozen=True, slots=True)
class Node:
    """One stage fed by inputs.

    each : the input that is a collection; the stage runs once per item, each cached on its own
    narrow : restricts the other inputs to what concerns an item, so that distant changes leave it cached
    """

    name: str
    stage: AnyStage
    inputs: Mapping[str, Input]
    params: Params | None
    each: str | None = None
    narrow: Narrow | None = None

    def upstream(self) -> list[str]:
        """Names of the nodes this one waits for."""
        return [r.node for r in self.inputs.values() if isinstance(r, Ref)]


@dataclass(slots=True)
class Graph:
    """Nodes in an order in which they can run, and what of them a release holds."""

    nodes: dict[str, Node] = field(default_factory=dict)
    release: list[tuple[str, Ref]] = field(default_factory=list)

    def run(self, stage: AnyStage, params: Params | None = None, **inputs: Input | None) -> Ref:
        """Add a stage; an input that is None is left to the stage's default None."""
        return self._add(stage, params, inputs)

    def run_as(
        self, name: str, stage: AnyStage, params: Params | None = None, /, **inputs: Input | None
    ) -> Ref:
        """Add a stage under a name of its own: one that stands in the graph more than once."""
        return self._add(stage, params, inputs, named=name)

    def run_each(
        self, stage: AnyStage, each: str, params: Params | None = None, *, narrow: Narrow | None = None,
        **inputs: Input | None,
    ) -> Ref:  # fmt: skip
        """Add a stage that runs once per item of the collection fed to `each`."""
        return self._add(stage, params, inputs, each, narrow)

    def publish(self, path: str, ref: Ref) -> None:
        """Put an artifact into the release: a file at `path`, files below a `path/`, or "." by their own names."""
        self.release.append((path, ref))

    def leave_out(self, *stages: AnyStage) -> None:
        """Take out stages that no other waits for, and what they would have released."""
        for stage in stages:
            self.nodes.pop(stage.name, None)
            self.release = [(path, ref) for path, ref in self.release if ref.node != stage.name]

    def _add(
        self, stage: AnyStage, params: Params | None, inputs: Mapping[str, Input | None],
        each: str | None = None, narrow: Narrow | None = None, named: str | None = None,
    ) -> Ref:  # fmt: skip
        given, name = {key: ref for key, ref in inputs.items() if ref is not None}, named or stage.name
        if name in self.nodes:
            raise ValueError(f"stage {name} stands twice in the graph; give one of them another name")
        self.nodes[name] = Node(name, stage, given, params, each, narrow)
        return Ref(name, stage.artifact)

    def __iter__(self) -> Iterator[Node]:
        return iter(self.nodes.values())


def _transpose(artifact: Artifact, base: str) -> Artifact:
    swapped = {}
    for path, blob in artifact.sub(f"{base}/").files:
        outer, _, rest = path.partition("/")
        inner, dot, suffix = rest.partition(".")
        swapped[f"{base}/{inner}/{outer}{dot}{suffix}"] = blob
    return Artifact.of(swapped)
