"""Points that do not fit in memory, in a temporary file that vanishes with its owner."""

from __future__ import annotations

import tempfile
from typing import Any

import numpy as np

from flexmap_tasks.errors import StoreError
from flexmap_tasks.formats.pcd import Records, no_room
from flexmap_tasks.model.arrays import Ints


class Spill:
    """Records written one block after another and read back by row.

    The file has no name and lies in the folder for temporary files (TMPDIR); it takes as much room as the points.
    """

    def __init__(self, record_type: np.dtype[Any]) -> None:
        self.record_type = record_type
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the spill
        self._rows = 0

    def append(self, records: Records) -> int:
        """Write records; the row of the first of them."""
        start = self._rows
        try:
            self._file.seek(start * self.record_type.itemsize)
            self._file.write(records.view(np.uint8).data)
        except OSError as error:
            raise no_room(error) from None
        self._rows += len(records)
        return start

    def read(self, start: Ints, count: Ints) -> Records:
        """The records of the given runs of rows, one after another."""
        out = np.empty(int(count.sum()), self.record_type)
        raw = memoryview(out.view(np.uint8))  # type: ignore[arg-type]
        size, at = self.record_type.itemsize, 0
        for first, n in zip(start.tolist(), count.tolist(), strict=True):
            self._file.seek(first * size)
            if self._file.readinto(raw[at : at + n * size]) != n * size:
                raise StoreError("a temporary file became shorter while it was read")
            at += n * size
        return out
