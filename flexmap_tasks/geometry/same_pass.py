"""Which place of a driven line a pose belongs to, where roads are driven more than once."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def headings_rad(points: Floats, along_m: Floats, reach_m: float) -> Floats:
    """(n,) direction of a line at its vertices, from `reach_m` before to `reach_m` after each.

    points : (n, 2); along_m : (n,) ascending
    """
    ends = [
        np.column_stack([np.interp(along_m + shift, along_m, column) for column in points.T])
        for shift in (-reach_m, reach_m)
    ]
    run = ends[1] - ends[0]
    heading: Floats = np.arctan2(run[:, 1], run[:, 0])
    return heading


def nearest_on_same_pass(
    poses: tuple[Floats, Floats, Floats],
    line: tuple[Floats, Floats, Floats],
    usable: Bools,
    reach_m: float,
    window_m: float,
    turn_rad: float,
) -> tuple[Floats, Ints]:
    """Distance to the nearest usable segment of the same pass, NaN and -1 where there is none in reach.

    poses, line : (xy (n, 2), metres along, heading) of poses and of vertices; usable : (m - 1,) segments
    A segment is of the same pass when its place along the line is within `window_m` of the pose's and the
    headings differ by at most `turn_rad`.
    """
    xy, along, heading = poses
    line_xy, line_along, line_heading = line
    rows = np.flatnonzero(usable)
    distance, segment = np.full(len(xy), np.nan), np.full(len(xy), -1, dtype=np.int64)
    if not len(rows) or not len(xy):
        return distance, segment
    pieces = shapely.linestrings(np.round(np.stack([line_xy[rows], line_xy[rows + 1]], axis=1), 9))
    points = shapely.points(xy)
    pose, piece = shapely.STRtree(pieces).query(points, predicate="dwithin", distance=reach_m)
    near = np.abs(line_along[rows[piece]] - along[pose]) <= window_m
    near &= np.cos(line_heading[rows[piece]] - heading[pose]) >= np.cos(turn_rad)
    pose, piece = pose[near], piece[near]
    gap = shapely.distance(points[pose], pieces[piece])
    order = np.lexsort((piece, gap, pose))
    first = order[np.flatnonzero(np.diff(pose[order], prepend=-1))]
    distance[pose[first]], segment[pose[first]] = gap[first], rows[piece[first]]
    return distance, segment
