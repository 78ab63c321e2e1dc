"""Mark and sweep: what no release and no recent run needs leaves the store.

Safe beside runs without a lock. What is younger than the grace period stays, and so does whatever a run uses again
meanwhile, because using counts as new (in a folder; a server tells only when something was written). Should a run
still lose something it relied on, that is a miss: it is made anew, never taken for granted.
"""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from itertools import groupby
from pathlib import Path

from flexmap_tasks.engine.finished import FOLDER as FINISHED
from flexmap_tasks.engine.released import ID_LENGTH, manifests
from flexmap_tasks.engine.runs import RUNS, Run, read_runs
from flexmap_tasks.store.artifact import canonical_json, digest_of, unseal
from flexmap_tasks.store.backend import Entry
from flexmap_tasks.store.store import Store, object_key, record_path

GRACE_S = 86_400.0
"""Longer than any run takes: what is younger may belong to a run that has not finished."""
TEMPORARY = "tmp"


@dataclass(frozen=True, slots=True)
class Swept:
    """What was removed (or would be), and what stays; `bytes` frees, `left_bytes` stay."""

    blobs: int
    records: int
    runs: int
    leftovers: int
    bytes: int
    left_blobs: int
    left_records: int
    left_bytes: int


def collect(
    store: Store, *, keep_runs: int = 3, keep_days: float = 30.0, grace_s: float = GRACE_S, dry_run: bool = False
) -> Swept:  # fmt: skip
    """Remove what neither a release, nor the last runs of a map, nor a run of the last days is made of.

    Records go before blobs, so that no record ever names a blob that was swept before it.
    Raises InputError for a release whose manifest cannot be read: what it needs would be lost.
    """
    blobs = list(store.backend.entries("objects"))  # listed before anything is marked: what comes later stays
    records = list(store.backend.entries("actions"))
    now = _keepers_now(store, dry_run=dry_run)
    released = list(manifests(store))
    ids = {digest_of(canonical_json(manifest))[:ID_LENGTH] for manifest in released}
    old_runs, roots = _runs_to_drop(store, keep_runs, now - keep_days * 86_400, ids)
    roots |= {stage["action"] for manifest in released for stage in manifest["stages"].values()}
    live, needed = _mark(store, roots, (e for e in records if now - e.modified_s < grace_s))

    def age(entry: Entry) -> bool:
        return now - entry.modified_s >= grace_s

    dead_records = [e for e in records if e.key not in live and age(e)]
    dead_blobs = [e for e in blobs if e.key not in needed and age(e)]
    stale_runs = [e for e in store.backend.entries(RUNS) if e.key in old_runs and age(e)]
    gone = {e.key for e in dead_records}
    leftovers = [e for e in store.backend.entries(TEMPORARY) if age(e)]
    leftovers += [e for e in store.backend.entries(FINISHED) if age(e) and _names_any(store, e, gone)]
    torn = [path for path in store.releases.glob("*/.[!.]*") if _written_before(path, now - grace_s)]
    swept = [e for group in (stale_runs, leftovers, dead_records, dead_blobs) for e in group]
    if not dry_run:
        _sweep(store, swept, now, grace_s)
        _remove(torn)
    return Swept(
        len(dead_blobs),
        len(dead_records),
        len(stale_runs),
        len(leftovers) + len(torn),
        sum(e.size for e in swept),
        len(blobs) - len(dead_blobs),
        len(records) - len(dead_records),
        sum(e.size for e in (*blobs, *records)) - sum(e.size for e in (*dead_blobs, *dead_records)),
    )


def _written_before(path: Path, time_s: float) -> bool:
    """Last written before a time; False where another process has finished with it meanwhile."""
    try:
        return path.lstat().st_mtime <= time_s
    except FileNotFoundError:
        return False


def _keepers_now(store: Store, *, dry_run: bool) -> float:
    """The time by the clock that dates the entries: a server's may differ from ours."""
    if dry_run:
        return datetime.now().astimezone().timestamp()
    store.check_writable()
    probe = f"{TEMPORARY}/clock-{secrets.token_hex(8)}"
    store.backend.put(probe, b"", replace=True)
    now = store.backend.modified(probe)
    store.backend.delete(probe)
    return now if now is not None else datetime.now().astimezone().timestamp()


def _runs_to_drop(
    store: Store, keep_runs: int, since: float, released: set[str]
) -> tuple[set[str], set[str]]:
    """Paths of runs that are neither among the last of their map, nor recent, nor released; the others' actions."""
    drop: set[str] = set()
    roots: set[str] = set()
    for _, runs in groupby(read_runs(store), key=_map_of):
        for i, run in enumerate(runs):
            if (
                i < keep_runs
                or run.release in released
                or datetime.fromisoformat(run.finished).timestamp() >= since
            ):
                roots |= set(run.actions.values())
            else:
                drop.add(run.path)
    return drop, roots


def _map_of(run: Run) -> str:
    return run.map


def _mark(store: Store, roots: Iterable[str], young: Iterable[Entry]) -> tuple[set[str], set[str]]:
    """Places of the records that stay, and of the blobs they name."""
    live: set[str] = set()
    needed: set[str] = set()
    waiting = [
        *roots,
        *(e.key.removeprefix("actions/").removesuffix(".json").replace("/", "") for e in young),
    ]
    while waiting:
        fresh = [key for key in dict.fromkeys(waiting) if record_path(key) not in live]
        live |= {record_path(key) for key in fresh}
        found = [record for record in store.map(store.peek, fresh) if record is not None]
        needed |= {object_key(blob.sha256) for record in found for _, blob in record.output.files}
        waiting = [key for record in found for key in record.items.values()]
    return live, needed


def _names_any(store: Store, entry: Entry, gone: set[str]) -> bool:
    body = unseal(store.backend.get(entry.key)) or {}
    return not body or any(record_path(key) in gone for key in body.get("actions", {}).values())


def _sweep(store: Store, entries: Iterable[Entry], now: float, grace_s: float) -> None:
    for entry in entries:
        modified = store.backend.modified(entry.key)
        if modified is not None and now - modified >= grace_s:  # not used again since it was listed
            store.backend.delete(entry.key)


def _remove(paths: Iterable[Path]) -> None:
    """Halves of releases that a killed run left, and damaged ones that were replaced."""
    for path in paths:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def stats(store: Store) -> Iterator[tuple[str, int, int]]:
    """(what, how many, bytes) of everything in the store."""
    for folder in ("objects", "actions", RUNS, FINISHED, "memo", TEMPORARY, "releases"):
        entries = list(store.backend.entries(folder))
        yield folder, len(entries), sum(e.size for e in entries)
