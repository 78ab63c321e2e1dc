"""A store on an S3-compatible server, with what was read kept in a local folder.

The address names bucket and prefix; the server and the credentials come from the environment alone
(AWS_ENDPOINT_URL, AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION, AWS_SESSION_TOKEN, ...).
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import obstore
from obstore.exceptions import AlreadyExistsError, BaseError, NotFoundError
from obstore.store import S3Store

from flexmap_tasks.errors import StoreError
from flexmap_tasks.store.artifact import digest_of
from flexmap_tasks.store.backend import Entry, FolderBackend

if TYPE_CHECKING:
    from obstore.store import ClientConfig, RetryConfig

AT_ONCE = 16
PARTS_OVER_BYTES = 64 * 1024 * 1024
"""Larger content goes up in parts, each retried on its own. Only blobs are that large, and two writers of one blob
write the same bytes, so that it does not matter which of them was first."""
RETRIES = 8
ABSENT = (NotFoundError, FileNotFoundError)
FAULTS = (BaseError, OSError)
REFUSALS = (
    "PermissionDenied",
    "Unauthenticated",
    "AccessDenied",
    "InvalidAccessKeyId",
    "SignatureDoesNotMatch",
)
RETRY_FOR = timedelta(minutes=2)


class S3Backend:
    """Keys are objects below a prefix of a bucket; blobs that were read lie in `cache` as well."""

    at_once = AT_ONCE

    def __init__(self, remote: S3Store, url: str, cache: FolderBackend) -> None:
        self.url = url
        self._remote, self._cache = remote, cache

    @classmethod
    def open(cls, url: str) -> S3Backend:
        """The store at s3://bucket/prefix. The cache is FLEXMAP_CACHE, or `flexmap` in the user's cache folder."""
        bucket, _, prefix = url.removeprefix("s3://").strip("/").partition("/")
        if not bucket:
            raise StoreError(f"artifact store {url}: expected s3://bucket/prefix")
        remote = open_bucket(bucket, prefix or None, f"artifact store {url}")
        endpoint = os.environ.get("AWS_ENDPOINT_URL", "")
        return cls(remote, url, FolderBackend(cache_folder() / digest_of(f"{endpoint} {url}".encode())[:16]))

    def get(self, key: str) -> bytes | None:
        """See Backend. What lies in the cache is checked before it counts."""
        if not _is_blob(key):
            return self.fetch(key)
        kept = self._cache.get(key)
        if kept is not None and _holds(kept, key):
            return kept
        content = self.fetch(key)
        if content is not None and _holds(content, key):
            with contextlib.suppress(StoreError):  # a full disk here must not stop the run
                self._cache.put(key, content, replace=True)
        return content

    def put(self, key: str, content: bytes, *, replace: bool = False) -> None:
        """See Backend."""
        whole = len(content) <= PARTS_OVER_BYTES
        try:
            if whole and not replace:
                obstore.put(self._remote, key, content, mode="create", use_multipart=False)
            else:
                obstore.put(self._remote, key, content, use_multipart=not whole)
        except (AlreadyExistsError, FileExistsError):
            return
        except FAULTS as error:
            raise explain(error, f"artifact store {self.url}") from error

    def size(self, key: str) -> int | None:
        """See Backend."""
        try:
            return int(obstore.head(self._remote, key)["size"])
        except ABSENT:
            return None
        except FAULTS as error:
            raise explain(error, f"artifact store {self.url}") from error

    def delete(self, key: str) -> None:
        """See Backend."""
        if _is_blob(key):
            self._cache.delete(key)
        try:
            obstore.delete(self._remote, key)
        except ABSENT:
            return
        except FAULTS as error:
            raise explain(error, f"artifact store {self.url}") from error

    def modified(self, key: str) -> float | None:
        """See Backend."""
        try:
            return float(obstore.head(self._remote, key)["last_modified"].timestamp())
        except ABSENT:
            return None
        except FAULTS as error:
            raise explain(error, f"artifact store {self.url}") from error

    def renew(self, key: str) -> None:
        """See Backend. A server tells the age of what was written, and writing again would cost a transfer."""

    def entries(self, folder: str) -> Iterator[Entry]:
        """See Backend."""
        try:
            for page in obstore.list(self._remote, prefix=folder):
                for found in page:
                    yield Entry(str(found["path"]), int(found["size"]), found["last_modified"].timestamp())
        except FAULTS as error:
            raise explain(error, f"artifact store {self.url}") from error

    def local(self, key: str) -> Path:
        """See Backend. The path lies in the cache."""
        path = self._cache.local(key)
        content = self.get(key)
        if content is None:
            raise StoreError(f"artifact store {self.url}: {key} is gone; run again")
        if not path.is_file():
            self._cache.put(key, content)
        return path

    def fetch(self, key: str) -> bytes | None:
        """See Backend."""
        try:
            return bytes(obstore.get(self._remote, key).bytes())
        except ABSENT:
            return None
        except FAULTS as error:
            raise explain(error, f"artifact store {self.url}") from error


def cache_folder() -> Path:
    """Where blobs of servers are kept; may be deleted at any time."""
    named = os.environ.get("FLEXMAP_CACHE")
    return (
        Path(named) if named else Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser() / "flexmap"
    )


def _is_blob(key: str) -> bool:
    return key.startswith("objects/")


def _holds(content: bytes, key: str) -> bool:
    return digest_of(content) == key.removeprefix("objects/").replace("/", "")


def open_bucket(bucket: str, prefix: str | None, name: str) -> S3Store:
    """A bucket, or what of it lies below a prefix; `name` is what errors call it."""
    client: ClientConfig = {
        "allow_http": os.environ.get("AWS_ENDPOINT_URL", "").startswith("http://"),
        "timeout": timedelta(minutes=5),
    }
    retries: RetryConfig = {"max_retries": RETRIES, "retry_timeout": RETRY_FOR}
    try:
        return S3Store(bucket, prefix=prefix, client_options=client, retry_config=retries)
    except FAULTS as error:
        raise explain(error, name) from error


def explain(error: Exception, name: str) -> StoreError:
    """One clear line about a fault of a server; `name` is what was to be used."""
    if any(word in f"{type(error).__name__} {error}" for word in REFUSALS):
        what = (
            "the server refuses; check AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and the rights on the bucket"
        )
    elif "NoSuchBucket" in str(error):
        what = "there is no such bucket"
    else:
        first = next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
        what = f"cannot be used ({first[:300]}); nothing that was stored is lost, run again"
    return StoreError(f"{name}: {what}")
