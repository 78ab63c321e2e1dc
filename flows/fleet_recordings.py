"""Recordings as they arrive: which are complete, in which order, and what tells one from its next version."""

from __future__ import annotations

import glob
import os
from dataclasses import dataclass
from pathlib import Path

from flexmap_tasks.engine.sources import Look, look
from flexmap_tasks.errors import InputError
from flexmap_tasks.fleet_config import Recordings


@dataclass(frozen=True, slots=True)
class Recording:
    """One file of a drive.

    path : where it lies; name : path below the folder it arrived in
    stamp : size, times and inode; written_ns : time of the last write, since 1970
    """

    path: str
    name: str
    stamp: Look
    written_ns: int

    @property
    def file(self) -> str:
        """The name of the file itself."""
        return self.name.rpartition("/")[2]


def find_recordings(recordings: Recordings, now_s: float) -> tuple[list[Recording], int]:
    """Recordings that are complete, the newest last, and how many are still on their way. Raises InputError."""
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
