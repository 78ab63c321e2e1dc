"""The chunks of an MCAP file: unpacked within bounds, checked, and walked record by record."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from mmap import mmap

import lz4.frame
import numpy as np
import zstandard

from flexmap_tasks.formats.cdr import gather
from flexmap_tasks.model.arrays import Ints

Buffer = bytes | memoryview | mmap

FREE_SIZE = 64 << 20
GREATEST_RATIO = 256
"""A chunk may unpack to FREE_SIZE + GREATEST_RATIO times its packed size, no more: lz4 reaches a ratio of 255."""

_HEAD = struct.Struct("<BQ")
_FIXED = struct.Struct("<QQQII")
MESSAGE = 0x05
INDEX_ENTRY = 16
"""Bytes of an entry of a message index: log time u64, offset in the unpacked chunk u64."""

_RECORD = np.dtype([("opcode", "u1"), ("length", "<u8")])


class DamagedError(Exception):
    """Bytes that break the MCAP format.

    at : offset of the first byte that cannot be understood
    """

    def __init__(self, at: int, rule: str) -> None:
        super().__init__(at, rule)
        self.at, self.rule = at, rule


@dataclass(frozen=True, slots=True)
class Chunk:
    """Where a chunk stands and what its index says.

    begin, end : bounds of the chunk record's content in the file
    index : by channel id, bounds of the entries in the message index behind the chunk; None without an index
    """

    begin: int
    end: int
    index: dict[int, tuple[int, int]] | None

    def counts(self) -> dict[int, int] | None:
        """Messages by channel id, as the index says."""
        if self.index is None:
            return None
        return {channel: (end - begin) // INDEX_ENTRY for channel, (begin, end) in self.index.items()}


def records(data: Buffer, begin: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Opcode and content bounds of each record in data[begin:end].

    Raises DamagedError where a record does not fit into the bytes that are there.
    """
    at = begin
    while at < end:
        if end - at < _HEAD.size:
            raise DamagedError(at, "a record head is cut off")
        opcode, length = _HEAD.unpack_from(data, at)
        start = at + _HEAD.size
        if length > end - start:
            raise DamagedError(at, f"a record of {length:,} bytes does not fit into the rest")
        yield opcode, start, start + length
        at = start + length


def message_bounds(data: Buffer) -> tuple[Ints, Ints]:
    """Content bounds of all message records of an unpacked chunk, (n,) each."""
    starts: list[int] = []
    stops: list[int] = []
    at, end, unpack, size = 0, len(data), _HEAD.unpack_from, _HEAD.size
    while at + size <= end:  # kept small: one step per record
        opcode, length = unpack(data, at)
        start = at + size
        at = start + length
        if opcode == MESSAGE:
            starts.append(start)
            stops.append(at)
    if at != end:
        raise DamagedError(min(at, end), "the last record of the chunk is cut off")
    return np.asarray(starts, dtype=np.int64), np.asarray(stops, dtype=np.int64)


def indexed_bounds(unpacked: Buffer, entries: bytes) -> tuple[Ints, Ints] | None:
    """Content bounds of all messages of a chunk from the entries of all its indexes, in the order of the chunk.

    None where an entry points to no message or a message has no entry: then only a walk tells.
    """
    offset = np.sort(np.frombuffer(entries, dtype="<u8")[1::2])
    if not len(offset) or offset[-1] > len(unpacked) - _HEAD.size:
        return None
    start = offset.astype(np.int64)
    head = gather(np.frombuffer(unpacked, dtype=np.uint8), start, _HEAD.size).view(_RECORD)
    start += _HEAD.size
    if (head["opcode"] != MESSAGE).any() or (
        head["length"] > (len(unpacked) - start).astype(np.uint64)
    ).any():
        return None
    stop = start + head["length"].astype(np.int64)
    return (start, stop) if _no_message_between(unpacked, start, stop) else None


def _no_message_between(unpacked: Buffer, start: Ints, stop: Ints) -> bool:
    """Whether the bytes before, between and behind the messages are whole records of other kinds."""
    begin = np.concatenate([[0], stop])
    end = np.concatenate([start - _HEAD.size, [len(unpacked)]])
    if (begin > end).any():
        return False
    gaps = begin < end
    bounds = zip(begin[gaps].tolist(), end[gaps].tolist(), strict=True)
    try:
        return all(opcode != MESSAGE for a, b in bounds for opcode, _, _ in records(unpacked, a, b))
    except DamagedError:
        return False


def unpack_chunk(data: Buffer, chunk: Chunk) -> Buffer:
    """The records inside a chunk, unpacked and checked against size and CRC; a view where nothing is packed."""
    if chunk.end - chunk.begin < _FIXED.size:
        raise DamagedError(chunk.begin, "the chunk's head is cut off")
    _, _, size, crc, name_length = _FIXED.unpack_from(data, chunk.begin)
    at = chunk.begin + _FIXED.size
    if name_length > chunk.end - at - 8:
        raise DamagedError(at, "the chunk's head is cut off")
    name = bytes(data[at : at + name_length])
    at += name_length
    (packed_size,) = struct.unpack_from("<Q", data, at)
    if packed_size > chunk.end - at - 8:
        raise DamagedError(at, "the chunk is longer than its record")
    packed = memoryview(data)[at + 8 : at + 8 + packed_size]
    if size > FREE_SIZE + GREATEST_RATIO * packed_size:
        raise DamagedError(at, f"the chunk claims to unpack from {packed_size:,} to {size:,} bytes")
    unpacked = _decompress(name, packed, size, at)
    if len(unpacked) != size:
        raise DamagedError(at, f"the chunk unpacks to {len(unpacked):,} bytes and not to {size:,}")
    if crc and zlib.crc32(unpacked) != crc:
        raise DamagedError(at, "the chunk's checksum (CRC-32) does not agree with its bytes")
    return unpacked


def _decompress(name: bytes, packed: memoryview, size: int, at: int) -> Buffer:
    try:
        if name == b"":
            return packed
        if name == b"zstd":
            return _unzstd(packed, size, at)
        if name == b"lz4":
            # One byte over the claim is enough to see that it is wrong.
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1))
    except (zstandard.ZstdError, RuntimeError, EOFError, ValueError) as error:
        raise DamagedError(at, f"the chunk does not unpack ({error})") from error
    raise DamagedError(at, f"compression {name[:20]!r} is unknown; known are none, lz4 and zstd")


def _unzstd(packed: memoryview, size: int, at: int) -> bytes:
    # The library allocates what the frame claims, so the claim is compared with the checked size before.
    claim = zstandard.frame_content_size(packed)
    if claim not in (-1, size):
        raise DamagedError(at, f"the chunk unpacks to {claim:,} bytes and not to {size:,}")
    if size == 0:
        return b""
    return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
