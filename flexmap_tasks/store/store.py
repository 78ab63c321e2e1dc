"""The content-addressed store: blobs by digest, action records by key.

objects/ab/cdef...        content by its sha-256; checked whenever it is read
actions/ab/cdef....json   what an action wrote, with the whole preimage of its key and a checksum of its own
A record counts only while it is valid and all its blobs are there in the right size; anything else is a miss.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexmap_tasks.errors import StoreError
from flexmap_tasks.store.artifact import Artifact, Blob, digest_of, seal, unseal
from flexmap_tasks.store.backend import Backend, FolderBackend

FORMAT = 1


class CorruptBlobError(Exception):
    """A blob did not hold what its name says; it was removed, so that the next run makes it anew."""


@dataclass(frozen=True, slots=True)
class ActionRecord:
    """What one run of a stage was given, and what it made.

    key : action key; preimage : all that the key is made of
    output : the artifact; seconds : time it took; started : RFC 3339; host : machine
    """

    key: str
    preimage: dict[str, Any]
    output: Artifact
    seconds: float
    started: str
    host: str


class Store:
    """Blobs and records over a backend."""

    def __init__(self, backend: Backend) -> None:
        self.backend = backend

    @classmethod
    def open(cls, url: str | Path) -> Store:
        """The store at a folder."""
        return cls(FolderBackend(Path(url)))

    def put_blob(self, content: bytes) -> Blob:
        """Store content once."""
        blob = Blob(digest_of(content), len(content))
        if self.backend.size(object_key(blob.sha256)) != blob.size:
            self.backend.delete(object_key(blob.sha256))
            self.backend.put(object_key(blob.sha256), content)
        return blob

    def read_blob(self, blob: Blob) -> bytes:
        """The content, checked against its digest."""
        content = self.backend.get(object_key(blob.sha256))
        if content is None or digest_of(content) != blob.sha256:
            self.backend.delete(object_key(blob.sha256))
            raise CorruptBlobError(blob.sha256)
        return content

    def local_blob(self, blob: Blob) -> Path:
        """A path to the content, checked now."""
        self.read_blob(blob)
        return self.backend.local(object_key(blob.sha256))

    def has(self, artifact: Artifact) -> bool:
        """Every blob is there in the right size."""
        return all(self.backend.size(object_key(b.sha256)) == b.size for _, b in artifact.files)

    def find(self, key: str) -> ActionRecord | None:
        """The record of an action if it can be trusted and all that it made is there."""
        record = parse_record(self.backend.get(record_path(key)))
        return record if record is not None and record.key == key and self.has(record.output) else None

    def put_record(self, record: ActionRecord, *, replace: bool = False) -> ActionRecord:
        """Remember an action; where another writer was first, its record counts (unless `replace`)."""
        first = self.find(record.key)
        if first is not None and not replace:
            return first
        self.backend.put(record_path(record.key), format_record(record), replace=True)
        return record

    def records(self) -> Iterator[ActionRecord]:
        """All valid records, whether their blobs are there or not."""
        for key in self.backend.list("actions"):
            record = parse_record(self.backend.get(key))
            if record is not None:
                yield record

    def check_writable(self) -> None:
        """Raise StoreError before any work is done in vain."""
        probe = "tmp/probe"
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
            body["key"], body["preimage"], output, body["seconds"], body["started"], body["host"]
        )
    except (ValueError, KeyError, TypeError):
        return None
