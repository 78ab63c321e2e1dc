"""Items computed by the workers of a Dask cluster, which share the store with whoever asks.

What is sent is small: names, digests and what an item's inputs were narrowed to. A worker reads the item from the
store and puts its result there; the record comes back. Hits were resolved before: nothing is sent that is there.
"""

from __future__ import annotations

import functools
import socket
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexmap_tasks.config import Params
from flexmap_tasks.engine.items import ItemJob, ItemRunner, ItemStage, compute_item
from flexmap_tasks.engine.keys import CODECS
from flexmap_tasks.errors import FlexMapError
from flexmap_tasks.store.backend import FolderBackend
from flexmap_tasks.store.store import ActionRecord, Store

if TYPE_CHECKING:
    from flexmap_tasks.engine.execute import Engine

CONNECT_S = 30


class DaskError(FlexMapError):
    """The cluster cannot do what was asked; nothing that was stored is lost."""


@dataclass(frozen=True, slots=True)
class RemoteJob:
    """One item with all that a worker needs; `store` is an address that it reaches as well."""

    store: str
    module: str
    stage: str
    params: Params | None
    each: str
    job: ItemJob


def on_dask(address: str) -> ItemRunner:
    """A runner that hands items to the cluster of the scheduler at an address. Raises DaskError."""

    def run(engine: Engine, of: ItemStage, jobs: Sequence[ItemJob]) -> Iterator[tuple[int, ActionRecord]]:
        if not jobs:
            return
        from distributed import CancelledError, KilledWorker, as_completed  # noqa: PLC0415 - an optional library

        client = _client(address)
        module, name = of.stage.function.__module__, of.stage.name
        store = _address(engine.store)
        sent = [RemoteJob(store, module, name, of.params, of.each, job) for job in jobs]
        futures = client.map(compute_there, sent, pure=False, retries=0, key=f"{name}")
        numbers = {future.key: i for i, future in enumerate(futures)}
        try:
            for future, record in as_completed(futures, loop=client.loop, with_results=True):  # type: ignore[no-untyped-call]
                yield numbers[future.key], record
        except (KilledWorker, CancelledError, OSError) as error:
            raise DaskError(f"Dask at {address}: {_first_line(error)}; run again") from error
        finally:
            client.cancel(futures)

    return run


def compute_there(remote: RemoteJob) -> ActionRecord:
    """What a worker does."""
    from flexmap_tasks.engine.execute import Engine  # noqa: PLC0415 - the engine knows this module

    stage = getattr(import_module(remote.module), remote.stage)
    _refuse_other_code(remote)
    engine = Engine(_store(remote.store))
    return compute_item(engine, ItemStage(stage, remote.params, remote.each), remote.job)


def _refuse_other_code(remote: RemoteJob) -> None:
    """A result must not be stored under the name of code that did not make it."""
    from flexmap_tasks.engine.fingerprint import code_modules  # noqa: PLC0415 - reads all sources
    from flexmap_tasks.engine.libraries import library_versions  # noqa: PLC0415

    image = remote.job.image
    if image["code"] != code_modules(remote.module, *CODECS) or image["libraries"] != library_versions():
        host = socket.gethostname()
        raise DaskError(f"Dask worker on {host} runs other code or other libraries than this run; restart it")


@functools.cache
def _store(address: str) -> Store:
    return Store.open(address)


def _address(store: Store) -> str:
    folder = isinstance(store.backend, FolderBackend)
    return str(Path(store.backend.url).resolve()) if folder else store.backend.url


@functools.cache
def _client(address: str) -> Any:
    try:
        from distributed import Client  # noqa: PLC0415 - an optional library
    except ImportError:
        raise DaskError("FLEXMAP_DASK is set, but Dask is not installed: pip install flexmap[dask]") from None
    try:
        return Client(address, timeout=CONNECT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise DaskError(f"Dask scheduler {address} cannot be reached ({_first_line(error)})") from error


def _first_line(error: BaseException) -> str:
    return next(iter(str(error).splitlines()), "") or type(error).__name__
