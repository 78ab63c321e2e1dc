"""An MCAP file as channels and raw messages (https://mcap.dev/spec), read through a memory map.

Only chunks that hold a wanted channel are unpacked; the message indexes behind the chunks say which. Files
without indexes or without a summary are read all the same, by opening every chunk. Everything in the file is
hostile: no allocation follows a number in the file that its bytes do not back up.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import TypeVar

import numpy as np

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.cdr import Bytes, gather
from flexmap_tasks.formats.mcap_chunks import (
    INDEX_ENTRY,
    MESSAGE,
    Buffer,
    Chunk,
    DamagedError,
    indexed_bounds,
    message_bounds,
    records,
    unpack_chunk,
)
from flexmap_tasks.model.arrays import Ints

MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _CHUNK, _MESSAGE_INDEX, _DATA_END = 0x02, 0x03, 0x04, 0x06, 0x07, 0x0F
_MESSAGE_HEAD = 22  # channel id u16, sequence u32, log time u64, publish time u64
_RECORD_HEAD = 9

V = TypeVar("V")


@dataclass(frozen=True, slots=True)
class Schema:
    """Name, encoding and text of a message type."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic as one publisher wrote it."""

    topic: str
    schema_id: int
    encoding: str


@dataclass(frozen=True, slots=True, eq=False)
class Messages:
    """Messages of wanted channels, in the order of the file.

    data : (bytes,) the buffer all of them lie in
    begin, end : (n,) bounds of each message's own bytes
    log_time_ns : (n,) uint64
    """

    data: Bytes
    begin: Ints
    end: Ints
    log_time_ns: Ints

    def __len__(self) -> int:
        return len(self.begin)


class Recording:
    """What an MCAP file holds.

    channels : by channel id
    schemas : by schema id
    counts : number of messages by channel id
    """

    def __init__(self, name: str, data: Buffer) -> None:
        self.name, self._data = name, data
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.counts: dict[int, int] = {}
        self._chunks: list[Chunk] = []
        self._loose: list[tuple[int, int]] = []
        try:
            self._walk()
        except DamagedError as error:
            raise self._cut(error) from error
        self._take_stock()

    def messages(self, channels: frozenset[int]) -> Iterator[Messages]:
        """Messages of the given channel ids, a piece per chunk, in the order of the file.

        Raises InputError where a chunk is damaged.
        """
        if self._loose:
            bounds = np.asarray(self._loose, dtype=np.int64)
            yield self._pick(self._data, bounds[:, 0], bounds[:, 1], channels)
        for chunk in self._chunks:
            if chunk.index is None or not channels.isdisjoint(chunk.index):
                yield self._messages_of(chunk, channels)

    def _messages_of(self, chunk: Chunk, channels: frozenset[int]) -> Messages:
        """Messages of a chunk; as many as its index has promised, where it has one."""
        counts = chunk.counts()
        if counts is None:
            return self._pick(*self._open(chunk), channels)
        expected = sum(count for channel, count in counts.items() if channel in channels)
        found = self._pick(*self._open(chunk), channels)
        if len(found) == expected:
            return found
        rule = f"the index promises {expected:,} messages and the chunk holds {len(found):,}"
        raise self._damaged(chunk, DamagedError(chunk.begin, rule))

    def _walk(self) -> None:
        data, size = self._data, len(self._data)
        if data[: len(MAGIC)] != MAGIC:
            raise DamagedError(0, "the first bytes of an MCAP file are cut off")
        for opcode, begin, end in records(data, len(MAGIC), size):
            if opcode == MESSAGE:
                self._loose.append((begin, end))
            elif opcode == _CHUNK:
                self._chunks.append(Chunk(begin, end, None))
            elif opcode == _MESSAGE_INDEX:
                self._index(begin, end)
            elif opcode in (_SCHEMA, _CHANNEL):
                self._define(opcode, bytes(data[begin:end]), begin)
            elif opcode == _DATA_END and self._loose and end - begin >= 4:
                self._check_crc(0, begin - _RECORD_HEAD, begin)
            elif opcode == _FOOTER:
                self._finish(begin, end)
                return
        raise DamagedError(size, "the footer is missing")

    def _finish(self, begin: int, end: int) -> None:
        if end - begin < 20 or self._data[end : end + len(MAGIC)] != MAGIC:
            raise DamagedError(begin, "the end of the file is missing")
        (summary,) = struct.unpack_from("<Q", self._data, begin)
        if 0 < summary < begin:
            self._check_crc(summary, begin + 16, begin + 16)

    def _check_crc(self, begin: int, end: int, at: int) -> None:
        """Compare the CRC-32 of data[begin:end] with the one stored at `at`, unless that is 0 (not given)."""
        (crc,) = struct.unpack_from("<I", self._data, at)
        if crc and zlib.crc32(memoryview(self._data)[begin:end]) != crc:
            rule = "the MCAP file is damaged: a checksum (CRC-32) does not agree with its bytes"
            raise InputError(self.name, f"{rule}; copy or record it again", f"bytes {begin:,} to {end:,}")

    def _index(self, begin: int, end: int) -> None:
        if not self._chunks or end - begin < 6:
            raise DamagedError(begin, "a message index belongs to no chunk")
        channel, length = struct.unpack_from("<HI", self._data, begin)
        if length > end - begin - 6:
            raise DamagedError(begin, "a message index is longer than its record")
        last = self._chunks[-1]
        index = {} if last.index is None else last.index
        if channel in index or length % INDEX_ENTRY:
            raise DamagedError(begin, "a message index is damaged")
        index[channel] = (begin + 6, begin + 6 + length)
        self._chunks[-1] = Chunk(last.begin, last.end, index)

    def _define(self, opcode: int, content: bytes, at: int) -> None:
        try:
            if opcode == _SCHEMA:
                (number,) = struct.unpack_from("<H", content)
                name, rest = _text(content, 2)
                encoding, rest = _text(content, rest)
                _put(self.schemas, number, Schema(name, encoding, _blob(content, rest)[0]))
            else:
                number, schema = struct.unpack_from("<HH", content)
                topic, rest = _text(content, 4)
                encoding, rest = _text(content, rest)
                _put(self.channels, number, Channel(topic, schema, encoding))
        except (struct.error, UnicodeDecodeError, ValueError) as error:
            raise DamagedError(at, "a schema or channel record is damaged") from error

    def _take_stock(self) -> None:
        """Count messages by channel; open the chunks without an index and those with channels not yet known."""
        for chunk in self._chunks:
            counts = chunk.counts()
            if counts is None or not self.channels.keys() >= counts.keys():
                counts = self._survey(chunk)
            for channel, count in counts.items():
                self.counts[channel] = self.counts.get(channel, 0) + count
        for begin, end in self._loose:
            channel = self._channel_of(begin, end)
            self.counts[channel] = self.counts.get(channel, 0) + 1
        unknown = sorted(self.counts.keys() - self.channels.keys())
        if unknown:
            raise InputError(self.name, f"the MCAP file is damaged: messages of unknown channel {unknown[0]}")

    def _channel_of(self, begin: int, end: int) -> int:
        if end - begin < _MESSAGE_HEAD:
            raise InputError(self.name, "the MCAP file is damaged: a message without head", f"byte {begin:,}")
        return int.from_bytes(self._data[begin : begin + 2], "little")

    def _survey(self, chunk: Chunk) -> dict[int, int]:
        unpacked, begin, end = self._open(chunk)
        try:
            for opcode, start, stop in records(unpacked, 0, len(unpacked)):
                if opcode in (_SCHEMA, _CHANNEL):
                    self._define(opcode, bytes(unpacked[start:stop]), start)
        except DamagedError as error:
            raise self._damaged(chunk, error) from error
        found = self._heads(np.frombuffer(unpacked, dtype=np.uint8), begin, end)["channel"]
        ids, numbers = np.unique(found, return_counts=True)
        return dict(zip(ids.tolist(), numbers.tolist(), strict=True))

    def _open(self, chunk: Chunk) -> tuple[Buffer, Ints, Ints]:
        """The chunk's bytes and the bounds of its messages, from its index where that tells the truth."""
        try:
            unpacked = unpack_chunk(self._data, chunk)
            spans = () if chunk.index is None else chunk.index.values()
            bounds = indexed_bounds(unpacked, b"".join(self._data[begin:end] for begin, end in spans))
            return unpacked, *(message_bounds(unpacked) if bounds is None else bounds)
        except DamagedError as error:
            raise self._damaged(chunk, error) from error

    def _heads(self, data: Bytes, begin: Ints, end: Ints) -> np.ndarray[tuple[int], np.dtype[np.void]]:
        if (end - begin < _MESSAGE_HEAD).any():
            raise InputError(self.name, "the MCAP file is damaged: a message is shorter than its head")
        head = np.dtype([("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")])
        return gather(data, begin, _MESSAGE_HEAD).view(head)

    def _pick(self, buffer: Buffer, begin: Ints, end: Ints, channels: frozenset[int]) -> Messages:
        data = np.frombuffer(buffer, dtype=np.uint8)
        heads = self._heads(data, begin, end)
        wanted = np.zeros(1 << 16, dtype=bool)
        wanted[sorted(channels)] = True
        keep = wanted[heads["channel"]]
        log = heads["log"][keep]
        if len(log) and log.max() > np.iinfo(np.int64).max:
            raise InputError(self.name, "the MCAP file is damaged: a log time lies after the year 2262")
        return Messages(data, begin[keep] + _MESSAGE_HEAD, end[keep], log.astype(np.int64))

    def _damaged(self, chunk: Chunk, error: DamagedError) -> InputError:
        rule = f"the MCAP file is damaged: {error.rule}; copy or record it again, or try `mcap recover`"
        return InputError(self.name, rule, f"chunk at byte {chunk.begin - _RECORD_HEAD:,}")

    def _cut(self, error: DamagedError) -> InputError:
        """The error for a file that ends too early; says how much of it could be read."""
        whole = len(self._loose)
        for chunk in self._chunks:
            counts = chunk.counts()
            if counts is not None:
                whole += sum(counts.values())
                continue
            try:
                whole += len(message_bounds(unpack_chunk(self._data, chunk))[0])
            except DamagedError:
                break
        rule = (
            f"the MCAP file is cut off or damaged: {error.rule}; {whole:,} whole messages stand before it; "
            "copy or record it again, or write a whole file from the rest with `mcap recover`"
        )
        return InputError(self.name, rule, f"byte {error.at:,} of {len(self._data):,}")


def open_recording(name: str, path: Path) -> Recording:
    """Map the file and take stock of it; `name` is the name for messages.

    Raises InputError for a file that cannot be read, is cut off or is damaged.
    """
    try:
        with path.open("rb") as file:
            data = mmap(file.fileno(), 0, access=ACCESS_READ)
    except (OSError, ValueError) as error:
        raise InputError(name, f"the file cannot be read ({error})") from error
    return Recording(name, data)


def _put(table: dict[int, V], number: int, value: V) -> None:
    if table.setdefault(number, value) != value:
        raise ValueError("one id stands for two things")


def _text(content: bytes, at: int) -> tuple[str, int]:
    raw, rest = _blob(content, at)
    return raw.decode(), rest


def _blob(content: bytes, at: int) -> tuple[bytes, int]:
    (length,) = struct.unpack_from("<I", content, at)
    stop = at + 4 + length
    if stop > len(content):
        raise ValueError("a length goes over the end")
    return content[at + 4 : stop], stop
