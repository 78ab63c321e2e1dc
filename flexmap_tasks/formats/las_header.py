"""The header of a LAS or LAZ file, read strictly before any library trusts it (ASPRS LAS 1.4 R15, LASzip).

Every count, offset and length in the file must be backed by the bytes that are there.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import BinaryIO

import lazrs
import numpy as np

from flexmap_tasks.errors import InputError

SIGNATURE = b"LASF"
MAX_POINTS_A_BYTE = 64
"""LASzip stays far under this on any scan; a header that promises more is a trap."""

_HEADER_BYTES = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375}
_POINT_BYTES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
_VLR, _EVLR = struct.Struct("<2x16sHH32x"), struct.Struct("<2x16sHQ32x")
_LASZIP = (b"laszip encoded", 22204)
_LASZIP_HEAD, _LASZIP_ITEM = 34, 6
_CHUNKED = (2, 3)
_CHUNK_SIZE_AT, _VARIABLE = 12, 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class LasHeader:
    """What the header promises, once it is known that the file can hold it.

    data_start : offset of the first point; point_bytes : of one point, unpacked
    low_m, high_m : the box that the header states
    """

    version: tuple[int, int]
    points: int
    point_bytes: int
    packed: bool
    data_start: int
    low_m: tuple[float, ...]
    high_m: tuple[float, ...]


def read_las_header(file: BinaryIO, size: int, name: str) -> LasHeader:
    """Check the header of a file of `size` bytes; `name` is the name for messages.

    Raises InputError where the file breaks the format or holds less than it declares.
    """
    head = file.read(375)
    if len(head) < 227:
        raise InputError(name, f"a LAS header needs 227 bytes, the file has {size}; it is cut off", "header")
    major, minor = head[24], head[25]
    if major != 1 or minor not in _HEADER_BYTES:
        raise InputError(name, f"expected LAS 1.0 to 1.4, got {major}.{minor}", "header")
    header_bytes, data_start, vlrs, kind, point_bytes, points = struct.unpack_from("<HIIBHI", head, 94)
    if header_bytes < _HEADER_BYTES[minor] or len(head) < _HEADER_BYTES[minor]:
        rule = f"LAS 1.{minor} has a header of {_HEADER_BYTES[minor]} bytes, this one {header_bytes}"
        raise InputError(name, rule, "header")
    if minor == 4:
        points = struct.unpack_from("<Q", head, 247)[0] or points
    if not header_bytes <= data_start <= size:
        rule = (
            f"the points start at byte {data_start:,} of {size:,}; the file is cut off or its header broken"
        )
        raise InputError(name, rule, "header")
    packed, number = bool(kind & 0xC0), kind & 0x3F
    if number >= len(_POINT_BYTES):
        raise InputError(name, f"point format {number} is unknown; known are 0 to 10", "header")
    if point_bytes < _POINT_BYTES[number]:
        rule = (
            f"point format {number} has {_POINT_BYTES[number]} bytes or more, the header says {point_bytes}"
        )
        raise InputError(name, rule, "header")
    _check_scales(struct.unpack_from("<6d", head, 131), name)
    laszip = _walk_vlrs(file, header_bytes, data_start, vlrs, name)
    if minor == 4:
        _walk_evlrs(file, struct.unpack_from("<QI", head, 235), size, name)
    box = struct.unpack_from("<6d", head, 179)
    header = LasHeader((major, minor), points, point_bytes, packed, data_start, box[1::2], box[0::2])
    if packed:
        _check_packed(file, header, size, laszip, name)
    elif size - data_start < points * point_bytes:
        rule = f"{points:,} points need {points * point_bytes:,} bytes, the file has {size - data_start:,}"
        raise InputError(name, f"{rule}; it is cut off")
    return header


def _check_scales(numbers: tuple[float, ...], name: str) -> None:
    """Scale x y z, offset x y z."""
    if not np.isfinite(numbers).all() or min(numbers[:3]) <= 0:
        shown = " ".join(f"{v:g}" for v in numbers)
        raise InputError(name, f"scales must be positive and offsets finite, got {shown}", "header")


def _walk_vlrs(file: BinaryIO, start: int, stop: int, count: int, name: str) -> bytes | None:
    """Content of the LASzip record, if there is one."""
    laszip, at = None, start
    for number in range(1, count + 1):
        if stop - at < _VLR.size:
            raise InputError(name, f"record {number} of {count} goes over the points' start", "header")
        file.seek(at)
        user, record, length = _VLR.unpack(file.read(_VLR.size))
        at += _VLR.size + length
        if at > stop:
            raise InputError(name, f"record {number} of {count} claims {length:,} bytes, too many", "header")
        if (user.rstrip(b"\0"), record) == _LASZIP:
            laszip = file.read(length)
    return laszip


def _walk_evlrs(file: BinaryIO, promised: tuple[int, int], size: int, name: str) -> None:
    at, count = promised
    for number in range(1, count + 1):
        if at > size - _EVLR.size:
            raise InputError(
                name, f"extended record {number} of {count} lies behind the file's end", "header"
            )
        file.seek(at)
        length = _EVLR.unpack(file.read(_EVLR.size))[2]
        at += _EVLR.size + length
        if at > size:
            rule = f"extended record {number} of {count} claims {length:,} bytes; the file is cut off"
            raise InputError(name, rule, "header")


def _check_packed(file: BinaryIO, header: LasHeader, size: int, laszip: bytes | None, name: str) -> None:
    """The table of chunks at the end must account for all bytes and all points."""
    if laszip is None or len(laszip) < _LASZIP_HEAD:
        raise InputError(name, "the points are compressed, but the LASzip record is missing", "header")
    compressor, items = struct.unpack_from("<H", laszip)[0], struct.unpack_from("<H", laszip, 32)[0]
    if compressor not in _CHUNKED:
        rule = f"LASzip's compressor {compressor} is not read (2 and 3 are); pack the file anew, with laszip or pdal"
        raise InputError(name, rule, "header")
    widths = np.frombuffer(laszip[_LASZIP_HEAD:], "<u2")[1::3][:items]
    if len(laszip) < _LASZIP_HEAD + items * _LASZIP_ITEM or widths.sum() != header.point_bytes:
        raise InputError(name, "the LASzip record does not describe the points of the header", "header")
    if not header.points:
        return
    data_bytes = size - header.data_start
    if header.points > data_bytes * MAX_POINTS_A_BYTE:
        raise InputError(
            name, f"{header.points:,} points cannot lie in {data_bytes:,} bytes of LAZ", "header"
        )
    chunks = _chunk_table(file, header, size, laszip, name)
    (chunk_size,) = struct.unpack_from("<I", laszip, _CHUNK_SIZE_AT)
    points = sum(count for count, _ in chunks)
    whole = (
        points == header.points if chunk_size == _VARIABLE else points >= header.points > points - chunk_size
    )
    if not whole:
        rule = f"the header promises {header.points:,} points, the compressed chunks hold {points:,}"
        raise InputError(name, f"{rule}; the file is damaged")


def _chunk_table(
    file: BinaryIO, header: LasHeader, size: int, laszip: bytes, name: str
) -> list[tuple[int, int]]:
    """(points, bytes) of every chunk."""
    cut = InputError(name, "the table of compressed chunks is not there; the file is cut off or damaged")
    file.seek(header.data_start)
    offset = int.from_bytes(file.read(8), "little", signed=True)
    if offset == -1:  # a writer that could not go back has put it at the end
        file.seek(size - 8)
        offset = int.from_bytes(file.read(8), "little", signed=True)
    if not header.data_start + 8 <= offset <= size - 8:
        raise cut
    file.seek(offset)
    version, count = struct.unpack("<II", file.read(8))
    if (
        version != 0 or count * header.point_bytes > offset - header.data_start
    ):  # each begins with a whole point
        raise cut
    file.seek(header.data_start)
    try:
        table: list[tuple[int, int]] = lazrs.read_chunk_table(file, lazrs.LazVlr(laszip))
    except (lazrs.LazrsError, OSError, ValueError, OverflowError):
        raise cut from None
    if sum(length for _, length in table) != offset - header.data_start - 8:
        raise cut
    return table
