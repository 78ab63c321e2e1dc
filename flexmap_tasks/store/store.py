"""The content-addressed store: blobs by digest, action records by key.

objects/ab/cdef...        content by its sha-256; checked whenever it is read
actions/ab/cdef....json   what an action wrote, with the whole preimage of its key and a checksum of its own
A record counts only while it is valid and all its blobs are there in the right size; anything else is a miss.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from flexmap_tasks.errors import StoreError
from flexmap_tasks.store.artifact import Artifact, Blob, digest_of, seal, unseal
from flexmap_tasks.store.backend import Backend, FolderBackend

FORMAT = 1
RELEASES = Path("artifacts/releases")
"""Where releases of a store go that is no folder."""

T = TypeVar("T")
U = TypeVar("U")


class CorruptBlobError(Exception):
    """A blob did not hold what its name says; it was removed, so that the next run makes it anew."""


@dataclass(frozen=True, slots=True)
class ActionRecord:
    """What one run of a stage was given, and what it made.

    key : action key; preimage : all that the key is made of
    output : the artifact; seconds : time it took; started : RFC 3339; host : machine
    items : action key per item where the stage ran once per item
    """

    key: str
    preimage: dict[str, Any]
    output: Artifact
    seconds: float
    started: str
    host: str
    items: dict[str, str] = field(default_factory=dict)


class Store:
    """Blobs and records over a backend; `releases` is the folder where people find what was made."""

    def __init__(self, backend: Backend, releases: Path | None = None) -> None:
        self.backend = backend
        self.releases = releases or RELEASES

    @classmethod
    def open(cls, url: str | Path, releases: Path | None = None) -> Store:
        """The store at a folder, or at `s3://bucket/prefix` with what the environment says about the server."""
        if str(url).startswith("s3://"):
            from flexmap_tasks.store.s3 import S3Backend  # noqa: PLC0415 - folders need no client

            return cls(S3Backend.open(str(url)), releases)
        if "://" in str(url):
            raise StoreError(f"artifact store {url}: expected a folder or s3://bucket/prefix")
        return cls(FolderBackend(Path(url)), releases or Path(url) / "releases")

    def put_blob(self, content: bytes) -> Blob:
        """Store content once."""
        blob = Blob(digest_of(content), len(content))
        key = object_key(blob.sha256)
        size = self.backend.size(key)
        if size == blob.size:
            self.backend.renew(key)
            return blob
        if size is not None:
            self.backend.delete(key)
        self.backend.put(key, content)
        return blob

    def read_blob(self, blob: Blob) -> bytes:
        """The content, checked against its digest."""
        content = self.backend.get(object_key(blob.sha256))
        if content is None or digest_of(content) != blob.sha256:
            if content is not None:
                self.backend.delete(object_key(blob.sha256))
            raise CorruptBlobError(blob.sha256)
        return content

    def local_blob(self, blob: Blob) -> Path:
        """A path to the content, checked now."""
        self.read_blob(blob)
        return self.backend.local(object_key(blob.sha256))

    def has(self, artifact: Artifact) -> bool:
        """Every blob is there in the right size."""
        return all(self.map(self._has_blob, {blob for _, blob in artifact.files}))

    def find(self, key: str) -> ActionRecord | None:
        """The record of an action if it can be trusted and all that it made is there."""
        record = self.peek(key)
        return record if record is not None and self.has(record.output) else None

    def find_all(self, keys: Iterable[str]) -> list[ActionRecord] | None:
        """The records of several actions, or None when one cannot be trusted or something it made is missing."""
        records = [record for record in self.map(self.peek, keys) if record is not None]
        blobs = {blob for record in records for _, blob in record.output.files}
        whole = len(records) == len(list(keys)) and all(self.map(self._has_blob, blobs))
        return records if whole else None

    def peek(self, key: str) -> ActionRecord | None:
        """The record of an action if it can be trusted, whether what it made is there or not."""
        record = parse_record(self.backend.get(record_path(key)))
        return record if record is not None and record.key == key else None

    def renew(self, record: ActionRecord) -> None:
        """Let a record that is used again, and what it made, count as new for `gc`."""
        self.backend.renew(record_path(record.key))
        for _, blob in record.output.files:
            self.backend.renew(object_key(blob.sha256))

    def put_record(self, record: ActionRecord, *, replace: bool = False) -> ActionRecord:
        """Remember an action; where another writer was first, its record counts (unless `replace`)."""
        content = format_record(record)
        if not replace:
            self.backend.put(record_path(record.key), content)
            first = self.find(record.key)
            if first is not None:
                return first
        self.backend.put(record_path(record.key), content, replace=True)
        return record

    def map(self, function: Callable[[T], U], items: Iterable[T]) -> Iterator[U]:
        """The function of every item, several at once where the backend likes that."""
        if self.backend.at_once == 1:
            return map(function, items)
        with ThreadPoolExecutor(max_workers=self.backend.at_once) as pool:
            return iter(list(pool.map(function, items)))

    def _has_blob(self, blob: Blob) -> bool:
        return self.backend.size(object_key(blob.sha256)) == blob.size

    def records(self) -> Iterator[ActionRecord]:
        """All valid records, whether their blobs are there or not."""
        for entry in self.backend.entries("actions"):
            record = parse_record(self.backend.get(entry.key))
            if record is not None:
                yield record

    def check_writable(self) -> None:
        """Raise StoreError before any work is done in vain."""
        probe = f"tmp/probe-{secrets.token_hex(8)}"
        self.backend.put(probe, b"flexmap", replace=True)
        if self.backend.get(probe) != b"flexmap":
            raise StoreError("artifact store: what was written does not read back")
        self.backend.delete(probe)


class ArtifactFiles:
    """The files of an artifact as `formats.artifacts` reads them."""

    def __init__(self, store: Store, artifact: Artifact) -> None:
        self._store, self._artifact = store, artifact
        self._blobs = dict(artifact.files)

    def names(self) -> list[str]:
        """All paths, sorted."""
        return self._artifact.names()

    def read(self, name: str) -> bytes:
        """Verified content."""
        return self._store.read_blob(self._blobs[name])

    def local(self, name: str) -> Path:
        """A path with verified content."""
        return self._store.local_blob(self._blobs[name])

    def sub(self, prefix: str) -> ArtifactFiles:
        """The files below a prefix."""
        return ArtifactFiles(self._store, self._artifact.sub(prefix))


def object_key(sha256: str) -> str:
    """Where a blob lives."""
    return f"objects/{sha256[:2]}/{sha256[2:]}"


def record_path(key: str) -> str:
    """Where a record lives."""
    return f"actions/{key[:2]}/{key[2:]}.json"


def format_record(record: ActionRecord) -> bytes:
    """A record as a sealed document."""
    return seal(
        {
            "format": FORMAT,
            "key": record.key,
            "preimage": record.preimage,
            "output": record.output.to_json(),
            "seconds": record.seconds,
            "started": record.started,
            "host": record.host,
            "items": record.items,
        }
    )


def parse_record(content: bytes | None) -> ActionRecord | None:
    """The record, or None when it is absent, damaged, cut short or of another format."""
    body = unseal(content)
    if body is None or body.get("format") != FORMAT:
        return None
    try:
        output = Artifact.from_json(body["output"])
        return ActionRecord(
            body["key"],
            body["preimage"],
            output,
            body["seconds"],
            body["started"],
            body["host"],
            body["items"],
        )
    except (ValueError, KeyError, TypeError):
        return None
