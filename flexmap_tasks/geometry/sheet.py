"""Piecewise affine maps of the plane over a triangle mesh, for many points.

A point belongs to the first triangle, in the order given, that holds it within `EDGE_TOLERANCE_M`. The grid
(`sheet_grid`) only makes finding it fast: the answer depends neither on its resolution nor on triangles
further away.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from flexmap_tasks.geometry.sheet_grid import MARGIN_M, Grid, build_grid

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

EDGE_TOLERANCE_M = 1e-7
"""A point this far outside of a triangle still belongs to it: rounding must not open gaps at edges."""

_POINTS_PER_CELL = 16
"""The grid is no finer than that many points repay."""


class Mesh(NamedTuple):
    """A triangle mesh prepared for many points.

    halfplanes : (t, 3, 3) float64; a x + b y + c is the signed distance to an edge in metres, inside positive
    boxes : (t, 4) float64, x, y, x, y around every triangle
    affine : (t + 1, 2, 3) float64, the map of every triangle, and last the one outside of all
    grid : where to look for the triangle of a point
    """

    halfplanes: Floats
    boxes: Floats
    affine: Floats
    grid: Grid


def build_mesh(source: Floats, target: Floats, triangles: Ints, outside: Floats, points: int) -> Mesh:
    """Prepare the map that takes the `source` vertices to the `target` ones.

    source, target : (v, 2) float64, metres
    triangles : (t, 3) int64, counter-clockwise in the source
    outside : (2, 3) float64, the affine map of everything outside the mesh
    points : how many points are to be moved; the grid is no finer than they repay
    """
    affine = np.concatenate([affine_maps(source[triangles], target[triangles]), outside[None]])
    corners = source[triangles]
    halfplanes = _halfplanes(corners)
    boxes = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
    cells = float(np.clip(points / _POINTS_PER_CELL, 256, 1 << 18))
    return Mesh(halfplanes, boxes, affine, build_grid(boxes, halfplanes, triangles, cells))


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
    if len(mesh.halfplanes):
        _run(mesh, np.ascontiguousarray(xyz_m), out, np.empty(0, np.int64))
    else:
        _move_alike(mesh.affine.ravel(), np.ascontiguousarray(xyz_m), out)
    return out


def locate(mesh: Mesh, xyz_m: Floats) -> Ints:
    """(n,) the triangle every point belongs to; the number of triangles where it is outside of all."""
    found = np.empty(len(xyz_m), np.int64)
    _run(mesh, np.ascontiguousarray(xyz_m), np.empty((len(xyz_m), 3)), found)
    return found


def _run(mesh: Mesh, xyz_m: Floats, out: Floats, found: Ints) -> None:
    grid = mesh.grid
    _move(
        mesh.affine.ravel(), mesh.halfplanes, grid.frame, *grid.shape, grid.cell, grid.lists, grid.line.ravel(),
        grid.pick.ravel(), xyz_m, out, found,
    )  # fmt: skip


def touching(mesh: Mesh, low: Floats, high: Floats) -> NDArray[np.bool_]:
    """(t,) which triangles touch the box between two corners, with a small margin (separating axes)."""
    margin, boxes, planes = 2 * MARGIN_M, mesh.boxes, mesh.halfplanes
    apart = (boxes[:, 2:] < low - margin) | (boxes[:, :2] > high + margin)
    centre, half = (low + high) / 2, (high - low) / 2
    distance = planes[..., :2] @ centre + planes[..., 2]
    reach = np.abs(planes[..., :2]) @ half
    parted = distance < -(reach + margin)
    return ~np.asarray(apart.any(axis=1) | parted.any(axis=1))


def _halfplanes(corners: Floats) -> Floats:
    start, end = corners, np.roll(corners, -1, axis=1)
    edge = end - start
    length = np.hypot(edge[..., 0], edge[..., 1])
    normal = np.stack([-edge[..., 1], edge[..., 0]], axis=-1) / length[..., None]
    return np.concatenate([normal, -(normal * start).sum(axis=-1, keepdims=True)], axis=-1)


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
def _move(affine, planes, frame, nx, ny, cell, lists, line, pick, xyz, out, found):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Apply the affine map of its triangle, flat runs of six, to every point; `found`, unless empty, names it.

    One loop: a function that is called per point, even in line, counts references to its arrays per point.
    """
    x0, y0, per_x, per_y = frame[0], frame[1], frame[2], frame[3]
    wide, high, none, names = float(nx), float(ny), np.int64(len(planes)), len(found) > 0
    for n in range(len(xyz)):
        x, y = xyz[n, 0], xyz[n, 1]
        u, v = (x - x0) * per_x, (y - y0) * per_y
        ask = none
        if u >= 0.0 and v >= 0.0 and u < wide and v < high:
            # unsigned numbers spare the check for negative indices
            ask = np.int64(cell[np.uint64(np.uint32(v)) * np.uint64(nx) + np.uint64(np.uint32(u))])
        if ask >= 0:
            k = np.uint64(3) * np.uint64(ask)
            beyond = line[k] * x + line[k + np.uint64(1)] * y + line[k + np.uint64(2)] < -EDGE_TOLERANCE_M
            t = np.int64(pick[np.uint64(2) * np.uint64(ask) + np.uint64(beyond)])
        else:
            start = -1 - ask
            t = _find(planes, start + 1, start + 1 + lists[start], lists, x, y)
            t = t if t >= 0 else none
        if names:
            found[n] = t
        k = np.uint64(6) * np.uint64(t)
        out[n, 0] = affine[k] * x + affine[k + np.uint64(1)] * y + affine[k + np.uint64(2)]
        out[n, 1] = affine[k + np.uint64(3)] * x + affine[k + np.uint64(4)] * y + affine[k + np.uint64(5)]
        out[n, 2] = xyz[n, 2]


@njit(cache=True, nogil=True)
def _move_alike(affine, xyz, out):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Apply one affine map to all points."""
    for n in range(len(xyz)):
        x, y = xyz[n, 0], xyz[n, 1]
        out[n, 0] = affine[0] * x + affine[1] * y + affine[2]
        out[n, 1] = affine[3] * x + affine[4] * y + affine[5]
        out[n, 2] = xyz[n, 2]
