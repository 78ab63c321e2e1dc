"""LZF, the compression of PCD's `binary_compressed`: bounded on both sides, safe on any bytes.

The stream is a row of tokens. A control byte under 32 announces that many bytes plus one, as they are. Any
other repeats earlier output: its upper three bits are the length less two (7 means that another byte is
added), its lower five and the last byte of the token the distance less one.
"""

from __future__ import annotations

from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

MAX_RATIO = 88
"""No LZF token makes more than 264 bytes out of 3."""

TRUNCATED, OVERLONG, BEFORE_START = -1, -2, -3
REASONS = {
    TRUNCATED: "ends in the middle of a token",
    OVERLONG: "holds more than it declares",
    BEFORE_START: "refers to bytes before its start",
}

_BYTES_IN = nb.types.Array(nb.uint8, 1, "C", readonly=True)


@nb.njit(nb.int64(_BYTES_IN, nb.uint8[::1]), cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def lzf_decode(packed: NDArray[np.uint8], out: NDArray[np.uint8]) -> int:  # noqa: PLR0911 - one return per fault
    """Unpack into `out`; the number of bytes made, or one of the negative REASONS."""
    i: Any = 0
    o: Any = 0
    while i < packed.size:
        control = np.int64(packed[i])
        i += 1
        if control < 32:
            size = control + 1
            if i + size > packed.size:
                return TRUNCATED
            if o + size > out.size:
                return OVERLONG
            for k in range(size):
                out[o + k] = packed[i + k]
            i += size
            o += size
            continue
        size = (control >> 5) + 2
        if size == 9:
            if i >= packed.size:
                return TRUNCATED
            size += np.int64(packed[i])
            i += 1
        if i >= packed.size:
            return TRUNCATED
        start = o - ((control & 31) << 8) - np.int64(packed[i]) - 1
        i += 1
        if start < 0:
            return BEFORE_START
        if o + size > out.size:
            return OVERLONG
        for k in range(size):  # byte by byte: the source may overlap what is being written
            out[o + k] = out[start + k]
        o += size
    return int(o)
