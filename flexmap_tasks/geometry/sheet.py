"""Piecewise affine maps of the plane over a triangle mesh, at the speed of memory.

A uniform grid remembers which triangles touch a cell; most cells lie wholly in one triangle, and their
points need no test. A point belongs to the first triangle, in the order given, that holds it within
`EDGE_TOLERANCE_M`: the answer depends neither on the grid's resolution nor on triangles further away.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

EDGE_TOLERANCE_M = 1e-7
"""A point this far outside of a triangle still belongs to it: rounding must not open gaps at edges."""

_CHUNK = 1 << 12
"""Points handled at a time: all of their arrays stay in the processor's first cache."""

_CELL_MARGIN_M = 1e-3
"""Triangles are registered in cells they nearly touch: far more than the tolerance and rounding together."""


class Mesh(NamedTuple):
    """A triangle mesh prepared for many points.

    halfplanes : (t, 3, 3) float64; a x + b y + c is the signed distance to an edge in metres, inside positive
    affine : (t + 1, 2, 3) float64, the map of every triangle, and last the one outside of all
    grid : (4,) float64, x and y of the grid's corner, cells per metre in x and y
    shape : cells in x and y
    cell : (nx * ny,) int32, >= 0 the triangle that fills the cell, -1 none, else -2 - (start in `lists`)
    lists : (m,) int32, runs of a count and that many triangles
    """

    halfplanes: Floats
    affine: Floats
    grid: Floats
    shape: tuple[int, int]
    cell: NDArray[np.int32]
    lists: NDArray[np.int32]


def build_mesh(source: Floats, target: Floats, triangles: Ints, outside: Floats, points: int) -> Mesh:
    """Prepare the map that takes the `source` vertices to the `target` ones.

    source, target : (v, 2) float64, metres
    triangles : (t, 3) int64, counter-clockwise in the source
    outside : (2, 3) float64, the affine map of everything outside the mesh
    points : how many points are to be moved; the grid is no finer than they repay
    """
    affine = np.concatenate([affine_maps(source[triangles], target[triangles]), outside[None]])
    halfplanes = _halfplanes(source[triangles])
    if len(triangles) == 0:
        nothing = np.full(1, -1, np.int32)
        return Mesh(halfplanes, affine, np.array([0.0, 0.0, 1.0, 1.0]), (1, 1), nothing, nothing)
    low = source[triangles].min(axis=(0, 1)) - 1.0
    size = source[triangles].max(axis=(0, 1)) + 1.0 - low
    cells = float(np.clip(points / 4, 256, 1 << 18))
    edge = np.sqrt(size[0] * size[1] / cells)
    nx, ny = (int(np.clip(np.ceil(s / edge), 1, 4096)) for s in size)
    grid = np.array([low[0], low[1], nx / size[0], ny / size[1]])
    boxes = np.concatenate([source[triangles].min(axis=1), source[triangles].max(axis=1)], axis=1)
    cell, lists = _rasterise(halfplanes, boxes, grid, nx, ny)
    return Mesh(halfplanes, affine, grid, (nx, ny), cell, lists)


def affine_maps(source: Floats, target: Floats) -> Floats:
    """(t, 2, 3) affine maps that take triangles (t, 3, 2) exactly onto others."""
    origin = source[:, :1]
    edges = np.swapaxes(source[:, 1:] - origin, 1, 2)
    moved = np.swapaxes(target[:, 1:] - target[:, :1], 1, 2)
    det = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    inverse = np.empty_like(edges)
    inverse[:, 0, 0], inverse[:, 1, 1] = edges[:, 1, 1] / det, edges[:, 0, 0] / det
    inverse[:, 0, 1], inverse[:, 1, 0] = -edges[:, 0, 1] / det, -edges[:, 1, 0] / det
    linear = np.einsum("tij,tjk->tik", moved, inverse)
    shift = target[:, 0] - np.einsum("tij,tj->ti", linear, source[:, 0])
    return np.concatenate([linear, shift[:, :, None]], axis=2)


def move(mesh: Mesh, xyz_m: Floats) -> Floats:
    """(n, 3) points moved by the mesh; z is kept."""
    out = np.empty((len(xyz_m), 3))
    move_into(mesh, np.ascontiguousarray(xyz_m), out)
    return out


def move_into(mesh: Mesh, xyz_m: Floats, out: Floats) -> None:
    """The same into memory that is there already; both arrays (n, 3) and contiguous."""
    _move_all(mesh.affine.ravel(), mesh.halfplanes, mesh.grid, *mesh.shape, mesh.cell, mesh.lists, xyz_m, out)


def locate(mesh: Mesh, xyz_m: Floats) -> Ints:
    """(n,) the triangle every point belongs to; the number of triangles where it is outside of all."""
    out = np.empty(len(xyz_m), np.int64)
    points = np.ascontiguousarray(xyz_m)
    _locate(mesh.halfplanes, mesh.grid, *mesh.shape, mesh.cell, mesh.lists, points, out)
    return out


def touching(corners: Floats, low: Floats, high: Floats) -> NDArray[np.bool_]:
    """(t,) which triangles (t, 3, 2), counter-clockwise, touch the box, with a small margin (separating axes)."""
    margin = 2 * _CELL_MARGIN_M
    apart = (corners.max(axis=1) < low - margin) | (corners.min(axis=1) > high + margin)
    planes = _halfplanes(corners)
    centre, half = (low + high) / 2, (high - low) / 2
    distance = planes[..., :2] @ centre + planes[..., 2]
    reach = np.abs(planes[..., :2]) @ half
    separated: NDArray[np.bool_] = apart.any(axis=1) | (distance < -(reach + margin)).any(axis=1)
    return ~separated


def _halfplanes(corners: Floats) -> Floats:
    start, end = corners, np.roll(corners, -1, axis=1)
    edge = end - start
    length = np.hypot(edge[..., 0], edge[..., 1])
    normal = np.stack([-edge[..., 1], edge[..., 0]], axis=-1) / length[..., None]
    return np.concatenate([normal, -(normal * start).sum(axis=-1, keepdims=True)], axis=-1)


@njit(cache=True, nogil=True)
def _touch(planes, cx, cy, hx, hy):  # type: ignore[no-untyped-def]  # pragma: no cover
    """0 the cell is apart from the triangle, 1 it touches, 2 it lies wholly inside."""
    inside = True
    for k in range(3):
        reach = abs(planes[k, 0]) * hx + abs(planes[k, 1]) * hy + _CELL_MARGIN_M
        distance = planes[k, 0] * cx + planes[k, 1] * cy + planes[k, 2]
        if distance < -reach:
            return 0
        inside = inside and distance > reach
    return 2 if inside else 1


@njit(cache=True, nogil=True)
def _rasterise(planes, boxes, grid, nx, ny):  # type: ignore[no-untyped-def]  # pragma: no cover
    hx, hy = 0.5 / grid[2], 0.5 / grid[3]
    cell = np.full(nx * ny, -1, np.int32)
    count = np.zeros(nx * ny, np.int32)
    lists = np.empty(0, np.int32)
    for fill in range(2):
        if fill:
            total = 0
            for i in range(nx * ny):
                if cell[i] == -1 and count[i] > 0:
                    cell[i] = -2 - total
                    total += 1 + count[i]
            lists = np.zeros(total, np.int32)
        for t in range(len(planes)):
            i0 = max(int((boxes[t, 0] - _CELL_MARGIN_M - grid[0]) * grid[2]), 0)
            j0 = max(int((boxes[t, 1] - _CELL_MARGIN_M - grid[1]) * grid[3]), 0)
            i1 = min(int((boxes[t, 2] + _CELL_MARGIN_M - grid[0]) * grid[2]), nx - 1)
            j1 = min(int((boxes[t, 3] + _CELL_MARGIN_M - grid[1]) * grid[3]), ny - 1)
            for j in range(j0, j1 + 1):
                for i in range(i0, i1 + 1):
                    at = j * nx + i
                    if cell[at] >= 0:
                        continue
                    cx = grid[0] + (i + 0.5) / grid[2]
                    cy = grid[1] + (j + 0.5) / grid[3]
                    touch = _touch(planes[t], cx, cy, hx, hy)
                    if touch == 0:
                        continue
                    if fill == 0:
                        count[at] += 1
                        if touch == 2:
                            cell[at] = t
                    else:
                        start = -2 - cell[at]
                        lists[start] += 1
                        lists[start + lists[start]] = t
    return cell, lists


@njit(cache=True, nogil=True)
def _find(planes, first, last, lists, x, y):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The first triangle of a cell's list that holds the point; -1 none."""
    for k in range(first, last):
        p = planes[lists[k]]
        if (
            p[0, 0] * x + p[0, 1] * y + p[0, 2] >= -EDGE_TOLERANCE_M
            and p[1, 0] * x + p[1, 1] * y + p[1, 2] >= -EDGE_TOLERANCE_M
            and p[2, 0] * x + p[2, 1] * y + p[2, 2] >= -EDGE_TOLERANCE_M
        ):
            return np.int64(lists[k])
    return np.int64(-1)


@njit(cache=True, nogil=True)
def _locate(planes, grid, nx, ny, cell, lists, xyz, out):  # type: ignore[no-untyped-def]  # pragma: no cover
    x0, y0, per_x, per_y = grid[0], grid[1], grid[2], grid[3]
    wide, high = float(nx), float(ny)
    for n in range(len(xyz)):
        x, y = xyz[n, 0], xyz[n, 1]
        u = (x - x0) * per_x
        v = (y - y0) * per_y
        t = np.int64(-1)
        if u >= 0.0 and v >= 0.0 and u < wide and v < high:
            t = np.int64(cell[np.uint64(np.uint32(v)) * np.uint64(nx) + np.uint64(np.uint32(u))])
            if t < -1:
                start = -2 - t
                t = _find(planes, start + 1, start + 1 + lists[start], lists, x, y)
        out[n] = t if t >= 0 else len(planes)


@njit(cache=True, nogil=True)
def _move(affine, rows, xyz, out):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Apply the affine map affine[rows[n]], flat runs of six, to every point."""
    for n in range(len(xyz)):
        x, y = xyz[n, 0], xyz[n, 1]
        k = np.uint64(6) * np.uint64(rows[n])
        out[n, 0] = affine[k] * x + affine[k + np.uint64(1)] * y + affine[k + np.uint64(2)]
        out[n, 1] = affine[k + np.uint64(3)] * x + affine[k + np.uint64(4)] * y + affine[k + np.uint64(5)]
        out[n, 2] = xyz[n, 2]


@njit(cache=True, nogil=True)
def _move_all(affine, planes, grid, nx, ny, cell, lists, xyz, out):  # type: ignore[no-untyped-def]  # pragma: no cover
    rows = np.empty(min(len(xyz), _CHUNK), np.int64)
    for start in range(0, len(xyz), _CHUNK):
        part = xyz[start : start + _CHUNK]
        _locate(planes, grid, nx, ny, cell, lists, part, rows)
        _move(affine, rows, part, out[start : start + _CHUNK])
