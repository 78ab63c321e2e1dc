"""Recordings that we write are those of the reference library, byte for byte."""

from __future__ import annotations

import io

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from flexmap_tasks.formats import mcap_file
from flexmap_tasks.formats.mcap_file import CHUNK_BYTES, McapFile

RNG = np.random.default_rng(4)
SIZES = {
    "nothing": [],
    "one": [0],
    "many small": RNG.integers(0, 300, 20_000),
    "large": RNG.integers(0, 2 * CHUNK_BYTES, 9),
    "ends with a chunk": [CHUNK_BYTES, 5],
}


def rows(sizes: object) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[bytes]]:
    """Channels, log times out of order, sequences and messages."""
    size = np.array(sizes, np.int64)
    log_ns = 1_700_000_000_000_000_000 + RNG.integers(0, 10**9, len(size))
    return RNG.integers(1, 4, len(size)), log_ns, np.arange(len(size)), [RNG.bytes(int(n)) for n in size]


def by_the_library(messages: tuple[np.ndarray, np.ndarray, np.ndarray, list[bytes]]) -> bytes:
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.ZSTD, chunk_size=CHUNK_BYTES)
    writer.start(profile="ros2", library="flexmap")
    schemas = [writer.register_schema(f"kind {k}", "ros2msg", bytes(9 * k)) for k in range(2)]
    for k in range(3):
        writer.register_channel(f"/topic/{k}", "cdr", schemas[k % 2], {"qos": str(k)} if k else {})
    for channel, log_ns, sequence, text in zip(*messages, strict=True):
        writer.add_message(int(channel), int(log_ns), text, int(log_ns), int(sequence))
    writer.finish()
    return stream.getvalue()


@pytest.mark.parametrize("sizes", SIZES)
@pytest.mark.parametrize("at_once", [1, 7, 1 << 20])
def test_a_file_is_what_the_reference_library_writes(sizes: str, at_once: int) -> None:
    messages = rows(SIZES[sizes][:300] if at_once == 1 else SIZES[sizes])
    stream = io.BytesIO()
    file = McapFile(stream, "ros2")
    schemas = [file.schema(f"kind {k}", "ros2msg", bytes(9 * k)) for k in range(2)]
    for k in range(3):
        file.channel(f"/topic/{k}", "cdr", schemas[k % 2], {"qos": str(k)} if k else {})
    for start in range(0, len(messages[3]), at_once):
        file.messages(*(column[start : start + at_once] for column in messages))
    file.finish()
    assert stream.getvalue() == by_the_library(messages)


def test_the_public_reader_finds_messages_by_time_and_topic(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_file, "CHUNK_BYTES", 1000)
    channel, log_ns, sequence, texts = rows(RNG.integers(0, 200, 200))
    stream = io.BytesIO()
    file = McapFile(stream, "")
    for k in range(3):
        file.channel(f"/topic/{k}", "json", file.schema(str(k), "jsonschema", b"{}"), {})
    file.messages(channel, log_ns, sequence, texts)
    file.finish()
    middle = int(np.median(log_ns))
    reader = make_reader(io.BytesIO(stream.getvalue()), validate_crcs=True)
    found = [m.data for *_, m in reader.iter_messages(topics=["/topic/1"], starting_at=middle)]
    wanted = [k for k in np.argsort(log_ns, kind="stable") if channel[k] == 2 and log_ns[k] >= middle]
    assert found == [texts[k] for k in wanted]
    assert len(wanted) > 20
