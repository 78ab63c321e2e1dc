"""ROS 2 messages in CDR, many at once: a cursor that moves through all messages of one type in step.

Strings make messages of one type differ in length, so a field has an offset per message. One gather per
field over these offsets replaces one decoder call per message and field. Plain CDR (XCDR1), both byte orders:
https://www.omg.org/spec/DDSI-RTPS/2.3 section 10.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.model.arrays import Bools, Ints

Bytes = NDArray[np.uint8]

ENCAPSULATION = 4
"""Bytes before the message: representation (2) and options (2); alignment counts from behind them."""


class CdrError(Exception):
    """Message `row` is no valid CDR; `rule` says why."""

    def __init__(self, row: int, rule: str) -> None:
        super().__init__(row, rule)
        self.row, self.rule = row, rule


def byte_orders(data: Bytes, begin: Ints, end: Ints) -> list[Cursor]:
    """A cursor for the little-endian and one for the big-endian messages, where there are any.

    data : (bytes,) all messages
    begin, end : (n,) bounds of each message in `data`
    """
    require_rows(end - begin >= ENCAPSULATION, "the message is shorter than a CDR header")
    head = gather(data, begin, 2).reshape(-1, 2)
    require_rows((head[:, 0] == 0) & (head[:, 1] <= 1), "the encapsulation is not plain CDR")
    cursors = []
    for flag, order in ((1, "<"), (0, ">")):
        rows = np.flatnonzero(head[:, 1] == flag)
        if len(rows):
            cursors.append(Cursor(data, begin[rows], end[rows], rows, order))
    return cursors


def gather(data: Bytes, at: Ints, width: int) -> Bytes:
    """(n * width,) bytes: `width` bytes of `data` from each offset; the caller has checked the bounds."""
    if not len(at) or not width:
        return np.empty(0, dtype=np.uint8)
    # A view of every byte position as one item of `width` bytes: the gather copies whole items.
    windows: NDArray[Any] = np.ndarray(
        (len(data) - width + 1,), dtype=f"V{width}", buffer=data, strides=(data.strides[0],)
    )
    return windows[at].view(np.uint8)


def require_rows(good: Bools, rule: str, rows: Ints | None = None) -> None:
    """Raise CdrError for the first message that is not good."""
    if not good.all():
        bad = int(np.argmin(good))
        raise CdrError(bad if rows is None else int(rows[bad]), rule)


class Cursor:
    """Stands at the same field of n messages; each read moves all of them.

    rows : (n,) number of each message in the caller's order
    """

    def __init__(self, data: Bytes, begin: Ints, end: Ints, rows: Ints, order: str) -> None:
        self._data, self._order, self.rows = data, order, rows
        self._origin = begin + ENCAPSULATION
        self._end = end
        self._at = self._origin.copy()

    def __len__(self) -> int:
        return len(self.rows)

    def numbers(self, code: str, count: int = 1) -> NDArray[Any]:
        """(n, count) next numbers of the numpy type `code`, such as "f8"."""
        dtype = np.dtype(self._order + code)
        self._align(dtype.itemsize)
        raw = self._take(dtype.itemsize * count)
        return raw.view(dtype).reshape(len(self), count).astype(dtype.newbyteorder("="), copy=False)

    def skip(self, code: str, count: int = 1) -> None:
        """Step over numbers."""
        dtype = np.dtype(code)
        self._align(dtype.itemsize)
        self._advance(np.full(len(self), dtype.itemsize * count))

    def skip_text(self) -> None:
        """Step over a string."""
        self._advance(self.numbers("u4")[:, 0].astype(np.int64))

    def skip_numbers(self, code: str) -> None:
        """Step over a sequence of numbers."""
        size = np.dtype(code).itemsize
        count = self.numbers("u4")[:, 0].astype(np.int64)
        require_rows(count * size <= self.remaining() + size, "the message is cut off", self.rows)
        aligned = self._at + (self._origin - self._at) % size
        self._at = np.where(count > 0, aligned, self._at)
        self._advance(count * size)

    def texts(self) -> list[bytes]:
        """The next string of each message, without its closing zero."""
        length = self.numbers("u4")[:, 0].astype(np.int64)
        start = self._at
        self._advance(length)
        whole = self._data.data
        bounds = zip(start.tolist(), self._at.tolist(), strict=True)
        return [bytes(whole[a:b]).rstrip(b"\0") for a, b in bounds]

    def remaining(self) -> Ints:
        """(n,) bytes between the cursor and the end of each message."""
        return self._end - self._at

    def select(self, keep: Bools) -> Cursor:
        """A cursor at the same place over some of the messages."""
        out = Cursor.__new__(Cursor)
        out._data, out._order, out.rows = self._data, self._order, self.rows[keep]
        out._origin, out._end, out._at = self._origin[keep], self._end[keep], self._at[keep]
        return out

    def _align(self, size: int) -> None:
        # Without a bounds check: the read that follows checks.
        self._at = self._at + (self._origin - self._at) % size

    def _advance(self, width: Ints) -> None:
        stop = self._at + width
        require_rows(stop <= self._end, "the message is cut off", self.rows)
        self._at = stop

    def _take(self, width: int) -> Bytes:
        at = self._at
        self._advance(np.full(len(self), width))
        return gather(self._data, at, width)
