"""A uniform grid over a triangle mesh: what is left to ask of a point, once its cell is known.

Most cells lie wholly in one triangle or are crossed by a single edge. Both are the same question, on which side of
a line a point lies, which takes no branch that a processor could guess wrongly; the line of a whole cell has all
points on one side. Only cells around vertices keep a list of triangles to be tried.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MARGIN_M = 1e-3
"""Triangles are registered in cells they nearly touch: far more than the tolerance and rounding together."""


class Grid(NamedTuple):
    """Cells and what to ask in them.

    frame : (4,) float64, x and y of the corner, cells per metre in x and y
    shape : cells in x and y
    cell : (nx * ny,) int32, >= 0 a row of `line` and `pick`, else -1 - (start in `lists`)
    lists : (m,) int32, runs of a count and that many triangles, ascending
    line : (q, 3) float64; a x + b y + c is the distance inside of an edge in metres, zero where none crosses
    pick : (q, 2) int32, the triangle of a point inside of the edge and of one outside; t is outside of all t
    """

    frame: Floats
    shape: tuple[int, int]
    cell: NDArray[np.int32]
    lists: NDArray[np.int32]
    line: Floats
    pick: NDArray[np.int32]


def build_grid(boxes: Floats, halfplanes: Floats, triangles: Ints, cells: float) -> Grid:
    """About so many cells over the triangles.

    boxes, halfplanes : of the triangles, see `Mesh`; triangles : (t, 3) vertices, counter-clockwise
    """
    count = len(triangles)
    none = np.arange(count + 1, dtype=np.int32)
    beyond = _beyond(triangles)
    mine = np.repeat(none[:-1], 3)
    line = np.concatenate([np.zeros((count + 1, 3)), halfplanes.reshape(-1, 3)])
    pick = np.concatenate([np.column_stack([none, none]), np.column_stack([mine, beyond.ravel()])])
    if not count:
        nothing = np.zeros(1, np.int32)
        return Grid(np.array([0.0, 0.0, 1.0, 1.0]), (1, 1), nothing, nothing, line, pick)
    low = boxes[:, :2].min(axis=0) - 1.0
    size = boxes[:, 2:].max(axis=0) + 1.0 - low
    edge = np.sqrt(size[0] * size[1] / cells)
    nx, ny = (int(np.clip(np.ceil(s / edge), 1, 4096)) for s in size)
    frame = np.array([low[0], low[1], nx / size[0], ny / size[1]])
    cell, count = _whole(halfplanes, boxes, frame, nx, ny)
    lists = _listed(halfplanes, boxes, frame, nx, ny, cell, count)
    _part(halfplanes, beyond, frame, nx, cell, count, lists)
    return Grid(frame, (nx, ny), cell, lists, line, pick)


def _beyond(triangles: Ints) -> NDArray[np.int32]:
    """(t, 3) the triangle beyond every edge, the number of triangles where there is none."""
    count = len(triangles)
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    vertices = int(triangles.max(initial=0)) + 1
    key, wanted = start * vertices + end, end * vertices + start
    order = np.argsort(key, kind="stable")
    at = order[np.minimum(np.searchsorted(key[order], wanted), max(len(order) - 1, 0))]
    return np.where(key[at] == wanted, at // 3, count).astype(np.int32).reshape(count, 3)


@njit(cache=True, nogil=True)
def _whole(planes, boxes, frame, nx, ny):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The triangle of every cell that lies wholly in one, -1 elsewhere; how many triangles touch each other cell."""
    cell = np.full(nx * ny, -1, np.int32)
    count = np.zeros(nx * ny, np.int32)
    span = np.empty(4, np.int64)
    for t in range(len(planes)):
        first, last = _rows(boxes[t], frame, ny)
        for j in range(first, last + 1):
            _span(planes[t], boxes[t], frame, nx, j, span)
            for i in range(span[0], span[1] + 1):
                at = j * nx + i
                if cell[at] >= 0:
                    continue
                if count[at] == 0 and span[2] <= i <= span[3]:
                    cell[at] = t
                else:
                    count[at] += 1
    return cell, count


@njit(cache=True, nogil=True)
def _listed(planes, boxes, frame, nx, ny, cell, count):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The lists of all other cells; `cell` then says where they begin, and where nothing touches."""
    total = 0
    for at in range(nx * ny):
        if cell[at] < 0 and count[at] == 0:
            cell[at] = len(planes)
        elif cell[at] < 0:
            cell[at] = -1 - total
            total += 1 + count[at]
    lists = np.zeros(total, np.int32)
    span = np.empty(4, np.int64)
    for t in range(len(planes)):
        first, last = _rows(boxes[t], frame, ny)
        for j in range(first, last + 1):
            _span(planes[t], boxes[t], frame, nx, j, span)
            for at in range(j * nx + span[0], j * nx + span[1] + 1):
                if cell[at] < 0:
                    start = -1 - cell[at]
                    lists[start] += 1
                    lists[start + lists[start]] = t
    return lists


@njit(cache=True, nogil=True)
def _part(planes, beyond, frame, nx, cell, count, lists):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Let cells that a single edge parts ask for its side in place of their list."""
    for at in range(len(cell)):
        if cell[at] < 0 and count[at] <= 2:
            edge = _only_edge(planes, beyond, frame, lists[-1 - cell[at] :], at % nx, at // nx)
            if edge >= 0:
                cell[at] = len(planes) + 1 + edge


@njit(cache=True, nogil=True)
def _rows(box, frame, ny):  # type: ignore[no-untyped-def]  # pragma: no cover
    """First and last row of cells that a triangle's box touches."""
    first = int((box[1] - MARGIN_M - frame[1]) * frame[3])
    last = int((box[3] + MARGIN_M - frame[1]) * frame[3])
    return max(first, 0), min(last, ny - 1)


@njit(cache=True, nogil=True)
def _span(planes, box, frame, nx, j, span):  # type: ignore[no-untyped-def]  # pragma: no cover
    """First and last cell of row j that the triangle touches, or all but; then those that surely lie inside."""
    hx, hy = 0.5 / frame[2], 0.5 / frame[3]
    cy = frame[1] + (j + 0.5) / frame[3]
    touch0 = max(np.floor((box[0] - MARGIN_M - frame[0]) * frame[2]), 0.0)
    touch1 = min(np.floor((box[2] + MARGIN_M - frame[0]) * frame[2]), nx - 1.0)
    inside0, inside1 = touch0, touch1
    for k in range(3):
        a = planes[k, 0]
        reach = abs(a) * hx + abs(planes[k, 1]) * hy + MARGIN_M
        along = planes[k, 1] * cy + planes[k, 2]  # a x + along is the distance of a cell's middle
        if abs(a) < 1e-12:
            touch1 = touch1 if along >= -reach else -1.0
            inside1 = inside1 if along > reach else -1.0
            continue
        near = ((-reach - along) / a - frame[0]) * frame[2] - 0.5
        far = ((reach - along) / a - frame[0]) * frame[2] - 0.5
        if a > 0.0:
            touch0, inside0 = max(touch0, np.ceil(near)), max(inside0, np.ceil(far))
        else:
            touch1, inside1 = min(touch1, np.floor(near)), min(inside1, np.floor(far))
    span[0], span[1] = int(min(touch0, nx)), int(max(touch1, -1.0))
    span[2], span[3] = int(min(inside0, nx)), int(max(inside1, -1.0))


@njit(cache=True, nogil=True)
def _only_edge(planes, beyond, frame, listed, i, j):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The edge, three per triangle, that alone parts a cell with one or two triangles; -1 where it is not so."""
    t = listed[1]
    k = _crossing(planes[t], frame, i, j)
    if k < 0:
        return -1
    other = beyond[t, k]
    if listed[0] == 1:
        return 3 * t + k if other == len(planes) else -1
    back = _crossing(planes[listed[2]], frame, i, j)
    if other != listed[2] or back < 0 or beyond[other, back] != t:
        return -1
    return 3 * t + k


@njit(cache=True, nogil=True)
def _crossing(planes, frame, i, j):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Which edge of the triangle crosses or nears the cell; -1 unless it is exactly one."""
    cx, cy = frame[0] + (i + 0.5) / frame[2], frame[1] + (j + 0.5) / frame[3]
    found = -1
    for k in range(3):
        reach = abs(planes[k, 0]) * 0.5 / frame[2] + abs(planes[k, 1]) * 0.5 / frame[3] + MARGIN_M
        if planes[k, 0] * cx + planes[k, 1] * cy + planes[k, 2] <= reach:
            if found >= 0:
                return -1
            found = k
    return found
