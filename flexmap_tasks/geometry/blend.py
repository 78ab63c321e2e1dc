"""A smooth deformation made of many local motions: every place follows the poses near it.

The deformation is sampled on a lattice that is fixed in the plane and interpolated bilinearly, so moving a
point costs no more than a look-up. A lattice node blends the motions of all poses around it with a kernel
that has an end, and which grows with the distance from the nearest pose: near the track it is as wide as
asked, far away it takes in ever more poses and turns into a smooth mean, without a jump anywhere. A node
depends on no pose beyond the kernel's end: parts of the deformation can be named by the poses they see.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SPACING_M, CELL_BITS = 2.0, 6
CELLS = 1 << CELL_BITS
"""Lattice spacing, and cells along the edge of a block of it that is computed at once."""

BLOCK_M = SPACING_M * CELLS

REACH_PER_SIGMA = 8.0**0.5
"""(1 - x^2)^4 over this many sigmas is a Gaussian with an end."""

REACH_GROWTH = 1.5
"""How much the kernel's reach grows per metre of distance from the nearest pose."""

FARTHEST_M = 1e8
"""Nothing on Earth lies further from its map's origin; such places become NaN."""

CHANNELS = 4
"""Of a lattice node: shift east, shift north, lift, standard deviation."""


class Motions(NamedTuple):
    """Local motions: near source_xy a point p goes to target_xy + stretch * R(turn) @ (p - source_xy).

    source_xy, target_xy : (n, 2); turn, stretch, lift, sigma : (n,)
    sigma_m : width of the blend near the poses
    """

    source_xy: Floats
    target_xy: Floats
    turn: Floats
    stretch: Floats
    lift: Floats
    sigma: Floats
    sigma_m: float


def reach_m(motions: Motions, nearest_m: Floats | float) -> Floats | float:
    """How far the kernel reaches at a place whose nearest pose is this far away."""
    return REACH_PER_SIGMA * motions.sigma_m + REACH_GROWTH * nearest_m


def seen_from(motions: Motions, low: Floats, high: Floats) -> Ints:
    """Rows of all poses that a lattice node inside the box may depend on."""
    centre, half = (low + high) / 2, float(np.hypot(*(high - low))) / 2
    gap = np.hypot(*(motions.source_xy - centre).T)
    return np.flatnonzero(gap <= half + reach_m(motions, float(gap.min()) + half) + 1e-6)


def block(motions: Motions, i: int, j: int) -> Floats:
    """(CELLS + 1, CELLS + 1, CHANNELS) lattice nodes of the block whose lower left corner is i, j blocks out."""
    low = np.array([i, j]) * BLOCK_M
    rows = seen_from(motions, low, low + BLOCK_M)
    linear = motions.stretch[rows, None] * np.column_stack(
        [np.cos(motions.turn[rows]), np.sin(motions.turn[rows])]
    )
    out = np.empty((CELLS + 1, CELLS + 1, CHANNELS))
    _block(
        i * CELLS, j * CELLS, motions.source_xy[rows], motions.target_xy[rows], linear, motions.lift[rows],
        motions.sigma[rows], float(reach_m(motions, 0.0)), out,
    )  # fmt: skip
    return out


@njit(cache=True, nogil=True)
def _block(i0, j0, source, target, linear, lift, sigma, reach0, out):  # type: ignore[no-untyped-def]  # pragma: no cover
    square = np.empty(len(source))
    for a in range(out.shape[0]):
        for b in range(out.shape[1]):
            x, y = (i0 + a) * SPACING_M, (j0 + b) * SPACING_M
            nearest = np.inf
            for k in range(len(source)):
                dx, dy = x - source[k, 0], y - source[k, 1]
                square[k] = dx * dx + dy * dy
                nearest = min(nearest, square[k])
            reach = reach0 + REACH_GROWTH * np.sqrt(nearest)
            total, east, north, up, spread = 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(len(source)):
                w = 1.0 - square[k] / (reach * reach)
                if w > 0.0:
                    w = w * w * w * w
                    dx, dy = x - source[k, 0], y - source[k, 1]
                    c, s = linear[k, 0], linear[k, 1]
                    total += w
                    east += w * (target[k, 0] + c * dx - s * dy)
                    north += w * (target[k, 1] + s * dx + c * dy)
                    up += w * lift[k]
                    spread += w * sigma[k]
            out[a, b, 0] = east / total - x
            out[a, b, 1] = north / total - y
            out[a, b, 2] = up / total
            out[a, b, 3] = spread / total


@njit(cache=True, nogil=True)
def look_up(pages, table, i0, j0, xyz, out):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Move points by the lattice: out (n, 4) are x, y, z and the standard deviation; NaN where no block is.

    pages : (p, CELLS + 1, CELLS + 1, CHANNELS); table : (ni, nj) page of every block from block i0, j0 on, or -1
    """
    for n in range(len(xyz)):
        x, y = xyz[n, 0], xyz[n, 1]
        u, v = x / SPACING_M, y / SPACING_M
        fu, fv = np.floor(u), np.floor(v)
        page = -1
        if abs(x) < FARTHEST_M and abs(y) < FARTHEST_M:
            ci, cj = int(fu) - i0 * CELLS, int(fv) - j0 * CELLS
            bi, bj = ci >> CELL_BITS, cj >> CELL_BITS
            if bi >= 0 and bj >= 0 and bi < table.shape[0] and bj < table.shape[1]:
                page = table[bi, bj]
        if page < 0:
            out[n, 0], out[n, 1], out[n, 2], out[n, 3] = np.nan, np.nan, np.nan, np.nan
            continue
        a, b = ci - bi * CELLS, cj - bj * CELLS
        s, t = u - fu, v - fv
        w00, w10, w01, w11 = (1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t
        for c in range(CHANNELS):
            out[n, c] = (
                w00 * pages[page, a, b, c]
                + w10 * pages[page, a + 1, b, c]
                + w01 * pages[page, a, b + 1, c]
                + w11 * pages[page, a + 1, b + 1, c]
            )
        out[n, 0] += x
        out[n, 1] += y
        out[n, 2] += xyz[n, 2]


def blocks_of(xyz: Floats) -> Ints:
    """(b, 2) the blocks that hold points, in order."""
    low, high = _corners(xyz)
    if not low[0] <= high[0]:
        return np.empty((0, 2), np.int64)
    first = np.floor(low / BLOCK_M).astype(np.int64)
    size = np.floor(high / BLOCK_M).astype(np.int64) - first + 1
    if int(size[0]) * int(size[1]) > 1 << 22:
        known = xyz[(np.abs(xyz[:, :2]) < FARTHEST_M).all(axis=1), :2]
        return np.unique(np.floor(known / BLOCK_M).astype(np.int64), axis=0)
    present = np.zeros((size[0], size[1]), np.bool_)
    _mark(xyz, first[0], first[1], present)
    blocks: Ints = np.argwhere(present) + first
    return blocks


@njit(cache=True, nogil=True)
def _corners(xyz):  # type: ignore[no-untyped-def]  # pragma: no cover
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for n in range(len(xyz)):
        x, y = xyz[n, 0], xyz[n, 1]
        if abs(x) < FARTHEST_M and abs(y) < FARTHEST_M:
            low[0], low[1] = min(low[0], x), min(low[1], y)
            high[0], high[1] = max(high[0], x), max(high[1], y)
    return low, high


@njit(cache=True, nogil=True)
def _mark(xyz, i0, j0, present):  # type: ignore[no-untyped-def]  # pragma: no cover
    for n in range(len(xyz)):
        x, y = xyz[n, 0], xyz[n, 1]
        if abs(x) < FARTHEST_M and abs(y) < FARTHEST_M:
            present[int(np.floor(x / BLOCK_M)) - i0, int(np.floor(y / BLOCK_M)) - j0] = True
