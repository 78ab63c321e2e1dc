"""Point clouds of any format: told apart by their first bytes, read block by block."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.las import LasReader
from flexmap_tasks.formats.las_header import SIGNATURE
from flexmap_tasks.formats.mcap_records import MAGIC
from flexmap_tasks.formats.pcd import PcdReader, Records, opened
from flexmap_tasks.model.source import Source


class CloudReader(Protocol):
    """Points in blocks of bounded memory."""

    @property
    def points(self) -> int:
        """Points that the source declares."""

    @property
    def record_type(self) -> np.dtype[Any]:
        """Type of the records in the blocks: x, y, z and all other fields under their own names."""

    def blocks(self) -> Iterator[Records]:
        """All points, in the order of the source."""

    def findings(self) -> list[tuple[str, str, str]]:
        """(code, severity, message) of what is odd; complete once all blocks are read."""


def open_cloud(source: Source) -> LasReader | PcdReader:
    """The reader for a file, by its content.

    Raises InputError when the file is absent, breaks its format, or is a recording.
    """
    with opened(source) as file:
        head = file.read(len(MAGIC))
    if head == MAGIC:
        raise InputError(
            source.name, "this is a recording; name it *.mcap or set point_cloud.format to scans"
        )
    return LasReader(source) if head.startswith(SIGNATURE) else PcdReader(source)
