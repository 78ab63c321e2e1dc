"""A smooth deformation made of many local motions: every place follows the poses near it.

The deformation is sampled on a lattice that is fixed in the plane and interpolated bilinearly, so moving a
point costs no more than a look-up. A lattice node blends the motions of all poses around it with a kernel
that has an end, and which grows with the distance from the nearest pose: near the track it is as wide as
asked, far away it takes in ever more poses and turns into a smooth mean, without a jump anywhere. A node
depends on no pose beyond the kernel's end: parts of the deformation can be named by the poses they see.

What rises above the road leans as the poses do, so the shift is linear in the height over that of the poses around.
Where passes cross at different heights, on a bridge and under it, heights go by a line through what either says.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SPACING_M, CELL_BITS = 2.0, 4
CELLS = 1 << CELL_BITS
"""Lattice spacing, and cells along the edge of a block of it that is computed at once: about the edge of a tile."""

BLOCK_M = SPACING_M * CELLS

MOST_PAGES, MOST_CELLS = 1 << 13, 1 << 22
"""Blocks held at a time (150 MB), and places for them in a table."""

REACH_PER_SIGMA = 8.0**0.5
"""(1 - x^2)^4 over this many sigmas is a Gaussian with an end."""

REACH_GROWTH = 1.5
"""How much the kernel's reach grows per metre of distance from the nearest pose."""

FARTHEST_M = 1e8
"""Nothing on Earth lies further from its map's origin; such places become NaN."""


CHANNELS = 7
"""Of a shift that depends on height."""

DECK_M, NEAR_M, MOST_LEAN = 2.0, 20.0, 0.2
"""Heights of passes whose standard deviation exceeds the first are decks of their own, no nearer than the second to
where poses are; the shift changes by no more than the last per metre of height between them."""


class Motions(NamedTuple):
    """Local motions: near a pose a point goes where that goes, turned and scaled by the pose's correction.

    source_xy, target_xy : (n, 2); turn, stretch : (n,) in the plane
    source_z, lift : (n,); tilt : (n, 2) slope added along source x and y; stretch_up : (n,) of heights
    sigma, sigma_turn, sigma_up, sigma_tilt : (n,) standard deviations: of the place per axis, and so on
    sigma_m : width of the blend near the poses
    """

    source_xy: Floats
    target_xy: Floats
    turn: Floats
    stretch: Floats
    source_z: Floats
    lift: Floats
    tilt: Floats
    stretch_up: Floats
    sigma: Floats
    sigma_turn: Floats
    sigma_up: Floats
    sigma_tilt: Floats
    sigma_m: float


class Page(NamedTuple):
    """The lattice nodes of a block, its far edges included.

    shift : (CELLS + 1, CELLS + 1, 7) east, north and up at height 0, how they change per metre of height, and the
    height of the poses around
    sigma, sigma_up : (CELLS + 1, CELLS + 1) standard deviation per axis in the plane, and of height
    """

    shift: Floats
    sigma: Floats
    sigma_up: Floats


def reach_m(motions: Motions, nearest_m: Floats | float) -> Floats | float:
    """How far the kernel reaches at a place whose nearest pose is this far away."""
    return REACH_PER_SIGMA * motions.sigma_m + REACH_GROWTH * nearest_m


def seen_from(motions: Motions, tree: cKDTree, low: Floats, high: Floats) -> Ints:
    """Rows of all poses that a lattice node inside the box may depend on, ascending.

    tree : of the poses' source_xy
    """
    centre, half = (low + high) / 2, float(np.hypot(*(high - low))) / 2
    nearest = float(tree.query(centre)[0])
    reach = half + float(reach_m(motions, nearest + half)) + 1e-6
    return np.sort(np.array(tree.query_ball_point(centre, reach), dtype=np.int64))


def block(motions: Motions, tree: cKDTree, i: int, j: int) -> Page:
    """The lattice of the block whose lower left corner is i, j blocks out.

    The variance at a place is the mean of what its motions predict there, their turn's at the distance it is
    from each, and how far they are from agreeing: it grows away from the poses and where passes contradict.
    """
    low = np.array([i, j]) * BLOCK_M
    rows = seen_from(motions, tree, low, low + BLOCK_M)
    linear = motions.stretch[rows, None] * np.column_stack(
        [np.cos(motions.turn[rows]), np.sin(motions.turn[rows])]
    )
    size = (CELLS + 1, CELLS + 1)
    page = Page(np.empty((*size, CHANNELS)), np.empty(size), np.empty(size))
    variance = np.column_stack([c[rows] for c in motions[-5:-1]]) ** 2
    height = np.column_stack(
        [motions.source_z[rows], motions.lift[rows], motions.tilt[rows], motions.stretch_up[rows] - 1.0]
    )
    _block(
        i * CELLS, j * CELLS, motions.source_xy[rows], motions.target_xy[rows], linear, height,
        variance, float(reach_m(motions, 0.0)), *page,
    )  # fmt: skip
    return page


@njit(cache=True, nogil=True)
def _block(i0, j0, source, target, linear, height, variance, reach0, shift, sigma, sigma_up):  # type: ignore[no-untyped-def]  # pragma: no cover
    square = np.empty(len(source))
    # east, north, up: what a pose says at its own height, and per metre above it
    said, lean = np.empty(3), np.empty(3)
    mean, leans, skew, apart = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for a in range(shift.shape[0]):
        for b in range(shift.shape[1]):
            x, y = (i0 + a) * SPACING_M, (j0 + b) * SPACING_M
            nearest = np.inf
            for k in range(len(source)):
                dx, dy = x - source[k, 0], y - source[k, 1]
                square[k] = dx * dx + dy * dy
                nearest = min(nearest, square[k])
            reach = reach0 + REACH_GROWTH * np.sqrt(nearest)
            total, z_mean, z_spread, up_along_z, spread, spread_up = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            mean[:], leans[:], skew[:], apart[:] = 0.0, 0.0, 0.0, 0.0
            for k in range(len(source)):
                w = 1.0 - square[k] / (reach * reach)
                if w > 0.0:
                    w = w * w * w * w
                    dx, dy = x - source[k, 0], y - source[k, 1]
                    c, s = linear[k, 0], linear[k, 1]
                    tx, ty = height[k, 2], height[k, 3]
                    said[0] = target[k, 0] + c * dx - s * dy - x
                    said[1] = target[k, 1] + s * dx + c * dy - y
                    said[2] = height[k, 1] + tx * dx + ty * dy
                    lean[0], lean[1], lean[2] = s * ty - c * tx, -s * tx - c * ty, height[k, 4]
                    total += w
                    # West (1979): spreads about means that move, without cancellation
                    part, off_z = w / total, height[k, 0] - z_mean
                    z_mean += off_z * part
                    z_spread += w * off_z * (height[k, 0] - z_mean)
                    up_along_z += w * (said[2] - mean[2]) * (height[k, 0] - z_mean)
                    for axis in range(3):
                        off = said[axis] - mean[axis]
                        mean[axis] += off * part
                        apart[axis] += w * off * (said[axis] - mean[axis])
                        leans[axis] += (lean[axis] - leans[axis]) * part
                        skew[axis] += w * (lean[axis] - leans[axis]) * off_z
                    spread += w * (variance[k, 0] + variance[k, 1] * square[k] / 2.0)
                    spread_up += w * (variance[k, 2] + variance[k, 3] * square[k] / 2.0)
            for axis in range(3):
                # poses lean about their own heights, not about the mean of all
                shift[a, b, axis] = mean[axis] - skew[axis] / total - leans[axis] * z_mean
                shift[a, b, 3 + axis] = leans[axis]
            shift[a, b, 6] = z_mean
            decks = (z_spread / total / DECK_M**2) ** 4
            decks = decks / (1.0 + decks) / (1.0 + (nearest / NEAR_M**2) ** 4)
            if decks > 0.0:
                slope = up_along_z / z_spread
                share = decks * min(1.0, MOST_LEAN / max(abs(slope), MOST_LEAN))
                shift[a, b, 5] += share * (slope - leans[2])
                shift[a, b, 2] += share * (skew[2] / total - (slope - leans[2]) * z_mean)
            sigma[a, b] = np.sqrt((spread + (apart[0] + apart[1]) / 2.0) / total)
            sigma_up[a, b] = np.sqrt((spread_up + (1.0 - decks) * apart[2]) / total)


class Atlas(NamedTuple):
    """Pages for many points.

    pages : (p, CELLS + 1, CELLS + 1, CHANNELS) or (p, CELLS + 1, CELLS + 1), contiguous
    corner : (2,) int64, the first block
    table : (ni, nj) int32, page of every block from there on, or -1
    """

    pages: Floats
    corner: Ints
    table: NDArray[np.int32]


def parts_of(blocks: Ints) -> Iterator[Ints]:
    """The blocks (b, 2) in parts that are few enough and near enough to each other for one atlas."""
    waiting = [blocks] if len(blocks) else []
    while waiting:
        part = waiting.pop()
        size = np.ptp(part, axis=0) + 1
        if len(part) <= MOST_PAGES and int(size[0]) * int(size[1]) <= MOST_CELLS:
            yield part
            continue
        part = part[part[:, int(size.argmax())].argsort(kind="stable")]
        waiting += [part[: len(part) // 2], part[len(part) // 2 :]]


def atlas(pages: list[Floats], blocks: Ints) -> Atlas:
    """Pages laid out by their blocks (b, 2)."""
    corner = blocks.min(axis=0)
    table = np.full(blocks.max(axis=0) - corner + 1, -1, np.int32)
    table[tuple((blocks - corner).T)] = np.arange(len(blocks))
    return Atlas(np.stack(pages), corner, table)


def move(by: Atlas, xyz: Floats, out: Floats) -> None:
    """(n, 3) points moved by pages of shifts; NaN where no page is. A height of NaN counts as the poses'."""
    corner = by.corner * float(CELLS)
    _move(by.pages.ravel(), corner[0], corner[1], by.table, xyz, out)


def sample(by: Atlas, xyz: Floats, out: Floats) -> None:
    """(n,) values of pages of one channel at (n, 3) points; NaN where no page is."""
    corner = by.corner * float(CELLS)
    _sample(by.pages.ravel(), corner[0], corner[1], by.table, xyz, out)


@njit(cache=True, nogil=True, inline="always")
def _cell(i0, j0, table, x, y):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Number of the lattice node below and left of a place, counted through all pages, and the way from it."""
    # in numbers that do not depend on where the atlas begins: they may round differently
    left, below = np.floor(x / SPACING_M), np.floor(y / SPACING_M)
    u, v = left - i0, below - j0
    page = -1
    s, t, a, b = 0.0, 0.0, np.uint64(0), np.uint64(0)
    if u >= 0.0 and v >= 0.0 and u < table.shape[0] * CELLS and v < table.shape[1] * CELLS:
        # unsigned numbers spare the check for negative indices
        ci, cj = np.uint32(u), np.uint32(v)
        page = table[np.uint64(ci >> np.uint32(CELL_BITS)), np.uint64(cj >> np.uint32(CELL_BITS))]
        a, b = np.uint64(ci & np.uint32(CELLS - 1)), np.uint64(cj & np.uint32(CELLS - 1))
        s, t = x / SPACING_M - left, y / SPACING_M - below
    node = (np.uint64(max(page, 0)) * np.uint64(CELLS + 1) + a) * np.uint64(CELLS + 1) + b
    return page >= 0, node, s, t


@njit(cache=True, nogil=True, fastmath={"contract"})
def _move(flat, i0, j0, table, xyz, out):  # type: ignore[no-untyped-def]  # pragma: no cover
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    four, five, six = np.uint64(4), np.uint64(5), np.uint64(6)
    right, up = np.uint64(CHANNELS * (CELLS + 1)), np.uint64(CHANNELS)
    for n in range(len(xyz)):
        x, y, z = xyz[n, 0], xyz[n, 1], xyz[n, 2]
        known, node, s, t = _cell(i0, j0, table, x, y)
        if not known:
            out[n, 0], out[n, 1], out[n, 2] = np.nan, np.nan, np.nan
            continue
        w11 = s * t
        w10, w01 = s - w11, t - w11
        w00 = 1.0 - s - w01
        k = np.uint64(CHANNELS) * node
        p, q, r = k + right, k + right + up, k + up
        if np.isnan(z):
            z = w00 * flat[k + six] + w01 * flat[r + six] + w10 * flat[p + six] + w11 * flat[q + six]
        v00, v01, v10, v11 = w00 * z, w01 * z, w10 * z, w11 * z
        out[n, 0] = x + (
            (w00 * flat[k] + w01 * flat[r] + w10 * flat[p] + w11 * flat[q])
            + (v00 * flat[k + three] + v01 * flat[r + three] + v10 * flat[p + three] + v11 * flat[q + three])
        )
        out[n, 1] = y + (
            (w00 * flat[k + one] + w01 * flat[r + one] + w10 * flat[p + one] + w11 * flat[q + one])
            + (v00 * flat[k + four] + v01 * flat[r + four] + v10 * flat[p + four] + v11 * flat[q + four])
        )
        out[n, 2] = xyz[n, 2] + (
            (w00 * flat[k + two] + w01 * flat[r + two] + w10 * flat[p + two] + w11 * flat[q + two])
            + (v00 * flat[k + five] + v01 * flat[r + five] + v10 * flat[p + five] + v11 * flat[q + five])
        )


@njit(cache=True, nogil=True)
def _sample(flat, i0, j0, table, xyz, out):  # type: ignore[no-untyped-def]  # pragma: no cover
    one, right = np.uint64(1), np.uint64(CELLS + 1)
    for n in range(len(xyz)):
        known, k, s, t = _cell(i0, j0, table, xyz[n, 0], xyz[n, 1])
        if known:
            below = (1.0 - t) * flat[k] + t * flat[k + one]
            above = (1.0 - t) * flat[k + right] + t * flat[k + right + one]
            out[n] = (1.0 - s) * below + s * above
        else:
            out[n] = np.nan


def blocks_of(xyz: Floats) -> Ints:
    """(b, 2) the blocks that hold points, in order."""
    low, high = np.array(_corners(xyz)).reshape(2, 2)
    if not (np.abs([low, high]) < FARTHEST_M).all():
        xyz = xyz[(np.abs(xyz[:, :2]) < FARTHEST_M).all(axis=1)]
        if not len(xyz):
            return np.empty((0, 2), np.int64)
        low, high = np.array(_corners(xyz)).reshape(2, 2)
    first = np.floor(low / BLOCK_M)
    wide, tall = (np.floor(high / BLOCK_M) - first + 1).astype(np.int64).tolist()
    if wide * tall > MOST_CELLS:
        return np.unique(np.floor(xyz[:, :2] / BLOCK_M).astype(np.int64), axis=0)
    present = np.zeros((wide, tall), np.bool_)
    _mark(xyz, first[0], first[1], present)
    blocks: Ints = np.argwhere(present) + first.astype(np.int64)
    return blocks


@njit(cache=True, nogil=True)
def _corners(xyz):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Smallest x, y and largest x, y, NaN left out."""
    left, below, right, above = np.inf, np.inf, -np.inf, -np.inf
    for n in range(len(xyz)):
        x, y = xyz[n, 0], xyz[n, 1]
        left, right = x if x < left else left, x if x > right else right
        below, above = y if y < below else below, y if y > above else above
    return left, below, right, above


@njit(cache=True, nogil=True)
def _mark(xyz, i0, j0, present):  # type: ignore[no-untyped-def]  # pragma: no cover
    for n in range(len(xyz)):
        u, v = np.floor(xyz[n, 0] / BLOCK_M) - i0, np.floor(xyz[n, 1] / BLOCK_M) - j0
        if u >= 0.0 and v >= 0.0 and u < present.shape[0] and v < present.shape[1]:
            present[np.uint64(np.uint32(u)), np.uint64(np.uint32(v))] = True
