"""Pieces of the SLAM track and of the GNSS line that look alike, whatever their places and directions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from flexmap_tasks.geometry.colinear import Seeds
from flexmap_tasks.model.arrays import Bools, Floats, Ints

SAMPLE_M = 5.0
"""Spacing of the samples, and so of the places that are tried."""

PIECES_M = (150.0, 300.0, 900.0)
"""Lengths of pieces: the short have a shape and little drift, the long are told apart in long drives."""

STEP_M = 50.0
"""A piece is looked up every so many metres."""

POINTS = 6
"""Points of a piece to either side of its middle."""

FRAME_SAMPLES = 4
"""Direction of a piece: that of its middle over so many samples to either side."""

ALIKE_M, ALIKE_SHARE = 2.0, 0.03
"""Pieces are alike when their points differ by this, and by this share of half their length: drift and scale."""

NEAREST, KEPT = 40, 6
"""Neighbours that are asked for in the space of shapes, and how many that are really apart are kept."""

PLAIN_WORTH = 0.02
"""What a straight piece is worth beside one whose shape stands out."""


class EvenTrack(NamedTuple):
    """A track at even spacing.

    along_m : (n,) arc length; xy : (n,) complex places; unseen_m : (n,) way before it that nobody saw
    """

    along_m: Floats
    xy: NDArray[np.complex128]
    unseen_m: Floats


def even_track(xy_m: Floats, along_m: Floats, seen: Bools | None = None) -> EvenTrack:
    """Samples every `SAMPLE_M`; seen : (n,) whether the step to each place was driven as drawn."""
    wanted = np.arange(0.0, along_m[-1], SAMPLE_M)
    x, y = (np.interp(wanted, along_m, column) for column in xy_m.T)
    step = np.diff(along_m, prepend=0.0)
    unseen = np.zeros(len(along_m)) if seen is None else np.cumsum(np.where(seen, 0.0, step))
    return EvenTrack(wanted, x + 1j * y, np.interp(wanted, along_m, unseen))


def seeds_between(slam: EvenTrack, gnss: EvenTrack, *, backwards: bool = False) -> Seeds:
    """All alike pieces, in the order of the SLAM track; backwards : pieces of SLAM driven the other way.

    Then arc lengths of SLAM count from its end.
    """
    if backwards:
        slam = EvenTrack(slam.along_m, slam.xy[::-1], slam.unseen_m)
    found = [_alike(slam, gnss, length) for length in _lengths(slam, gnss)]
    seeds = Seeds(*(np.concatenate(columns) for columns in zip(*found, strict=True)))
    return seeds.take(np.lexsort((seeds.second_m, seeds.first_m)))


def _lengths(slam: EvenTrack, gnss: EvenTrack) -> list[int]:
    """Half lengths of the pieces in samples; of tracks shorter than two of the shortest, half of the track."""
    shorter = min(len(slam.xy), len(gnss.xy))
    fit = [p for p in PIECES_M if 2 * p <= shorter * SAMPLE_M]
    return [int(p / 2 / SAMPLE_M) for p in fit] or [max(shorter // 4, 1)]


def _pieces(xy: NDArray[np.complex128], half: int, step: int) -> tuple[Ints, NDArray[np.complex128]]:
    """Middles of the pieces, and (n, k) their points."""
    middle = np.arange(half, len(xy) - half, step)
    offset = np.round(np.linspace(-half, half, 2 * POINTS + 1)).astype(np.int64)
    return middle, xy[middle[:, None] + offset]


def _shapes(xy: NDArray[np.complex128], middle: Ints, point: NDArray[np.complex128]) -> Floats:
    """(n, 2 k) the points as seen from the middle, looking ahead."""
    ahead = xy[np.minimum(middle + FRAME_SAMPLES, len(xy) - 1)] - xy[np.maximum(middle - FRAME_SAMPLES, 0)]
    seen = (point - point[:, [POINTS]]) * np.exp(-1j * np.angle(ahead))[:, None]
    seen = np.delete(seen, POINTS, axis=1)
    return np.ascontiguousarray(np.column_stack([seen.real, seen.imag]))


def _alike(slam: EvenTrack, gnss: EvenTrack, half: int) -> Seeds:
    step = max(min(int(STEP_M / SAMPLE_M), half // 2), 1)
    (i, a), (j, b) = _pieces(slam.xy, half, step), _pieces(gnss.xy, half, 1)
    count = min(NEAREST, len(j))
    near = cKDTree(_shapes(gnss.xy, j, b)).query(_shapes(slam.xy, i, a), count)[1].reshape(len(i), count)
    centre_a, centre_b = a.mean(axis=1), b.mean(axis=1)
    a, b = a - centre_a[:, None], b - centre_b[:, None]
    product = np.einsum("nk,nmk->nm", a.conj(), b[near])
    square_a, square_b = (np.abs(a) ** 2).sum(axis=1), (np.abs(b) ** 2).sum(axis=1)
    left = (square_a[:, None] + square_b[near] - 2 * np.abs(product)) / a.shape[1]
    tolerance = ALIKE_M + ALIKE_SHARE * half * SAMPLE_M
    row, which = np.nonzero(_separate(left, near, max(half // 2, 1), tolerance**2))
    first, second = i[row], j[near[row, which]]
    bent = np.maximum(square_a - _straight(a), 0.0) / a.shape[1]
    worth = np.maximum(bent / (bent + tolerance**2), PLAIN_WORTH)
    return Seeds(
        slam.along_m[first],
        gnss.along_m[second],
        gnss.unseen_m[second],
        centre_a[row],
        centre_b[near[row, which]],
        np.angle(product[row, which]),
        worth[row],
        np.full(len(row), step * SAMPLE_M),
    )


def _straight(point: NDArray[np.complex128]) -> Floats:
    """(n,) sum of squares of (n, k) centred points along the line that fits them best."""
    square, double = (np.abs(point) ** 2).sum(axis=1), np.abs((point**2).sum(axis=1))
    out: Floats = (square + double) / 2
    return out


@njit(cache=True, nogil=True)
def _separate(left, place, apart, limit):  # type: ignore[no-untyped-def]  # pragma: no cover
    """(n, m) which neighbours are kept: the best ones, none beside another."""
    kept = np.zeros(left.shape, np.bool_)
    for k in range(len(left)):
        count = 0
        for m in np.argsort(left[k]):
            if left[k, m] > limit or count == KEPT:
                break
            free = True
            for other in range(left.shape[1]):
                if kept[k, other] and abs(place[k, m] - place[k, other]) <= apart:
                    free = False
            if free:
                kept[k, m] = True
                count += 1
    return kept
