"""PCD files of any size, written chunk by chunk."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])


def write_pcd_stream(path: Path, points: int, chunks: Iterable[NDArray[Any]]) -> None:
    """Binary PCD with x y z intensity as float32; `chunks` are arrays of POINT, `points` in all.

    Raises ValueError when the chunks hold another number of points, since the header states it first.
    """
    head = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\n"
        f"TYPE F F F F\nCOUNT 1 1 1 1\nWIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\n"
        "DATA binary\n"
    )
    left = points
    with path.open("wb") as file:
        file.write(head.encode("ascii"))
        for chunk in chunks:
            file.write(np.ascontiguousarray(chunk, POINT).tobytes())
            left -= len(chunk)
    if left:
        raise ValueError(f"{points} points were announced, {points - left} came")
