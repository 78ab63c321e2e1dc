"""A file that several people may have open: it is replaced whole, and only by who has seen what it holds."""

from __future__ import annotations

import getpass
import os
import tempfile
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from flexmap_tasks.errors import InputError
from flexmap_tasks.store.artifact import digest_of

NOTHING = ""
"""Digest of a file that is not there."""


class SavedFile:
    """One file under a name. All methods may be called from several threads."""

    def __init__(self, path: Path) -> None:
        self.path, self._lock = path, threading.Lock()

    @property
    def name(self) -> str:
        """For messages: without the folder."""
        return self.path.name

    def digest(self) -> str:
        """Of what the file holds now; "" when it is not there."""
        try:
            return digest_of(self.path.read_bytes())
        except FileNotFoundError:
            return NOTHING

    def replace(self, content: bytes, base: object, check: Callable[[Path], object]) -> str:
        """Write the content if the file still holds what `base` is the digest of; the new digest.

        check : reads the new file before it takes the old one's place; what it raises leaves the old one
        Raises InputError where somebody else has changed the file meanwhile, or where it cannot be written.
        """
        with self._lock:
            if self.digest() != base:
                raise InputError(self.name, "was changed by someone else; reload the page to see it")
            try:
                self._write(content, check)
            except OSError as error:
                raise InputError(self.name, f"cannot be written: {error.strerror or error}") from error
        return digest_of(content)

    def _write(self, content: bytes, check: Callable[[Path], object]) -> None:
        handle, name = tempfile.mkstemp(dir=self.path.parent, prefix=f".{self.name}.")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            check(Path(name))
            Path(name).chmod(0o644)
            Path(name).replace(self.path)
        finally:
            Path(name).unlink(missing_ok=True)


def who_and_when() -> tuple[str, str]:
    """Who sits at this machine, and what time it is, UTC."""
    try:
        who = getpass.getuser()
    except (KeyError, OSError):  # a user without a name
        who = str(os.getuid())
    return who, datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
