"""Points on a grid: grouped by tile, thinned by voxel."""

from __future__ import annotations

from collections.abc import Callable

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


def nearest_per_voxel(
    xyz_m: NDArray[np.float64], size_m: float, content: Callable[[int], bytes] | None = None
) -> NDArray[np.int64]:
    """Rows of the point nearest to the middle of every voxel, ascending; voxels are floor(xyz / size_m).

    xyz_m : (n, 3) metres, finite, |xyz / size_m| < 2^53
    content : what else a row holds; decides between points at one place, so that their order does not

    The same points stay whatever order they come in.
    """
    if not len(xyz_m):
        return np.empty(0, np.int64)
    cells = np.floor(xyz_m / size_m)
    away = (((xyz_m / size_m - cells) - 0.5) ** 2).sum(axis=1)
    order, starts = _by_voxel(cells)
    least = np.minimum.reduceat(away[order], starts[:-1])
    size = np.diff(starts)
    close = away[order] == np.repeat(least, size)
    rows, voxel = order[close], np.repeat(np.arange(len(size)), size)[close]
    if len(rows) > len(size):  # several are equally near
        rows, voxel = _settle(rows, voxel, xyz_m, content)
    return np.sort(rows).astype(np.int64)


def _by_voxel(cells: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows sorted by voxel (n,), and where each voxel starts in them (v + 1,)."""
    low = cells.min(axis=0)
    span = [int(v) + 1 for v in cells.max(axis=0) - low]
    if span[0] * span[1] * span[2] < 1 << 62:
        x, y, z = (cells - low).astype(np.int64).T
        code = (x * span[1] + y) * span[2] + z
        order = np.argsort(code, kind="stable")
        new = np.diff(code[order]) != 0
    else:
        order = np.lexsort(cells.T)
        new = (np.diff(cells[order], axis=0) != 0).any(axis=1)
    return order, np.concatenate([[0], np.flatnonzero(new) + 1, [len(order)]]).astype(np.int64)


def _settle(
    rows: NDArray[np.int64],
    voxel: NDArray[np.int64],
    xyz_m: NDArray[np.float64],
    content: Callable[[int], bytes] | None,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Of the rows of each voxel the one with the least coordinates, then content, then number."""
    order = np.lexsort((rows, *xyz_m[rows].T[::-1], voxel))
    rows, voxel = rows[order], voxel[order]
    starts = np.flatnonzero(np.append(True, np.diff(voxel) != 0))
    stops = np.append(starts[1:], len(rows))
    chosen = rows[starts]
    if content is not None:
        for i in np.flatnonzero(stops - starts > 1).tolist():
            group = rows[starts[i] : stops[i]]
            same = group[(xyz_m[group] == xyz_m[group[0]]).all(axis=1)].tolist()
            if len(same) > 1:
                chosen[i] = min(same, key=content)
    return chosen, voxel[starts]
