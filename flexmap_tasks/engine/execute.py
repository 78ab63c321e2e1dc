"""Running one node: look it up, or load its inputs, call the function and store what it returns."""

from __future__ import annotations

import contextlib
import socket
import time
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

from flexmap_tasks.config import Params
from flexmap_tasks.engine.fingerprint import learn_code
from flexmap_tasks.engine.graph import Input, Node, SourceRef
from flexmap_tasks.engine.items import ItemJob, ItemStage, collect, item_runner, prepare
from flexmap_tasks.engine.keys import action_key, arguments, input_types, preimage
from flexmap_tasks.engine.sources import Stamp, file_stamp, local_path, source_artifact
from flexmap_tasks.engine.stage import AnyStage
from flexmap_tasks.errors import InputError, StoreError
from flexmap_tasks.formats.artifacts import decode, encode
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.source import Source
from flexmap_tasks.store.artifact import Artifact, canonical_json, digest_of
from flexmap_tasks.store.store import ActionRecord, ArtifactFiles, Store

CODE_MEMO = "memo/code.json"
"""What parsing the package found, so that the next process need not."""

Progress = Callable[[int, int], None]
"""(items done, items in all) of a stage that runs per item."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a node.

    cached : nothing ran; seconds : compute time when it was made; computed : items that ran, of `items`
    """

    name: str
    key: str
    artifact: Artifact
    cached: bool
    seconds: float
    computed: int = 0
    items: int = 1


@dataclass(frozen=True, slots=True)
class Bound:
    """An input with its content known: an artifact under a base name, a file from outside, or bare keys."""

    digest: str
    artifact: Artifact
    name: str
    source: SourceRef | None = None
    stamp: Stamp | None = None
    keys: tuple[str, ...] | None = None


class Engine:
    """A store, and values decoded from it during one run."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self._values: dict[tuple[str, str, str], Any] = {}
        self._item_runner = item_runner()
        memo = learn_code(store.backend.get(CODE_MEMO))
        if memo is not None:
            with contextlib.suppress(StoreError):  # a plan may be asked of a store that is read-only
                store.backend.put(CODE_MEMO, memo, replace=True)

    def bind(self, ref: Input, artifacts: Mapping[str, Artifact]) -> Bound:
        """An input as content; `artifacts` holds what the nodes before have made."""
        if isinstance(ref, SourceRef):
            stamp = file_stamp(ref.path)
            artifact = source_artifact(self.store, ref.path)
            return Bound(artifact.digest, artifact, ref.name, ref, stamp)
        artifact = ref.select(artifacts[ref.node])
        if ref.keys_only:
            keys = tuple(artifact.sub(f"{ref.name}/").items())
            return Bound(digest_of(canonical_json(keys)), artifact, ref.name, keys=keys)
        return Bound(artifact.digest, artifact, ref.name)

    def image(self, node: Node, bound: Mapping[str, Bound]) -> dict[str, Any]:
        """Preimage of the node's action key."""
        image = preimage(node.stage, node.params, {n: b.digest for n, b in bound.items()})
        return {**image, "each": node.each} if node.each else image

    def find(self, node: Node, image: Mapping[str, Any]) -> ActionRecord | None:
        """A record that can stand for the node, if there is one young enough."""
        record = self.store.find(action_key(image))
        max_age_days = getattr(node.params, "max_age_days", None) if node.stage.outside else None
        if record is not None and max_age_days is not None:
            age = datetime.now(UTC) - datetime.fromisoformat(record.started)
            if age > timedelta(days=max_age_days):
                return None
        return record

    def run(self, node: Node, bound: Mapping[str, Bound], progress: Progress | None = None) -> Outcome:
        """The node's outcome, from the store or computed now."""
        image = self.image(node, bound)
        record = self.find(node, image)
        if record is not None:
            self.store.renew(record)
            return Outcome(node.name, record.key, record.output, cached=True, seconds=record.seconds)
        if node.each:
            return self._run_each(node, bound, image, progress or (lambda _done, _all: None))
        record = self.compute(node.stage, node.params, image, self._load_inputs(node, bound))
        _check_unchanged(bound)
        record = self._remember(node, record)
        return Outcome(node.name, record.key, record.output, cached=False, seconds=record.seconds, computed=1)

    def load(self, bound: Bound, kind: Any) -> Any:
        """The value of an input; the same object when it is asked for again."""
        if bound.source is not None:
            ((_, blob),) = bound.artifact.files
            return Source(bound.name, local_path(bound.source.path, blob.sha256))
        if bound.keys is not None:
            keys_of = next((a for a in typing.get_args(kind) if a is not type(None)), kind)
            return keys_of(strings(bound.keys))
        key = (bound.digest, bound.name, repr(kind))
        if key not in self._values:
            self._values[key] = decode(kind, ArtifactFiles(self.store, bound.artifact), bound.name)
        return self._values[key]

    def _load_inputs(self, node: Node, bound: Mapping[str, Bound]) -> dict[str, Any]:
        kinds = input_types(node.stage)
        return {name: self.load(b, kinds[name]) for name, b in bound.items()}

    def compute(
        self, stage: AnyStage, params: Params | None, image: Mapping[str, Any], values: Mapping[str, Any]
    ) -> ActionRecord:
        """Call the stage and store what it makes; the record is not put there yet."""
        started, clock = datetime.now(UTC), time.perf_counter()
        given = arguments(stage, values)
        if params is not None:
            given["params"] = params
        value = stage.function(**given)
        files = {path: self.store.put_blob(content) for path, content in encode(value, stage.artifact)}
        seconds = time.perf_counter() - clock
        host = socket.gethostname()
        key = action_key(image)
        return ActionRecord(key, dict(image), Artifact.of(files), seconds, started.isoformat(), host)

    def _remember(self, node: Node, record: ActionRecord) -> ActionRecord:
        """The record that counts: another process may have been first with the same action."""
        return self.store.put_record(record, replace=node.stage.outside)

    def _run_each(
        self, node: Node, bound: Mapping[str, Bound], image: Mapping[str, Any], progress: Progress
    ) -> Outcome:
        """One action per item, each cached on its own; then one for the whole, so that a rerun asks once."""
        assert node.each is not None  # noqa: S101 - told by the caller, for the type checker
        started = datetime.now(UTC)
        items = bound[node.each].artifact.sub(f"{bound[node.each].name}/").items()
        others = {n: b for n, b in bound.items() if n != node.each}
        values = {n: self.load(b, input_types(node.stage)[n]) for n, b in others.items()}

        jobs = [prepare(node, image, key, item, others, values) for key, item in items.items()]
        done = dict(enumerate(self.store.map(self._find_item, jobs)))
        found = {i: record for i, record in done.items() if record is not None}
        missing = [i for i in done if i not in found]
        progress(len(found), len(items))
        of = ItemStage(node.stage, node.params, node.each)
        for number, record in self._item_runner(self, of, [jobs[i] for i in missing]):
            found[missing[number]] = self._remember(node, record)
            progress(len(found), len(items))
        records = [found[i] for i in range(len(jobs))]
        files = collect(node.stage.artifact, zip(items, records, strict=True))
        seconds = sum(record.seconds for record in records)
        whole = ActionRecord(
            action_key(image),
            dict(image),
            Artifact.of(files),
            seconds,
            started.isoformat(),
            socket.gethostname(),
            {item: record.key for item, record in zip(items, records, strict=True)},
        )
        whole = self._remember(node, whole)
        return Outcome(
            node.name,
            whole.key,
            whole.output,
            cached=False,
            seconds=seconds,
            computed=len(missing),
            items=len(items),
        )

    def _find_item(self, job: ItemJob) -> ActionRecord | None:
        record = self.store.find(action_key(job.image))
        if record is not None:
            self.store.renew(record)
        return record


def _check_unchanged(bound: Mapping[str, Bound]) -> None:
    """A source that was written to while a stage read it must not become a result under its old digest."""
    for b in bound.values():
        if b.source is not None and file_stamp(b.source.path) != b.stamp:
            raise InputError(b.name, "changed while it was read; run again when it is complete")
