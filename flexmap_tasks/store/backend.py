"""Where bytes live: one small interface, a folder today."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from flexmap_tasks.errors import StoreError


class Backend(Protocol):
    """A flat space of keys; every write is whole or not at all."""

    def get(self, key: str) -> bytes | None:
        """The content, or None when there is none."""

    def put(self, key: str, content: bytes, *, replace: bool = False) -> None:
        """Store the content; the first writer wins unless `replace`."""

    def size(self, key: str) -> int | None:
        """Bytes of the content, or None when there is none."""

    def delete(self, key: str) -> None:
        """Remove the content if it is there."""

    def list(self, prefix: str) -> Iterator[str]:
        """All keys below a prefix, sorted."""

    def local(self, key: str) -> Path:
        """A path where the content can be read."""


class FolderBackend:
    """Keys are files below a folder: written beside, synced, then renamed or linked into place."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def get(self, key: str) -> bytes | None:
        """See Backend."""
        try:
            return (self.root / key).read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise _explain(error, self.root) from error

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
            else:
                _link(temporary, target)
            _sync_folder(target.parent)
        except OSError as error:
            raise _explain(error, self.root) from error
        finally:
            with contextlib.suppress(OSError):
                temporary.unlink()

    def size(self, key: str) -> int | None:
        """See Backend."""
        try:
            return (self.root / key).stat().st_size
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

    def list(self, prefix: str) -> Iterator[str]:
        """See Backend."""
        top = self.root / prefix
        for folder, folders, files in os.walk(top):
            folders.sort()
            for name in sorted(files):
                yield (Path(folder) / name).relative_to(self.root).as_posix()

    def local(self, key: str) -> Path:
        """See Backend."""
        return self.root / key


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
