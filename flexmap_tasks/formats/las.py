"""LAS, LAZ and COPC point clouds: read in blocks of bounded memory by laspy and lazrs.

Coordinates become float64 metres (integer * scale + offset); all other dimensions keep name, type and value,
extra bytes with a scale of their own as float64. Names are made such that a PCD header can hold them.
"""

from __future__ import annotations

import logging
import os
import struct
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any, TypeVar

import laspy
import lazrs
import numpy as np

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.las_header import LasHeader, read_las_header
from flexmap_tasks.formats.pcd import BLOCK_BYTES, Records, opened, positions
from flexmap_tasks.formats.pcd_header import AXES, usable_names
from flexmap_tasks.formats.track_rows import printable
from flexmap_tasks.model.source import Source

OUTSIDE_STEPS = 2.0
"""Coordinates may lie this many of their own steps outside of the header's box: writers round it."""

MAX_WKT_BYTES = 64 * 1024
_BROKEN = (
    laspy.LaspyException, lazrs.LazrsError, struct.error, ValueError, TypeError, LookupError, OverflowError,
    EOFError, OSError, AttributeError, NotImplementedError, RuntimeError,
)  # fmt: skip
"""What laspy raises on records that it does not understand."""

logging.getLogger("laspy").addHandler(logging.NullHandler())  # it tells of hostile files on stderr
T = TypeVar("T")


class LasReader:
    """One LAS, LAZ or COPC file: its header, and its points block by block.

    Raises InputError when the file is absent, breaks the format, or holds less than it declares.
    """

    def __init__(self, source: Source) -> None:
        self.source = source
        with opened(source) as file:
            self._head: LasHeader = read_las_header(file, os.fstat(file.fileno()).st_size, source.name)
            file.seek(0)
            self._las = self._guard(lambda: laspy.LasHeader.read_from(file, read_evlrs=False))
        if self._las.point_format.size != self._head.point_bytes:
            raise InputError(source.name, "the extra bytes are not those of the header", "header")
        self._dimensions = self._guard(lambda: _dimensions(self._las.point_format))
        self._outside = 0

    @property
    def points(self) -> int:
        """Points that the header declares."""
        return self._head.points

    @property
    def record_type(self) -> np.dtype[Any]:
        """Type of the records in the blocks."""
        kinds = [(name, kind, shape) for _, name, kind, shape in self._dimensions]
        return np.dtype([*((axis, "<f8", ()) for axis in AXES), *kinds])

    def findings(self) -> list[tuple[str, str, str]]:
        """(code, severity, message) of what is odd; complete once all blocks are read."""
        found = []
        if self._outside:
            rule = f"{self._outside:,} points lie outside of the box in the header; the file may be damaged"
            found.append(("cloud-outside-its-header", "warning", rule))
        crs = self._crs()
        if crs is not None:
            rule = (
                f"the file declares {crs}; a cloud made by SLAM lies in a frame of its own: if this one is "
                "georeferenced already, it must not be aligned again"
            )
            found.append(("cloud-declares-crs", "warning", rule))
        return found

    def blocks(self) -> Iterator[Records]:
        """All points in the order of the file, at most about 16 MiB at a time."""
        step = max(1, BLOCK_BYTES // max(self._head.point_bytes, self.record_type.itemsize))
        with opened(self.source) as file:
            reader = self._guard(
                lambda: laspy.LasReader(file, laz_backend=laspy.LazBackend.Lazrs, read_evlrs=False)
            )
            with closing(reader):
                for start in range(0, self.points, step):
                    count = min(step, self.points - start)
                    yield self._block(reader, count)

    def _block(self, reader: laspy.LasReader, count: int) -> Records:
        def read() -> Records:
            points = reader.read_points(count)
            out = np.empty(len(points), self.record_type)
            with np.errstate(over="ignore", invalid="ignore"):  # what overflows has no usable coordinates
                for axis in AXES:
                    out[axis] = points[axis]
            for name, renamed, _, _ in self._dimensions:
                out[renamed] = np.asarray(points[name])
            return out

        out = self._guard(read)
        if len(out) != count:
            raise InputError(self.source.name, "the file became shorter while it was read")
        xyz_m = positions(out)
        room = OUTSIDE_STEPS * np.asarray(self._las.scales)
        out_of_box = (xyz_m < self._head.low_m - room) | (xyz_m > self._head.high_m + room)
        self._outside += int(out_of_box.any(axis=1).sum())
        return out

    def _crs(self) -> str | None:
        """The coordinate system that the file declares, in words."""
        records = [v for v in self._las.vlrs if v.user_id == "LASF_Projection"]
        if not records:
            return None
        try:
            if any(len(v.record_data_bytes()) > MAX_WKT_BYTES for v in records):
                return "a coordinate system"
            crs = self._las.parse_crs()
        except _BROKEN:
            return "a coordinate system that cannot be read"
        if crs is None:
            return None
        code = crs.to_epsg()
        return printable(f"the {'projected ' if crs.is_projected else ''}system {crs.name}") + (
            f" (EPSG:{code})" if code else ""
        )

    def _guard(self, work: Callable[[], T]) -> T:
        """The result of the work; what laspy and lazrs throw at broken records becomes an InputError."""
        try:
            return work()
        except MemoryError:
            raise
        except _BROKEN as error:
            reason = printable(" ".join(f"{error}".split()) or type(error).__name__, 120)
        except BaseException as error:  # a Rust panic is no Exception
            if type(error).__name__ != "PanicException":
                raise
            reason = "its compressed points cannot be unpacked"
        raise InputError(self.source.name, f"the LAS file is damaged: {reason}")


Dimension = tuple[str, str, np.dtype[Any], tuple[int, ...]]
"""Name in the file, name for a PCD header, type, shape."""


def _dimensions(point_format: laspy.PointFormat) -> list[Dimension]:
    listed = [d for d in point_format.dimensions if d.name not in ("X", "Y", "Z")]
    names = usable_names([d.name for d in listed], AXES)
    return [(d.name, name, *_type_of(d)) for d, name in zip(listed, names, strict=True)]


def _type_of(dimension: Any) -> tuple[np.dtype[Any], tuple[int, ...]]:
    """Type and shape of a dimension in one point; parts of a byte get a byte of their own."""
    if dimension.dtype is None:
        return np.dtype("u1"), ()
    whole = np.dtype(dimension.dtype)
    return np.dtype("<f8") if dimension.is_scaled else whole.base, whole.shape
