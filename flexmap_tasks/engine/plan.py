"""What a run would do and why, without doing it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from flexmap_tasks.engine.execute import Engine
from flexmap_tasks.engine.graph import Graph, Node, SourceRef
from flexmap_tasks.engine.keys import action_key
from flexmap_tasks.store.artifact import Artifact
from flexmap_tasks.store.store import ActionRecord, Store, parse_record, record_path

State = Literal["cached", "run", "depends"]


@dataclass(frozen=True, slots=True)
class Step:
    """One stage of a plan.

    state : cached (nothing to do), run (will run), depends (runs only if something before it comes out different)
    why : one line a person understands
    record : the action record when it is cached
    """

    node: Node
    state: State
    why: str
    record: ActionRecord | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """All stages in order."""

    steps: tuple[Step, ...]

    @property
    def all_cached(self) -> bool:
        """Nothing would run."""
        return all(step.state == "cached" for step in self.steps)

    def artifacts(self) -> dict[str, Artifact]:
        """Artifacts of the cached stages by name."""
        return {s.node.name: s.record.output for s in self.steps if s.record is not None}

    def actions(self) -> dict[str, str]:
        """Action keys of the cached stages by name."""
        return {s.node.name: s.record.key for s in self.steps if s.record is not None}


def make_plan(engine: Engine, graph: Graph, last_run: Mapping[str, str]) -> Plan:
    """Look every stage up; `last_run` maps stage to action key, to say what differs since then."""
    steps: dict[str, Step] = {}
    for node in graph:
        waiting = [name for name in node.upstream() if steps[name].state != "cached"]
        if waiting:
            names = ", ".join(dict.fromkeys(waiting))
            steps[node.name] = Step(node, "depends", f"on whether the result of {names} changes")
            continue
        artifacts = {name: s.record.output for name, s in steps.items() if s.record is not None}
        bound = {name: engine.bind(ref, artifacts) for name, ref in node.inputs.items()}
        image = engine.image(node, bound)
        record = engine.find(node, image)
        if record is not None:
            steps[node.name] = Step(node, "cached", f"action {record.key[:12]}", record)
        else:
            steps[node.name] = Step(node, "run", _why(engine.store, node, image, last_run.get(node.name)))
    return Plan(tuple(steps.values()))


def _why(store: Store, node: Node, image: Mapping[str, Any], last_key: str | None) -> str:
    if last_key is None:
        return "has not run for this map"
    if last_key == action_key(image):
        return (
            "its source is older than max_age_days"
            if node.stage.outside
            else "its result is gone from the store"
        )
    record = parse_record(store.backend.get(record_path(last_key)))
    return "; ".join(differences(record.preimage, image, node)) if record else "its last record is gone"


def differences(old: Mapping[str, Any], new: Mapping[str, Any], node: Node | None = None) -> list[str]:
    """What differs between two preimages, one phrase each."""
    found: list[str] = []
    for part in ("inputs", "params", "code", "libraries"):
        before, now = flat(old.get(part, {})), flat(new.get(part, {}))
        changed = (n for n in sorted(before.keys() | now.keys()) if before.get(n) != now.get(n))
        found.extend(_phrase(part, n, before.get(n), now.get(n), node) for n in changed)
    return found


def _phrase(part: str, name: str, before: Any, now: Any, node: Node | None) -> str:
    if part == "inputs":
        ref = node.inputs.get(name) if node else None
        return f"file {ref.name} changed" if isinstance(ref, SourceRef) else f"input {name} changed"
    if part == "code":
        return f"code of {name} changed"
    return f"{'library ' if part == 'libraries' else ''}{name}: {_show(before)} -> {_show(now)}"


def _show(value: Any) -> str:
    return "unset" if value is None else str(value)


def flat(value: Any, prefix: str = "") -> dict[str, Any]:
    """Nested settings by their paths."""
    if not isinstance(value, Mapping):
        return {prefix: value}
    out: dict[str, Any] = {}
    for key, item in value.items():
        out |= flat(item, f"{prefix}.{key}" if prefix else str(key))
    return out
