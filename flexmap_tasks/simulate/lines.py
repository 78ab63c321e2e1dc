"""Small geometry of polylines, (n, 2) or (n, 3) metres."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.model.arrays import Floats


def along(xy: Floats) -> Floats:
    """(n,) arc length in the plane at every vertex."""
    step = np.hypot(*np.diff(xy[:, :2], axis=0).T)
    return np.concatenate([[0.0], np.cumsum(step)])


def at(xy: Floats, s: Floats) -> Floats:
    """Points at arc lengths `s`."""
    length = along(xy)
    return np.column_stack([np.interp(s, length, xy[:, k]) for k in range(xy.shape[1])])


def cut(xy: Floats, s_from: float, s_to: float, clear_m: float = 1e-6) -> Floats:
    """The part between two arc lengths; vertices nearer than `clear_m` to the new ends are left out."""
    length = along(xy)
    inner = length[(length > s_from + clear_m) & (length < s_to - clear_m)]
    return at(xy, np.concatenate([[s_from], inner, [s_to]]))


def resample(xy: Floats, spacing_m: float) -> Floats:
    """Evenly spaced points, ends kept, at most `spacing_m` apart."""
    total = along(xy)[-1]
    return at(xy, np.linspace(0.0, total, max(2, int(np.ceil(total / spacing_m - 1e-9)) + 1)))


def tangents(xy: Floats) -> Floats:
    """(n, 2) unit direction at every vertex, the mean of the two steps beside it."""
    step = np.diff(xy[:, :2], axis=0)
    step = step / np.maximum(np.hypot(*step.T), 1e-12)[:, None]
    both = np.concatenate([step[:1], step[:-1] + step[1:], step[-1:]])
    return np.asarray(both / np.maximum(np.hypot(*both.T), 1e-12)[:, None])


def shifted(xy: Floats, left_m: float | Floats) -> Floats:
    """The line moved to its left by `left_m`, corners mitred so that the width is kept."""
    step = np.diff(xy[:, :2], axis=0)
    step = step / np.maximum(np.hypot(*step.T), 1e-12)[:, None]
    tangent = tangents(xy)
    cosine = np.concatenate([[1.0], np.sum(tangent[1:-1] * step[1:], axis=1), [1.0]])
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]]) / np.maximum(cosine, 0.5)[:, None]
    out = xy.copy()
    out[:, :2] += normal * np.broadcast_to(np.asarray(left_m), (len(xy),))[:, None]
    return out


def bezier(
    start: Floats, start_way: Floats, end: Floats, end_way: Floats, spacing_m: float, n: int = 0
) -> Floats:
    """A cubic that leaves `start` along `start_way` and arrives at `end` along `end_way` (unit vectors).

    The handles are those of the circle with the same chord and turn. n : number of points, 0 by spacing.
    """
    chord = float(np.hypot(*(end - start)[:2]))
    turn = float(np.arccos(np.clip(start_way @ end_way, -1.0, 1.0)))
    handle = chord / 3 if turn < 0.02 else 2 / 3 * np.tan(turn / 4) * chord / np.sin(turn / 2)
    handle = min(handle, chord)
    if n == 0:
        n = max(3, int(np.ceil(chord * (1 + turn / 6) / spacing_m)) + 1)
    t = np.linspace(0.0, 1.0, n)[:, None]
    a, b = start[:2] + handle * start_way, end[:2] - handle * end_way
    curve = (1 - t) ** 3 * start[:2] + 3 * (1 - t) ** 2 * t * a + 3 * (1 - t) * t**2 * b + t**3 * end[:2]
    return np.asarray(curve)


def bowed(start: Floats, end: Floats, bow_m: float, spacing_m: float = 10.0) -> Floats:
    """A line from start to end that bows out to its left by `bow_m` in the middle (a parabola)."""
    chord = end - start
    length = float(np.hypot(*chord))
    t = np.linspace(0.0, 1.0, max(2, int(np.ceil(length / spacing_m)) + 1))[:, None]
    normal = np.array([-chord[1], chord[0]]) / max(length, 1e-9)
    return np.asarray(start + t * chord + 4 * bow_m * t * (1 - t) * normal)


def rounded(xy: Floats) -> Floats:
    """The line in steps of 4 m with its corners rounded over some 25 m; the ends stay."""
    fine = resample(xy, 4.0)
    padded = np.vstack([np.repeat(fine[:1], 6, axis=0), fine, np.repeat(fine[-1:], 6, axis=0)])
    kernel = np.hanning(15)[1:-1] / np.hanning(15)[1:-1].sum()
    smooth = np.column_stack([np.convolve(padded[:, k], kernel, mode="valid") for k in range(2)])
    smooth[0], smooth[-1] = fine[0], fine[-1]
    return smooth


def thinned(xy: Floats, tolerance_m: float) -> list[int]:
    """Vertices that Douglas and Peucker (1973) keep, the ends included."""
    if tolerance_m <= 0:
        return list(range(len(xy)))
    keep = {0, len(xy) - 1}
    stack = [(0, len(xy) - 1)]
    while stack:
        a, b = stack.pop()
        if b - a < 2:
            continue
        chord = xy[b] - xy[a]
        rest = xy[a + 1 : b] - xy[a]
        length = max(float(np.hypot(*chord)), 1e-9)
        share = np.clip(rest @ chord / length**2, 0.0, 1.0)
        off = np.hypot(*(rest - share[:, None] * chord).T)
        worst = int(np.argmax(off))
        if off[worst] > tolerance_m:
            keep.add(a + 1 + worst)
            stack += [(a, a + 1 + worst), (a + 1 + worst, b)]
    return sorted(keep)
