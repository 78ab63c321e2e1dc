"""Copying between stores: blobs first, then the records that name them, so that it may stop anywhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from flexmap_tasks.engine.release import push_files, restore
from flexmap_tasks.engine.released import ID_LENGTH, manifests
from flexmap_tasks.engine.runs import RUNS
from flexmap_tasks.store.artifact import Artifact, Blob, canonical_json, digest_of, unseal
from flexmap_tasks.store.backend import FolderBackend
from flexmap_tasks.store.store import ActionRecord, CorruptBlobError, Store, object_key, record_path

NOTES = (RUNS, "verdicts")
"""What tells of runs and decisions; small, sealed, and the same under the same name."""


@dataclass(frozen=True, slots=True)
class Copied:
    """What was sent; `skipped` records were not whole in the store they come from."""

    blobs: int
    bytes: int
    records: int
    skipped: int
    releases: int


def copy_missing(
    source: Store, target: Store, progress: Callable[[int], None] = lambda _records: None
) -> Copied:
    """Bring every whole record of `source` with its blobs, and its runs, to `target`, as far as missing there."""
    target.check_writable()
    known = {entry.key: entry.size for entry in target.backend.entries("objects")}
    there = {entry.key for entry in target.backend.entries("actions")}
    blobs = size = records = skipped = 0
    for record in source.records():
        missing = {b for _, b in record.output.files if known.get(object_key(b.sha256)) != b.size}
        try:
            for blob in _send(source, target, missing):
                known[object_key(blob.sha256)] = blob.size
                blobs, size = blobs + 1, size + blob.size
        except CorruptBlobError:
            skipped += 1
            continue
        if _put(target, record, there):
            records += 1
            progress(records)
    _copy_notes(source, target)
    return Copied(blobs, size, records, skipped, _copy_releases(source, target))


def _send(source: Store, target: Store, missing: set[Blob]) -> Iterator[Blob]:
    def one(blob: Blob) -> Blob:
        return target.put_blob(source.read_blob(blob))

    return target.map(one, sorted(missing, key=lambda blob: blob.sha256))


def _put(target: Store, record: ActionRecord, there: set[str]) -> bool:
    """A record that is there counts, unless it cannot be trusted."""
    if record_path(record.key) in there and target.find(record.key) is not None:
        return False
    target.put_record(record)
    return True


def _copy_notes(source: Store, target: Store) -> None:
    for folder in NOTES:
        there = {entry.key for entry in target.backend.entries(folder)}
        for entry in source.backend.entries(folder):
            content = source.backend.get(entry.key)
            if entry.key not in there and unseal(content) is not None and content is not None:
                target.backend.put(entry.key, content)


def _copy_releases(source: Store, target: Store) -> int:
    """Releases whose content has arrived; `latest` of the other side is for the other side to move."""
    there = {canonical_json(manifest) for manifest in manifests(target)}
    copied = 0
    for manifest in manifests(source):
        content = canonical_json(manifest)
        blobs = Artifact.of({f: Blob(e["sha256"], e["size"]) for f, e in manifest["files"].items()})
        if content not in there and target.has(blobs):
            folder = target.releases / manifest["map"] / digest_of(content)[:ID_LENGTH]
            restore(target, folder, manifest)
            if not isinstance(target.backend, FolderBackend):
                push_files(target, manifest["map"], folder)
            there.add(content)
            copied += 1
    return copied
