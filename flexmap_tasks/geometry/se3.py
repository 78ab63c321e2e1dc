"""Poses in space: x, y, z and a quaternion x, y, z, w of unit length.

Between two poses of a track the place goes straight and the turn goes the shortest way at constant speed
(Shoemake 1985, slerp).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_NEARLY_EQUAL = 1.0 - 1e-9
"""Cosine of half the angle from which on slerp and a straight blend are the same."""


class Poses(NamedTuple):
    """Poses of one frame in another.

    xyz_m : (n, 3); quaternion : (n, 4) x y z w
    """

    xyz_m: Floats
    quaternion: Floats


def product(first: Floats, second: Floats) -> Floats:
    """(n, 4) the turn `second`, then `first`."""
    x1, y1, z1, w1 = first.T
    x2, y2, z2, w2 = second.T
    return np.column_stack(
        [
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        ]
    )


def turned(quaternion: Floats, xyz_m: Floats) -> Floats:
    """(n, 3) vectors turned by (n, 4) quaternions."""
    axis, w = quaternion[:, :3], quaternion[:, 3:]
    twice = 2.0 * np.cross(axis, xyz_m)
    out: Floats = xyz_m + w * twice + np.cross(axis, twice)
    return out


def compose(first: Poses, second: Poses) -> Poses:
    """Poses of C in A from those of B in A (first) and of C in B (second)."""
    place = first.xyz_m + turned(first.quaternion, second.xyz_m)
    return Poses(place, product(first.quaternion, second.quaternion))


def inverse(poses: Poses) -> Poses:
    """Poses of A in B from those of B in A."""
    back = poses.quaternion * [-1.0, -1.0, -1.0, 1.0]
    return Poses(-turned(back, poses.xyz_m), back)


def interpolate(at_ns: Ints, stamp_ns: Ints, poses: Poses) -> Poses:
    """Poses at the given times; NaN before the first and after the last stamp.

    stamp_ns : (m,) strictly ascending
    """
    nothing = np.empty((0, 3))
    return Poses(
        *_at(at_ns, stamp_ns, poses.xyz_m, poses.quaternion, np.ones(len(stamp_ns), np.bool_), nothing)
    )


def place_points(xyz_m: Floats, at_ns: Ints, stamp_ns: Ints, poses: Poses, usable: Bools) -> Floats:
    """(n, 3) points of a moving body, each seen at its own time, in the frame of the poses.

    xyz_m : (n, 3) in the body; at_ns : (n,) when each was seen
    stamp_ns : (m,) strictly ascending; usable : (m,) whether the stretch up to the next pose may be used
    NaN where no usable stretch covers the time.
    """
    placed: Floats = _at(at_ns, stamp_ns, poses.xyz_m, poses.quaternion, usable, xyz_m)[0]
    return placed


@njit(cache=True, nogil=True)
def _at(at_ns, stamp_ns, place, turn, usable, points):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Poses at times; with points, the points moved by them instead of the places."""
    n, last = len(at_ns), len(stamp_ns) - 1
    xyz, quaternion = np.full((n, 3), np.nan), np.full((n, 4), np.nan)
    q = np.empty(4)
    i = 0
    for k in range(n):
        t = at_ns[k]
        if last < 0 or t < stamp_ns[0] or t > stamp_ns[last]:
            continue
        if not (stamp_ns[i] <= t and (i == last or t < stamp_ns[i + 1])):
            i = np.searchsorted(stamp_ns, t, side="right") - 1
        j = min(i + 1, last)
        share = 0.0 if t == stamp_ns[i] else (t - stamp_ns[i]) / (stamp_ns[j] - stamp_ns[i])
        if share > 0.0 and not usable[i]:
            continue
        cos = 0.0
        for a in range(4):
            cos += turn[i, a] * turn[j, a]
        sign = 1.0 if cos >= 0.0 else -1.0
        cos = min(abs(cos), 1.0)
        if cos > _NEARLY_EQUAL:
            w0, w1 = 1.0 - share, share
        else:
            angle = np.arccos(cos)
            w0, w1 = np.sin((1.0 - share) * angle) / np.sin(angle), np.sin(share * angle) / np.sin(angle)
        norm = 0.0
        for a in range(4):
            q[a] = w0 * turn[i, a] + sign * w1 * turn[j, a]
            norm += q[a] * q[a]
        norm = np.sqrt(norm)
        for a in range(4):
            q[a] /= norm
        for a in range(3):
            xyz[k, a] = place[i, a] + share * (place[j, a] - place[i, a])
        if len(points) == 0:
            quaternion[k] = q
            continue
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        u = 2.0 * (q[1] * z - q[2] * y)
        v = 2.0 * (q[2] * x - q[0] * z)
        w = 2.0 * (q[0] * y - q[1] * x)
        xyz[k, 0] += x + q[3] * u + q[1] * w - q[2] * v
        xyz[k, 1] += y + q[3] * v + q[2] * u - q[0] * w
        xyz[k, 2] += z + q[3] * w + q[0] * v - q[1] * u
    return xyz, quaternion
