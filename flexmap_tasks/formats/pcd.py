"""PCD point clouds: read in blocks of bounded memory, written as binary with all their fields.

Records are numpy structured arrays, one field per PCD field under its own name, padding left out.
Coordinates of ASCII files are read as float64, whatever SIZE says: the digits are there.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.errors import InputError, StoreError
from flexmap_tasks.formats.pcd_ascii import ascii_records, ascii_type
from flexmap_tasks.formats.pcd_header import AXES, IDENTITY, PcdHeader, read_header
from flexmap_tasks.formats.pcd_lzf import MAX_RATIO, REASONS, lzf_decode
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.clouds import PointCloud
from flexmap_tasks.model.source import Source

Records = NDArray[np.void]
BLOCK_BYTES = 16 * 1024 * 1024


class PcdReader:
    """One PCD file: its header, and its points block by block.

    Raises InputError when the file is absent, breaks the format, or holds less or more than it declares.
    """

    def __init__(self, source: Source) -> None:
        self.source = source
        with opened(source) as file:
            self.header: PcdHeader = read_header(file, source)
            self._size = os.fstat(file.fileno()).st_size

    @property
    def moved_viewpoint(self) -> bool:
        """VIEWPOINT says that the sensor stood elsewhere than at the origin, looking along x."""
        pose = self.header.viewpoint
        return pose != IDENTITY and pose != (*IDENTITY[:3], -1.0, *IDENTITY[4:])

    @property
    def points(self) -> int:
        """Points that the header declares."""
        return self.header.points

    def findings(self) -> list[tuple[str, str, str]]:
        """Nothing is odd about a PCD file that can be read."""
        return []

    @property
    def record_type(self) -> np.dtype[Any]:
        """Type of the records in the blocks."""
        if self.header.encoding == "ascii":
            return ascii_type(self.header)
        return self.header.record_type()

    def blocks(self) -> Iterator[Records]:
        """All points in the order of the file, at most about 16 MiB at a time."""
        with opened(self.source) as file:
            file.seek(self.header.data_start)
            if self.header.encoding == "ascii":
                yield from ascii_records(file, self.header, self.source)
            elif self.header.encoding == "binary":
                yield from self._binary(file)
            else:
                yield from self._compressed(file)

    @property
    def _block_points(self) -> int:
        return max(1, BLOCK_BYTES // self.header.point_bytes)

    def _expect_bytes(self, found: int, needed: int, what: str) -> None:
        """`found` must reach `needed`, and may not go on for another whole point."""
        if found < needed:
            raise InputError(
                self.source.name, f"{what} needs {needed} bytes, the file has {found}; it is cut off"
            )
        if found >= needed + self.header.point_bytes:
            raise InputError(
                self.source.name, f"{what} needs {needed} bytes, the file has {found}; mend POINTS"
            )

    def _binary(self, file: BinaryIO) -> Iterator[Records]:
        record, points = self.header.record_type(), self.header.points
        self._expect_bytes(
            self._size - self.header.data_start, points * record.itemsize, f"POINTS {points} as binary data"
        )
        for start in range(0, points, self._block_points):
            count = min(self._block_points, points - start)
            block = np.fromfile(file, record, count)
            if len(block) < count:
                raise InputError(self.source.name, "the file became shorter while it was read")
            yield block

    def _compressed(self, file: BinaryIO) -> Iterator[Records]:
        """Compressed data lies field by field: unpacked into a temporary file, then gathered into records."""
        record, points = self.header.record_type(), self.header.points
        with tempfile.TemporaryFile() as scratch:
            unpacked = self._unpack(file, scratch)
            columns, start = [], 0
            for field in self.header.fields:
                part = unpacked[start : start + field.nbytes * points]
                start += field.nbytes * points
                if not field.padding:
                    columns.append((field.name, part.view(field.dtype).reshape(points, *field.shape)))
            for first in range(0, points, self._block_points):
                rows = slice(first, min(first + self._block_points, points))
                block = np.zeros(rows.stop - rows.start, record)
                for name, column in columns:
                    block[name] = column[rows]
                yield block

    def _unpack(self, file: BinaryIO, scratch: Any) -> NDArray[np.uint8]:
        head = file.read(8)
        if len(head) < 8:
            raise InputError(self.source.name, "the compressed data has no sizes; the file is cut off")
        packed_size, size = (int(v) for v in np.frombuffer(head, "<u4"))
        wanted = self.header.points * self.header.point_bytes
        if size != wanted:
            raise InputError(
                self.source.name,
                f"POINTS {self.header.points} needs {wanted} bytes, the compressed data declares {size}",
            )
        self._expect_bytes(self._size - self.header.data_start - 8, packed_size, "the compressed data")
        if size > packed_size * MAX_RATIO:
            raise InputError(self.source.name, f"{packed_size} bytes of LZF cannot unpack to {size} bytes")
        if not size:
            return np.empty(0, np.uint8)
        packed = np.fromfile(file, np.uint8, packed_size)
        packed.flags.writeable = False
        try:
            if hasattr(
                os, "posix_fallocate"
            ):  # writing to a mapped file on a full disk would kill the process
                os.posix_fallocate(scratch.fileno(), 0, size)
            scratch.truncate(size)
        except OSError as error:
            raise no_room(error) from None
        out = np.memmap(scratch, np.uint8, "r+", shape=(size,)).view(np.ndarray)
        made = lzf_decode(packed, out)
        if made != size:
            reason = REASONS.get(made, f"unpacks to {made} bytes instead of {size}")
            raise InputError(self.source.name, f"the compressed data is broken: it {reason}")
        return out


def positions(records: Records) -> Floats:
    """(n, 3) float64: x, y, z of the records."""
    out: Floats = np.empty((len(records), 3))
    for i, axis in enumerate(AXES):
        out[:, i] = records[axis]
    return out


def to_cloud(records: Records) -> PointCloud:
    """Records as a point cloud: the other fields keep their types and their order."""
    names = [n for n in records.dtype.names or () if n not in AXES]
    return PointCloud(positions(records), {n: np.ascontiguousarray(records[n]) for n in names})


def read_pcd(source: Source) -> PointCloud:
    """A whole PCD file; points that are not finite included."""
    reader = PcdReader(source)
    blocks = list(reader.blocks())
    return to_cloud(np.concatenate(blocks) if blocks else np.empty(0, reader.record_type))


def pcd_bytes(cloud: PointCloud, coordinates: Literal["float32", "float64"] = "float32") -> bytes:
    """A binary PCD file: x y z of the given type, then all fields in their own types; same cloud, same bytes.

    Raises ValueError when a coordinate is beyond what the type can hold.
    """
    columns = {**{axis: cloud.xyz_m[:, i] for i, axis in enumerate(AXES)}, **cloud.fields}
    types = [
        (n, np.dtype(coordinates).newbyteorder("<") if n in AXES else v.dtype.newbyteorder("<"), v.shape[1:])
        for n, v in columns.items()
    ]
    records = np.empty(len(cloud), np.dtype(types))
    with np.errstate(over="ignore"):  # what overflows is found below
        for name, values in columns.items():
            records[name] = values
    if not all(np.isfinite(records[axis]).all() for axis in AXES):
        raise ValueError(f"a coordinate that {coordinates} cannot hold")
    kinds = [np.dtype(t) for _, t, _ in types]
    counts = [int(np.prod(s, dtype=np.int64)) for _, _, s in types]
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
        f"FIELDS {' '.join(columns)}\n"
        f"SIZE {' '.join(str(k.itemsize) for k in kinds)}\n"
        f"TYPE {' '.join(k.kind.upper() for k in kinds)}\n"
        f"COUNT {' '.join(map(str, counts))}\n"
        f"WIDTH {len(cloud)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(cloud)}\nDATA binary\n"
    )
    return header.encode("ascii") + records.tobytes()


def no_room(error: OSError) -> StoreError:
    """The error of a full folder for temporary files."""
    folder, reason = tempfile.gettempdir(), error.strerror or error
    return StoreError(
        f"{folder}: no room for the points of a cloud ({reason}); set TMPDIR to a larger folder"
    )


@contextmanager
def opened(source: Source) -> Iterator[BinaryIO]:
    """The file, open for reading; an InputError where there is none."""
    try:
        file = source.path.open("rb")
    except FileNotFoundError:
        raise InputError(source.name, "no such file; give the path of a point cloud") from None
    except OSError as error:
        raise InputError(source.name, f"cannot be read: {error.strerror or error}") from None
    with file:
        yield file
