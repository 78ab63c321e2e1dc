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
Range = tuple[float, float]

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
    return Poses(*_at(at_ns, stamp_ns, poses.xyz_m, poses.quaternion))


PLACED, WITHOUT_POSITION, OUT_OF_RANGE, WITHOUT_POSE = 0, 1, 2, 3
"""What became of a point."""


def place_points(
    xyz_m: Floats, at_ns: Ints, stamp_ns: Ints, poses: Poses, usable: Bools, mount: Poses, range_m: Range
) -> tuple[Floats, NDArray[np.uint8]]:
    """Points seen by a sensor on a moving body, each at its own time, in the frame of the poses.

    xyz_m : (n, 3) in the sensor; at_ns : (n,) when each was seen
    stamp_ns : (m,) strictly ascending; usable : (m,) whether the stretch up to the next pose may be used
    mount : (1,) pose of the sensor in the body; range_m : nearest and furthest distance from the sensor

    Returns (n, 3) metres, NaN where a point is not placed, and (n,) what became of it.
    """
    out, state = np.empty((len(xyz_m), 3)), np.empty(len(xyz_m), np.uint8)
    _place(
        xyz_m, at_ns, stamp_ns, poses.xyz_m, poses.quaternion, usable, mount.xyz_m[0], mount.quaternion[0],
        range_m, out, state,
    )  # fmt: skip
    return out, state


@njit(cache=True, nogil=True)
def _stretch(t, stamp_ns, i):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The last stamp not after t, looked for at i first; -1 outside of all."""
    last = len(stamp_ns) - 1
    if last < 0 or t < stamp_ns[0] or t > stamp_ns[last]:
        return -1
    if stamp_ns[i] <= t and (i == last or t < stamp_ns[i + 1]):
        return i
    return np.searchsorted(stamp_ns, t, side="right") - 1


@njit(cache=True, nogil=True)
def _pose_in(t, i, stamp_ns, place, turn, xyz, q):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The pose at t, between the i-th and the next, into xyz and q."""
    j = min(i + 1, len(stamp_ns) - 1)
    share = 0.0 if t == stamp_ns[i] else (t - stamp_ns[i]) / (stamp_ns[j] - stamp_ns[i])
    cos = 0.0
    for a in range(4):
        cos += turn[i, a] * turn[j, a]
    sign = 1.0 if cos >= 0.0 else -1.0
    cos = min(abs(cos), 1.0)
    w0, w1 = 1.0 - share, share
    if cos <= _NEARLY_EQUAL:
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
        xyz[a] = place[i, a] + share * (place[j, a] - place[i, a])


@njit(cache=True, nogil=True)
def _turned(q, x, y, z):  # type: ignore[no-untyped-def]  # pragma: no cover
    u, v, w = 2.0 * (q[1] * z - q[2] * y), 2.0 * (q[2] * x - q[0] * z), 2.0 * (q[0] * y - q[1] * x)
    return (
        x + q[3] * u + q[1] * w - q[2] * v,
        y + q[3] * v + q[2] * u - q[0] * w,
        z + q[3] * w + q[0] * v - q[1] * u,
    )


@njit(cache=True, nogil=True)
def _at(at_ns, stamp_ns, place, turn):  # type: ignore[no-untyped-def]  # pragma: no cover
    xyz, quaternion = np.full((len(at_ns), 3), np.nan), np.full((len(at_ns), 4), np.nan)
    i = 0
    for k in range(len(at_ns)):
        found = _stretch(at_ns[k], stamp_ns, i)
        if found >= 0:
            i = found
            _pose_in(at_ns[k], i, stamp_ns, place, turn, xyz[k], quaternion[k])
    return xyz, quaternion


@njit(cache=True, nogil=True)
def _place(  # type: ignore[no-untyped-def]  # pragma: no cover
    points, at_ns, stamp_ns, place, turn, usable, arm, mount, range_m, out, state
):
    near2, far2 = range_m[0] ** 2, range_m[1] ** 2
    at, q = np.empty(3), np.empty(4)
    i, known = 0, -1
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        away2 = x * x + y * y + z * z
        out[k] = np.nan
        if not np.isfinite(away2):
            state[k] = WITHOUT_POSITION
            continue
        if away2 < near2 or away2 > far2:
            state[k] = OUT_OF_RANGE
            continue
        t = at_ns[k]
        found = _stretch(t, stamp_ns, i)
        if found < 0 or (t != stamp_ns[found] and not usable[found]):
            state[k] = WITHOUT_POSE
            continue
        if known < 0 or t != at_ns[known]:  # points of one time share their pose
            _pose_in(t, found, stamp_ns, place, turn, at, q)
        i, known = found, k
        x, y, z = _turned(mount, x, y, z)
        x, y, z = _turned(q, x + arm[0], y + arm[1], z + arm[2])
        out[k, 0], out[k, 1], out[k, 2] = at[0] + x, at[1] + y, at[2] + z
        state[k] = PLACED
