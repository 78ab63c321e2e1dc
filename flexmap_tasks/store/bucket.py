"""Input files in buckets: looked at without reading them, and fetched whole into a local folder before a stage reads.

Server and credentials come from the environment alone, as for a store on a server (`s3`). What is fetched lies in the
cache by address, ETag and size; a fetch that broke off goes on where it stopped, as long as the object is the same.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import obstore
from obstore.exceptions import PreconditionError
from obstore.store import S3Store

from flexmap_tasks.errors import InputError, StoreError
from flexmap_tasks.store.artifact import digest_of
from flexmap_tasks.store.s3 import ABSENT, FAULTS, cache_folder, explain, open_bucket

ATTEMPTS = 5
"""How often a fetch goes on after the connection broke without a byte having come."""

CHUNK_BYTES = 256 * 1024
"""What has not come in whole is lost when the connection breaks."""
PLAIN_MD5 = re.compile(r"[0-9a-f]{32}")
"""ETag of an object that was uploaded at once; one uploaded in parts has a dash."""


@dataclass(frozen=True, slots=True)
class BucketFile:
    """An object, as the server describes it.

    url : s3://bucket/key; etag : changes with the content; modified_s : whole seconds since 1970, server's clock
    """

    url: str
    size: int
    etag: str
    modified_s: int


def look_at(url: str) -> BucketFile | None:
    """The object as it is now; None when there is none. Raises StoreError when the server cannot be asked."""
    bucket, key = _parts(url)
    try:
        return _described(url, obstore.head(_client(bucket), key))
    except ABSENT:
        return None
    except FAULTS as error:
        raise _fault(error, url) from error


def list_files(url: str) -> Iterator[BucketFile]:
    """All objects below a prefix. Raises StoreError when the server cannot be asked."""
    bucket, prefix = _parts(f"{url.rstrip('/')}/")
    try:
        for page in obstore.list(_client(bucket), prefix=prefix or None):
            for found in page:
                yield _described(f"s3://{bucket}/{found['path']}", found)
    except FAULTS as error:
        raise _fault(error, url) from error


def fetch(file: BucketFile, sha256: str | None = None) -> Path:
    """A local file with the whole content, that of `sha256` if it is known. Raises InputError, StoreError."""
    endpoint = os.environ.get("AWS_ENDPOINT_URL", "")
    name = digest_of(f"{endpoint} {file.url} {file.etag} {file.size}".encode())
    target = cache_folder() / "inputs" / name[:2] / name[2:]
    target.parent.mkdir(parents=True, exist_ok=True)
    with _alone(target.with_suffix(".lock")):
        if target.is_file() and _is_whole(target, file, sha256):
            return target
        part = target.with_suffix(".part")
        _go_on(file, part)
        if not _is_whole(part, file, sha256):
            part.unlink()
            raise StoreError(f"bucket file {file.url}: what came is not what the server described; run again")
        part.replace(target)
    return target


def _go_on(file: BucketFile, part: Path) -> None:
    """Fetch what is missing of the object, as often as it takes while something comes."""
    idle = 0
    while (have := part.stat().st_size if part.exists() else 0) != file.size or not part.exists():
        if have > file.size:
            part.unlink()
            continue
        try:
            _append(file, part, have)
        except PreconditionError:
            raise InputError(file.url, "changed while it was fetched; run again") from None
        except ABSENT:
            raise InputError(file.url, "is gone from the bucket") from None
        except FAULTS as error:
            idle = idle + 1 if part.exists() and part.stat().st_size == have else 0
            if idle >= ATTEMPTS or not _from_the_server(error):
                raise _fault(error, file.url) from error


def _append(file: BucketFile, part: Path, have: int) -> None:
    bucket, key = _parts(file.url)
    options: dict[str, Any] = {"if_match": f'"{file.etag}"'}
    if have:
        options["range"] = {"offset": have}
    answer = obstore.get(_client(bucket), key, options=options)  # type: ignore[arg-type]
    with part.open("ab") as out:
        for chunk in answer.stream(min_chunk_size=CHUNK_BYTES) if file.size else ():
            out.write(chunk)
        out.flush()
        os.fsync(out.fileno())


def _is_whole(path: Path, file: BucketFile, sha256: str | None) -> bool:
    if path.stat().st_size != file.size:
        return False
    if sha256 is not None:
        return _digest(path, "sha256") == sha256
    return not PLAIN_MD5.fullmatch(file.etag) or _digest(path, "md5") == file.etag


def _digest(path: Path, how: str) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, how).hexdigest()


@contextmanager
def _alone(lock: Path) -> Iterator[None]:
    """One process of this machine at a time; the system lets go of it when the process ends, however that is."""
    with lock.open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _client(bucket: str) -> S3Store:
    return open_bucket(bucket, None, f"s3://{bucket}")


def _parts(url: str) -> tuple[str, str]:
    bucket, _, key = url.removeprefix("s3://").partition("/")
    if not bucket:
        raise InputError(url, "expected s3://bucket/key")
    return bucket, key


def _described(url: str, found: Any) -> BucketFile:
    modified_s = int(found["last_modified"].timestamp())  # HEAD knows no fractions, a listing does
    return BucketFile(url, int(found["size"]), str(found["e_tag"] or "").strip('"'), modified_s)


def _from_the_server(error: Exception) -> bool:
    """Not from the disk that is written to."""
    return not isinstance(error, OSError) or isinstance(error, ConnectionError | TimeoutError)


def _fault(error: Exception, url: str) -> StoreError:
    return explain(error, f"bucket file {url}")
