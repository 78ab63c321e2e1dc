"""MCAP files (https://mcap.dev/spec) written many messages at a time: numpy lays out what stands before each.

The file is, byte for byte, what the reference library writes from the same messages.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from typing import BinaryIO

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Schema,
    Statistics,
    SummaryOffset,
)

from flexmap_tasks.formats.mcap_records import MAGIC
from flexmap_tasks.model.arrays import Ints

CHUNK_BYTES = 1 << 20
"""The message that makes a chunk larger than this is its last."""

_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("bytes", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log", "<u8"),
        ("publish", "<u8"),
    ]
)
_INDEX = np.dtype([("log", "<u8"), ("offset", "<u8")])
_RECORD_HEAD = 9  # opcode u8, bytes u64: not counted by the latter


class McapFile:
    """A file that is being written to a stream."""

    def __init__(self, stream: BinaryIO, profile: str) -> None:
        self._stream, self._at = stream, 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._counts: dict[int, int] = {}
        self._parts: list[bytes] = []
        self._size = 0
        self._index: list[tuple[Ints, Ints, Ints]] = []
        self._write(MAGIC + _bytes([Header(profile, "flexmap")]))

    def schema(self, name: str, encoding: str, text: bytes) -> int:
        """Number of a new type of messages."""
        self._schemas.append(Schema(len(self._schemas) + 1, text, encoding, name))
        self._add([_bytes(self._schemas[-1:])])
        return self._schemas[-1].id

    def channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Number of a new topic."""
        self._channels.append(Channel(len(self._channels) + 1, topic, encoding, dict(metadata), schema))
        self._add([_bytes(self._channels[-1:])])
        return self._channels[-1].id

    def messages(self, channel: Ints, log_ns: Ints, sequence: Ints, texts: Sequence[bytes]) -> None:
        """Messages in the order of the file; their publish time is their log time."""
        head = np.empty(len(texts), _HEAD)
        size = np.fromiter(map(len, texts), np.int64, len(texts))
        head["opcode"], head["bytes"] = Opcode.MESSAGE, size + _HEAD.itemsize - _RECORD_HEAD
        head["channel"], head["sequence"] = channel, sequence
        head["log"] = head["publish"] = log_ns
        heads, ends = head.tobytes(), np.cumsum(size + _HEAD.itemsize)
        start = 0
        while start < len(texts):
            base = self._size - (int(ends[start - 1]) if start else 0)
            stop = min(int(np.searchsorted(ends, CHUNK_BYTES - base, side="right")) + 1, len(texts))
            rows = slice(start, stop)
            offset = base + ends[rows] - size[rows] - _HEAD.itemsize
            self._index.append((channel[rows], log_ns[rows], offset))
            step = _HEAD.itemsize
            self._add(
                part for i in range(start, stop) for part in (heads[i * step : (i + 1) * step], texts[i])
            )
            start = stop

    def finish(self) -> None:
        """Write what is still waiting, and the summary."""
        self._end_chunk()
        self._write(_bytes([DataEnd(0)]))
        groups: dict[Opcode, Sequence[McapRecord]] = {
            Opcode.SCHEMA: self._schemas,
            Opcode.CHANNEL: self._channels,
            Opcode.STATISTICS: [self._statistics()],
            Opcode.CHUNK_INDEX: self._chunks,
            Opcode.ATTACHMENT_INDEX: [],
            Opcode.METADATA_INDEX: [],
        }
        start, summary, offsets = self._at, b"", []
        for opcode, group in groups.items():
            content = _bytes(group)
            offsets.append(SummaryOffset(opcode, start + len(summary), len(content)))
            summary += content
        footer = Footer(start, start + len(summary), 0)
        summary += _bytes(offsets)
        footer.summary_crc = zlib.crc32(summary + _bytes([footer])[:-4])
        self._write(summary + _bytes([footer]) + MAGIC)

    def _statistics(self) -> Statistics:
        first = min((c.message_start_time for c in self._chunks), default=0)
        last = max((c.message_end_time for c in self._chunks), default=0)
        messages, channels, schemas = sum(self._counts.values()), len(self._channels), len(self._schemas)
        return Statistics(0, channels, self._counts, len(self._chunks), messages, last, first, 0, schemas)

    def _write(self, content: bytes) -> None:
        self._stream.write(content)
        self._at += len(content)

    def _add(self, parts: Iterable[bytes]) -> None:
        before = len(self._parts)
        self._parts += parts
        self._size += sum(map(len, self._parts[before:]))
        if self._size > CHUNK_BYTES:
            self._end_chunk()

    def _end_chunk(self) -> None:
        if not self._index:
            return
        content, start = b"".join(self._parts), self._at
        channel, log_ns, offset = (np.concatenate(column) for column in zip(*self._index, strict=True))
        packed, first, last = zstandard.compress(content), int(log_ns.min()), int(log_ns.max())
        self._write(_bytes([Chunk("zstd", packed, last, first, zlib.crc32(content), len(content))]))
        length, places = self._at - start, dict[int, int]()
        found, seen = np.unique(channel, return_index=True)
        for number in found[np.argsort(seen)].tolist():
            rows = np.flatnonzero(channel == number)
            entries = np.empty(len(rows), _INDEX)
            entries["log"], entries["offset"] = log_ns[rows], offset[rows]
            places[number] = self._at
            self._counts[number] = self._counts.get(number, 0) + len(rows)
            self._write(_message_index(number, entries.tobytes()))
        index_bytes = self._at - start - length
        self._chunks.append(
            ChunkIndex(length, start, "zstd", len(packed), last, index_bytes, places, first, len(content))
        )
        self._parts, self._size, self._index = [], 0, []


def _message_index(channel: int, entries: bytes) -> bytes:
    builder = RecordBuilder()
    builder.start_record(Opcode.MESSAGE_INDEX)
    builder.write2(channel)
    builder.write4(len(entries))
    builder.write(entries)
    builder.finish_record()  # type: ignore[no-untyped-call]
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _bytes(records: Iterable[McapRecord]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
