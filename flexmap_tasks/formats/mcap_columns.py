"""The messages of one topic: piece by piece, or all in one buffer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.cdr import CdrError, gather
from flexmap_tasks.formats.mcap_records import Messages, Recording
from flexmap_tasks.formats.mcap_topics import Topic
from flexmap_tasks.model.arrays import Ints

WHOLE_PIECE_SHARE = 0.1
"""A chunk is kept whole where the wanted messages fill at least this share of it."""
MOST_SHARE = 0.5
"""Messages of one length are picked out of a chunk at once, which is faster up to this share of it."""

T = TypeVar("T")


def pieces(recording: Recording, topic: Topic) -> Iterator[Messages]:
    """The messages of a topic, a piece per chunk."""
    return (piece for piece in recording.messages(topic.channels) if len(piece))


def slices(piece: Messages) -> Iterator[memoryview]:
    """The bytes of each message."""
    whole = piece.data.data
    bounds = zip(piece.begin.tolist(), piece.end.tolist(), strict=True)
    return (whole[begin:end] for begin, end in bounds)


def columns(recording: Recording, topic: Topic) -> Messages:
    """All messages of a topic in one buffer, which holds at most 1 / WHOLE_PIECE_SHARE times their bytes."""
    parts: list[bytes | memoryview] = []
    begins: list[Ints] = []
    lengths: list[Ints] = []
    log_times: list[Ints] = []
    size = 0
    for piece in pieces(recording, topic):
        length = piece.end - piece.begin
        # One copy of a whole chunk is faster than one of each message, where much of it is wanted.
        share = length.sum() / len(piece.data)
        alike = bool((length == length[0]).all())
        whole = share >= (MOST_SHARE if alike else WHOLE_PIECE_SHARE)
        if whole:
            parts.append(piece.data.data)
        else:
            parts.append(
                gather(piece.data, piece.begin, int(length[0])).data if alike else b"".join(slices(piece))
            )
        begins.append(size + (piece.begin if whole else np.cumsum(length) - length))
        lengths.append(length)
        log_times.append(piece.log_time_ns)
        size += len(parts[-1])
    begin = np.concatenate(begins)
    data = np.frombuffer(b"".join(parts), dtype=np.uint8)
    return Messages(data, begin, begin + np.concatenate(lengths), np.concatenate(log_times))


def guard(recording: Recording, topic: Topic, read: Callable[[], T], first: int = 0) -> T:
    """What `read` returns; a CdrError becomes an InputError that names the message (`first` is the piece's first)."""
    try:
        return read()
    except CdrError as error:
        where = f"topic {topic.label} message {first + error.row + 1}"
        rule = f"{error.rule}; it is no valid {topic.kind}: record again or name another topic"
        raise InputError(recording.name, rule, where) from error
