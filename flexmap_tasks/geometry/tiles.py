"""Points on a grid: grouped by tile, thinned by voxel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_RADIX_LIMIT = 1 << 16
"""Below this many codes numpy sorts by radix, ten times as fast as by comparison."""


def group_by_tile(
    xy_m: NDArray[np.float64], size_m: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Rows sorted by tile, the order within a tile kept.

    xy_m : (n, 2) metres, finite, |xy / size_m| < 2^30

    Returns the order (n,), where each tile starts in it (t + 1,), and the tiles (t, 2) as
    floor(xy / size_m), sorted by x then y.
    """
    if not len(xy_m):
        return np.empty(0, np.int64), np.zeros(1, np.int64), np.empty((0, 2), np.int64)
    # column by column: numpy reduces short rows many times slower
    ix, iy = (np.floor(xy_m[:, axis] / size_m).astype(np.int64) for axis in (0, 1))
    low = np.array([ix.min(), iy.min()])
    width, height = int(ix.max() - low[0]) + 1, int(iy.max() - low[1]) + 1
    code = (ix - low[0]) * height + (iy - low[1])
    small = width * height <= _RADIX_LIMIT
    order = np.argsort(code.astype(np.uint16) if small else code, kind="stable")
    in_order = code[order]
    first = np.concatenate([[0], np.flatnonzero(np.diff(in_order)) + 1])
    starts = np.append(first, len(code)).astype(np.int64)
    return order, starts, np.column_stack(np.divmod(in_order[first], height)) + low


def first_per_voxel(xyz_m: NDArray[np.float64], size_m: float) -> NDArray[np.int64]:
    """Rows of the first point in every voxel, ascending; voxels are floor(xyz / size_m).

    xyz_m : (n, 3) metres, finite, |xyz / size_m| < 2^53
    """
    if not len(xyz_m):
        return np.empty(0, np.int64)
    cells = [np.floor(xyz_m[:, axis] / size_m).astype(np.int64) for axis in range(3)]
    cells = [c - c.min() for c in cells]
    span = [int(c.max()) + 1 for c in cells]
    row_bits = len(xyz_m).bit_length()
    if (span[0] * span[1] * span[2]).bit_length() + row_bits < 63:
        # voxel and row in one number: its plain sort is several times faster than a stable sort of rows
        code = (cells[0] * span[1] + cells[1]) * span[2] + cells[2]
        packed = np.sort((code << row_bits) | np.arange(len(code)))
        new = np.append(True, np.diff(packed >> row_bits) != 0)
        first = packed[new] & ((1 << row_bits) - 1)
    else:
        first = np.unique(np.column_stack(cells), axis=0, return_index=True)[1]
    return np.sort(first).astype(np.int64)
