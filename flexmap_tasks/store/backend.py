"""Where bytes live: one small interface; here for a folder, in `s3` for a server."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from flexmap_tasks.errors import StoreError

RENEW_AFTER_S = 600.0
"""What is used again counts as new for `gc`; telling it this often is enough."""


@dataclass(frozen=True, slots=True)
class Entry:
    """What lies under a key: `size` in bytes, `modified_s` seconds since 1970 by the keeper's clock."""

    key: str
    size: int
    modified_s: float


class Backend(Protocol):
    """A flat space of keys; every write is whole or not at all.

    url : what a person calls it; at_once : how many requests it likes at the same time
    """

    url: str
    at_once: int

    def get(self, key: str) -> bytes | None:
        """The content, or None when there is none."""

    def fetch(self, key: str) -> bytes | None:
        """The same from where it is kept, past any cache."""

    def put(self, key: str, content: bytes, *, replace: bool = False) -> None:
        """Store the content; the first writer wins unless `replace`."""

    def size(self, key: str) -> int | None:
        """Bytes of the content, or None when there is none."""

    def modified(self, key: str) -> float | None:
        """When the content was written or renewed, by the keeper's clock; None when there is none."""

    def delete(self, key: str) -> None:
        """Remove the content if it is there."""

    def renew(self, key: str) -> None:
        """Let the content count as new, where that costs nothing."""

    def entries(self, folder: str) -> Iterator[Entry]:
        """All that lies below a folder, sorted by key."""

    def local(self, key: str) -> Path:
        """A path where the content can be read."""


class FolderBackend:
    """Keys are files below a folder: written beside, synced, then renamed or linked into place."""

    at_once = 1

    def __init__(self, root: Path) -> None:
        self.root = root
        self.url = str(root)

    def get(self, key: str) -> bytes | None:
        """See Backend."""
        try:
            return (self.root / key).read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise _explain(error, self.root) from error

    def fetch(self, key: str) -> bytes | None:
        """See Backend."""
        return self.get(key)

    def put(self, key: str, content: bytes, *, replace: bool = False) -> None:
        """See Backend."""
        target = self.root / key
        temporary = self.root / "tmp" / secrets.token_hex(8)
        try:
            temporary.parent.mkdir(parents=True, exist_ok=True)
            target.parent.mkdir(parents=True, exist_ok=True)
            _write_synced(temporary, content)
            if replace:
                temporary.replace(target)
                _sync_folder(target.parent)
            else:
                _link(
                    temporary, target
                )  # should power fail now, the name is gone: a miss, never a wrong result
        except OSError as error:
            raise _explain(error, self.root) from error
        finally:
            with contextlib.suppress(OSError):
                temporary.unlink()

    def size(self, key: str) -> int | None:
        """See Backend."""
        stat = self._stat(key)
        return stat.st_size if stat else None

    def modified(self, key: str) -> float | None:
        """See Backend."""
        stat = self._stat(key)
        return stat.st_mtime if stat else None

    def _stat(self, key: str) -> os.stat_result | None:
        try:
            return os.stat(f"{self.url}/{key}")  # noqa: PTH116 - asked of every blob: a Path costs more than the answer
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise _explain(error, self.root) from error

    def delete(self, key: str) -> None:
        """See Backend."""
        try:
            (self.root / key).unlink(missing_ok=True)
        except OSError as error:
            raise _explain(error, self.root) from error

    def renew(self, key: str) -> None:
        """See Backend. What another user wrote, or a store that is read-only, stays as old as it is."""
        with contextlib.suppress(OSError):
            path = f"{self.url}/{key}"  # asked of every blob, as in _stat
            if time.time() - os.stat(path).st_mtime > RENEW_AFTER_S:  # noqa: PTH116
                os.utime(path)

    def entries(self, folder: str) -> Iterator[Entry]:
        """See Backend."""
        yield from _walk(self.root / folder, folder)

    def local(self, key: str) -> Path:
        """See Backend."""
        return self.root / key


def _walk(path: Path, key: str) -> Iterator[Entry]:
    try:
        with os.scandir(path) as found:
            inside = sorted(found, key=lambda entry: entry.name)
    except (FileNotFoundError, NotADirectoryError):  # another process may clean up at the same time
        return
    except OSError as error:
        raise _explain(error, path) from error
    for entry in inside:
        if entry.is_dir(follow_symlinks=False):
            yield from _walk(Path(entry.path), f"{key}/{entry.name}")
            continue
        with contextlib.suppress(FileNotFoundError):
            stat = entry.stat(follow_symlinks=False)
            yield Entry(f"{key}/{entry.name}", stat.st_size, stat.st_mtime)


def _write_synced(path: Path, content: bytes) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o444)
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _link(temporary: Path, target: Path) -> None:
    """Put into place unless something is there already; file systems without links rename instead."""
    try:
        os.link(temporary, target)
    except FileExistsError:
        return
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.EOPNOTSUPP, errno.EMLINK):
            raise
        temporary.replace(target)


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _explain(error: OSError, root: Path) -> StoreError:
    what = {
        errno.ENOSPC: "no space left on the device; free some and run again, nothing is lost",
        errno.EDQUOT: "the disk quota is used up; free some and run again, nothing is lost",
        errno.EACCES: "no permission to write there; choose another folder with --store",
        errno.EPERM: "no permission to write there; choose another folder with --store",
        errno.EROFS: "the file system is read-only; choose another folder with --store",
        errno.ENOTDIR: "a part of the path is no folder; choose another folder with --store",
        errno.EEXIST: "a part of the path is no folder; choose another folder with --store",
    }.get(error.errno or 0, error.strerror or "cannot be used")
    return StoreError(f"artifact store {root}: {what}")
