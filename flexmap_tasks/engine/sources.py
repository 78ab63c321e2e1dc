"""Files from outside: digested once, remembered by path, size, times and inode."""

from __future__ import annotations

import hashlib
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

from flexmap_tasks.errors import InputError
from flexmap_tasks.model.source import bucket_url
from flexmap_tasks.store.artifact import Artifact, Blob, digest_of, seal, unseal
from flexmap_tasks.store.store import Store

if TYPE_CHECKING:
    from flexmap_tasks.store.bucket import BucketFile

RACY_NS = 2_000_000_000
"""A file younger than this may still change within the resolution of its time stamp: it is not remembered."""

Stamp = tuple[int, int, int, int]
"""Size, time of the last write, time of the last change of the entry (nobody can set it back), inode."""

Look = list[int]
"""The same as a sealed document holds it; empty where there is no such file."""


def look(path: Path | str) -> Look:
    """What a file looks like from outside, on this machine or in a bucket."""
    url = bucket_url(path)
    if url is not None:
        return list(_bucket_stamp(url) or ())
    try:
        stat = os.stat(path)  # noqa: PTH116 - asked of every file: a Path costs more than the answer
    except OSError:
        return []
    return [stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_ino]


def stamp_of(file: BucketFile) -> Stamp:
    """What an object looks like from outside; its ETag, which changes with its content, stands for the inode."""
    written_ns = file.modified_s * 1_000_000_000
    return file.size, written_ns, written_ns, int(digest_of(file.etag.encode())[:12], 16)


def is_old(seen: Look, now_ns: int) -> bool:
    """The file was there, and its stamp told old enough that a later change would show."""
    return bool(seen) and max(seen[1], seen[2]) < now_ns - RACY_NS


def file_stamp(path: Path) -> Stamp:
    """What a file looks like from outside; InputError when there is no such file."""
    url = bucket_url(path)
    if url is not None:
        found = _bucket_stamp(url)
        if found is None:
            raise InputError(url, "no such object; check the address in the config")
        return found
    try:
        stat = path.stat()
    except OSError as error:
        raise InputError(
            str(path), f"no such file ({error.strerror}); check the path in the config"
        ) from error
    if not path.is_file():
        raise InputError(str(path), "is not a file; the config needs the path of a file here")
    return stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_ino


def source_artifact(store: Store, path: Path) -> Artifact:
    """The file as an artifact, digested now or remembered from before."""
    stamp = file_stamp(path)
    memo = f"memo/{digest_of((bucket_url(path) or str(path.resolve())).encode())}.json"
    sha256 = _remembered(store.backend.get(memo), stamp)
    if sha256 is None:
        sha256 = _digest_file(local_path(path))
        if file_stamp(path) != stamp:
            raise InputError(path.name, "changed while it was read; run again when it is complete")
        if time.time_ns() - max(stamp[1], stamp[2]) > RACY_NS:
            store.backend.put(memo, seal({"stamp": list(stamp), "sha256": sha256}), replace=True)
    return Artifact.of({"source": Blob(sha256, stamp[0])})


def local_path(path: Path, sha256: str | None = None) -> Path:
    """Where the file can be read; one in a bucket is fetched, and checked against what it is known to hold."""
    url = bucket_url(path)
    if url is None:
        return path
    from flexmap_tasks.store.bucket import fetch, look_at  # noqa: PLC0415 - files need no client

    found = look_at(url)
    if found is None:
        raise InputError(url, "no such object; check the address in the config")
    return fetch(found, sha256)


def shown_path(path: Path) -> str:
    """The file as a person finds it again."""
    return bucket_url(path) or str(path.absolute())


def _bucket_stamp(url: str) -> Stamp | None:
    from flexmap_tasks.store.bucket import look_at  # noqa: PLC0415 - files need no client

    found = look_at(url)
    return stamp_of(found) if found is not None else None


def _remembered(content: bytes | None, stamp: Stamp) -> str | None:
    memo = unseal(content)
    return str(memo["sha256"]) if memo and tuple(memo["stamp"]) == stamp else None


def _digest_file(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(str(path), f"cannot be read ({error.strerror})") from error
