"""Stages that run once per item: what is in the store is found first; only the rest is computed, wherever that is."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flexmap_tasks.config import Params
from flexmap_tasks.engine.keys import input_types
from flexmap_tasks.engine.stage import AnyStage
from flexmap_tasks.formats.artifacts import decode
from flexmap_tasks.store.artifact import Artifact, Blob, canonical_json, digest_of
from flexmap_tasks.store.store import ActionRecord, ArtifactFiles

if TYPE_CHECKING:
    from flexmap_tasks.engine.execute import Bound, Engine
    from flexmap_tasks.engine.graph import Node

DASK = "FLEXMAP_DASK"
"""Environment variable with the address of a Dask scheduler that takes items; without it they run in threads."""


@dataclass(frozen=True, slots=True)
class ItemJob:
    """One item to compute.

    key : the item's; image : preimage of its action; item : its files
    shared : inputs that are the same for all items; own : values of those that were narrowed to this one
    """

    key: str
    image: Mapping[str, Any]
    item: Artifact
    shared: Mapping[str, Bound]
    own: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ItemStage:
    """What all jobs of a node have in common; `each` names the input that is the item."""

    stage: AnyStage
    params: Params | None
    each: str


ItemRunner = Callable[["Engine", ItemStage, Sequence[ItemJob]], Iterator[tuple[int, ActionRecord]]]
"""Computes jobs; yields number and record of each as it is done. Records are not yet put into the store."""


def prepare(
    node: Node, image: Mapping[str, Any], key: str, item: Artifact, others: Mapping[str, Bound],
    values: Mapping[str, Any],
) -> ItemJob:  # fmt: skip
    """The job of one item, with its other inputs restricted to what concerns it; `image` is the whole node's."""
    own = dict(node.narrow(key, values)) if node.narrow is not None else {}
    shared = {name: bound for name, bound in others.items() if name not in own}
    digests = {name: bound.digest for name, bound in others.items()}
    digests |= {name: digest_of(canonical_json(_told(value))) for name, value in own.items()}
    each = str(node.each)
    mine = {name: part for name, part in image.items() if name != "each"}
    mine["inputs"] = {**digests, each: _rename(item, key, each).digest}
    return ItemJob(key, mine, item, shared, own)


def compute_item(engine: Engine, of: ItemStage, job: ItemJob) -> ActionRecord:
    """Run the stage for one item and store what it makes."""
    kinds = input_types(of.stage)
    values = {name: engine.load(bound, kinds[name]) for name, bound in job.shared.items()}
    item = decode(kinds[of.each], ArtifactFiles(engine.store, job.item), job.key)
    return engine.compute(of.stage, of.params, job.image, {**values, **job.own, of.each: item})


def in_threads(engine: Engine, of: ItemStage, jobs: Sequence[ItemJob]) -> Iterator[tuple[int, ActionRecord]]:
    """Items in this process, as many at once as it has processors."""
    with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
        waiting = {pool.submit(compute_item, engine, of, job): i for i, job in enumerate(jobs)}
        try:
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        finally:
            for future in waiting:
                future.cancel()


def item_runner() -> ItemRunner:
    """Threads of this process, or Dask where the environment names a scheduler."""
    address = os.environ.get(DASK)
    if not address:
        return in_threads
    from flexmap_tasks.engine.dask_items import on_dask  # noqa: PLC0415 - an optional library

    return on_dask(address)


def collect(base: str, records: Iterable[tuple[str, ActionRecord]]) -> dict[str, Blob]:
    """The items' files under `<base>/<key>...`: a single file keeps only its suffix, a folder becomes the key's."""
    files: dict[str, Blob] = {}
    for key, record in records:
        for path, blob in record.output.files:
            head, slash, rest = path.partition("/")
            suffix = f"/{rest}" if slash else "".join(head.partition(".")[1:])
            files[f"{base}/{key}{suffix}"] = blob
    return files


def _rename(item: Artifact, key: str, name: str) -> Artifact:
    """The item with its key taken out of the paths, so that equal content has equal digests wherever it lies."""
    return Artifact.of({f"{name}{path[len(key) :]}": blob for path, blob in item.files})


def _told(value: Any) -> Any:
    """A value that was never stored, as JSON that names all it holds: arrays by type, shape and digest."""
    if isinstance(value, np.ndarray):
        content = canonical_json(value.tolist()) if value.dtype == object else value.tobytes()
        return [value.dtype.str, value.shape, digest_of(content)]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return [
            type(value).__name__,
            {f.name: _told(getattr(value, f.name)) for f in dataclasses.fields(value)},
        ]
    if isinstance(value, Mapping):
        return {key: _told(item) for key, item in value.items()}
    return value
