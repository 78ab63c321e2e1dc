"""What a release is made of: stages, actions, settings, inputs, code, and where and when each was computed."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from flexmap_tasks.engine.released import Released
from flexmap_tasks.engine.runs import read_runs
from flexmap_tasks.errors import InputError
from flexmap_tasks.store.store import ActionRecord, Store


@dataclass(frozen=True, slots=True)
class InputFact:
    """An input of a stage.

    name : parameter; origin : the stage (and part) it came from, or the file; digest : of what was read
    """

    name: str
    origin: str
    digest: str


@dataclass(frozen=True, slots=True)
class StageFacts:
    """A stage as it stands in a release.

    files : what of it was released; record : None where the store no longer holds the action's record
    """

    name: str
    action: str
    params: Mapping[str, Any]
    inputs: tuple[InputFact, ...]
    files: tuple[str, ...]
    record: ActionRecord | None

    def modules(self) -> Mapping[str, str]:
        """Digest per code module the stage can reach."""
        return self.record.preimage["code"] if self.record else {}


def explain(store: Store, release: Released) -> list[StageFacts]:
    """All stages, each after those it was fed by."""
    sources = source_files(store, release)
    return [_facts(store, release, stage, sources) for stage in _in_order(release)]


def explain_stage(store: Store, release: Released, stage: str) -> StageFacts:
    """One stage. Raises InputError where the release has none of that name."""
    if stage not in release.manifest["stages"]:
        known = ", ".join(_in_order(release))
        raise InputError(release.id, f"has no stage {stage}; its stages are {known}")
    return _facts(store, release, stage, source_files(store, release))


def source_files(store: Store, release: Released) -> Mapping[str, Mapping[str, Any]]:
    """Files from outside by "stage.input", as the run that made the release was given them; empty if forgotten."""
    runs = (run for run in read_runs(store, release.map) if run.release == release.id)
    run = next(runs, None)
    return run.sources if run else {}


def upstream(release: Released, stage: str) -> list[str]:
    """The stage and all it depends on, nearest first."""
    found: dict[str, None] = {}
    waiting = [stage]
    while waiting:
        name = waiting.pop(0)
        if name in release.manifest["stages"] and name not in found:
            found[name] = None
            waiting += [_stage_of(origin) for origin in release.manifest["stages"][name]["from"].values()]
    return list(found)


def _in_order(release: Released) -> list[str]:
    done: dict[str, None] = {}

    def visit(stage: str) -> None:
        if stage in done or stage not in release.manifest["stages"]:
            return
        for origin in release.manifest["stages"][stage]["from"].values():
            visit(_stage_of(origin))
        done[stage] = None

    for stage in sorted(release.manifest["stages"]):
        visit(stage)
    return list(done)


def _facts(
    store: Store, release: Released, stage: str, sources: Mapping[str, Mapping[str, Any]]
) -> StageFacts:
    said = release.manifest["stages"][stage]
    files = [path for path, entry in release.manifest["files"].items() if entry["stage"] == stage]
    inputs = tuple(_inputs(stage, said, sources))
    return StageFacts(
        stage, said["action"], said["params"], inputs, tuple(sorted(files)), store.peek(said["action"])
    )


def _inputs(
    stage: str, said: Mapping[str, Any], sources: Mapping[str, Mapping[str, Any]]
) -> Iterator[InputFact]:
    for name, origin in sorted(said["from"].items()):
        file = sources.get(f"{stage}.{name}")
        if file is not None:
            yield InputFact(name, str(file["path"]), str(file["sha256"]))
        else:
            yield InputFact(name, origin, str(said["inputs"].get(name, "")))


def _stage_of(origin: str) -> str:
    return re.split(r"[. ,]", origin, maxsplit=1)[0]
