"""Triangulating the plane around control points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def twice_area(corners: Floats) -> Floats:
    """(t,) twice the signed area of triangles (t, 3, 2); positive when counter-clockwise."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area: Floats = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return area


def delaunay(points: Floats) -> Ints:
    """(t, 3) Delaunay triangles of (n, 2) points, counter-clockwise, in canonical order.

    The diagonal swaps of White and Griffin (1985) strive for the same triangulation, the one with the
    largest smallest angle, but stop early and depend on the order of insertion.
    """
    centred = points - points.mean(axis=0)
    triangles = Delaunay(centred).simplices.astype(np.int64)
    clockwise = twice_area(points[triangles]) < 0
    triangles[clockwise] = triangles[clockwise][:, [0, 2, 1]]
    return canonical(triangles)


def canonical(triangles: Ints) -> Ints:
    """The same triangles, each from its smallest vertex on, sorted."""
    first = triangles.argmin(axis=1)
    turned = np.take_along_axis(triangles, (first[:, None] + np.arange(3)) % 3, axis=1)
    return turned[np.lexsort(turned.T[::-1])]


def ring(inner: Ints, outer: Ints) -> Ints:
    """(2 k, 3) triangles between two nested convex outlines of k vertices each, both counter-clockwise."""
    next_inner, next_outer = np.roll(inner, -1), np.roll(outer, -1)
    return np.concatenate(
        [
            np.column_stack([outer, next_outer, inner]),
            np.column_stack([next_outer, next_inner, inner]),
        ]
    )
