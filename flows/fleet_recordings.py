"""Recordings as they arrive: which are complete, in which order, and what tells one from its next version."""

from __future__ import annotations

import fnmatch
import glob
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from flexmap_tasks.engine.sources import Look, look, stamp_of
from flexmap_tasks.errors import InputError
from flexmap_tasks.fleet_config import Recordings


@dataclass(frozen=True, slots=True)
class Recording:
    """One file of a drive.

    path : where it lies, s3://bucket/key in a bucket; name : path below the folder or prefix it arrived in
    stamp : size, times and inode (in a bucket what stands for its ETag)
    written_ns : time of the last write, since 1970
    """

    path: str
    name: str
    stamp: Look
    written_ns: int

    @property
    def file(self) -> str:
        """The name of the file itself."""
        return self.name.rpartition("/")[2]


@dataclass(frozen=True, slots=True)
class Choice:
    """Whether a recording is used for its map, and why (not)."""

    recording: Recording
    used: bool
    why: str


def choose(recordings: Recordings, arrived: Sequence[Recording], now_s: float) -> list[Choice]:
    """What becomes of the recordings that are complete, in their order (the newest last)."""
    most = 1 if recordings.take == "newest" else recordings.at_most or len(arrived)
    choices: list[Choice] = []
    for recording in reversed(arrived):
        used = sum(choice.used for choice in choices)
        reason = _reason_against(recordings, recording, now_s)
        if not reason and used >= most:
            reason = f"{used} newer one{'s are' if used > 1 else ' is'} used"
        choices.append(Choice(recording, not reason, reason or "used"))
    return choices[::-1]


def _reason_against(recordings: Recordings, recording: Recording, now_s: float) -> str:
    parts = recording.name.split("/")
    pattern = next((p for p in recordings.leave_out if _fits(parts, p.split("/"))), None)
    if pattern is not None:
        return f"left out by {pattern}"
    age_days = (now_s - recording.written_ns / 1e9) / 86_400
    if recordings.max_age_days is not None and age_days > recordings.max_age_days:
        return f"older than {recordings.max_age_days:g} days"
    return ""


def find_recordings(recordings: Recordings, now_s: float) -> tuple[list[Recording], int]:
    """Recordings that are complete, the newest last, and how many are still on their way.

    Raises InputError for a folder that cannot be searched, StoreError for a bucket that cannot be asked.
    """
    if recordings.bucket is not None:
        found = _in_bucket(recordings.bucket, recordings.pattern)
    else:
        assert recordings.folder is not None  # noqa: S101 - the model gives one of the two
        found = _in_folder(recordings.folder, recordings.pattern)
    settled_ns = (now_s - recordings.settle_s) * 1e9
    settled = [recording for recording in found if recording.written_ns <= settled_ns]
    if recordings.order == "time":
        settled.sort(key=lambda recording: (recording.written_ns, recording.name))
    else:
        settled.sort(key=lambda recording: recording.name)
    return settled, len(found) - len(settled)


def _in_folder(folder: Path, pattern: str) -> list[Recording]:
    """Files below a folder; those whose names begin with a dot are copies on their way (rsync) and left out."""
    if not folder.is_dir():
        raise InputError(str(folder), "no such folder; recordings of a fleet's map arrive there")
    found = []
    for name in glob.iglob(pattern, root_dir=folder, recursive=True):  # noqa: PTH207 - half the cost of Path.glob
        path = f"{folder}/{name}"
        stamp = look(path)
        if stamp and os.path.isfile(path):  # noqa: PTH113 - asked of every file: a Path costs more than the answer
            found.append(Recording(path, name, stamp, stamp[1]))
    return found


def _in_bucket(url: str, pattern: str) -> list[Recording]:
    """Objects below a prefix: they are there whole or not at all."""
    from flexmap_tasks.store.bucket import list_files  # noqa: PLC0415 - folders need no client

    below, wanted = f"{url.rstrip('/')}/", pattern.split("/")
    names = ((file.url.removeprefix(below), file) for file in list_files(url))
    return [
        Recording(file.url, name, list(stamp_of(file)), file.modified_s * 1_000_000_000)
        for name, file in names
        if _fits(name.split("/"), wanted)
    ]


def _fits(name: Sequence[str], pattern: Sequence[str]) -> bool:
    """As `glob` sees it: `*` stays in its folder, `**` goes through any number, a leading dot hides."""
    if not name or not pattern:
        return not name and not pattern
    if pattern[0] == "**":
        hidden = next((i for i, part in enumerate(name) if part.startswith(".")), len(name) - 1)
        return any(_fits(name[i:], pattern[1:] or ["*"]) for i in range(hidden + 1))
    return (
        not name[0].startswith(".")
        and fnmatch.fnmatchcase(name[0], pattern[0])
        and _fits(name[1:], pattern[1:])
    )
