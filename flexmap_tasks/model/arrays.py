"""Array types, and how a value checks its arrays when it is made."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Strings = NDArray[np.object_]
"""Object arrays of `str` (or None where a docstring says so)."""


def freeze(array: NDArray[Any]) -> NDArray[Any]:
    """The array itself, made read-only: a value never changes after it was made."""
    array.flags.writeable = False
    return array


def strings(values: Any) -> Strings:
    """A 1-D object array of the given strings (numpy would make a 2-D array of equal-length ones)."""
    values = list(values)
    out: Strings = np.empty(len(values), dtype=object)
    out[:] = values
    return out


def require(condition: bool | np.bool_, message: str) -> None:
    """Raise ValueError(message) unless the condition holds; for invariants of values, not for user input."""
    if not condition:
        raise ValueError(message)
