"""What became of the matched roads between two dates of OpenStreetMap."""

from __future__ import annotations

import numpy as np
import shapely

from flexmap_tasks.model.arrays import Floats, Ints, strings
from flexmap_tasks.model.conflation import Matches, RoadChanges
from flexmap_tasks.model.maps import PlacedRoads

MOVED_MIN_M = 0.05
"""OpenStreetMap writes places to about a centimetre."""

_Row = tuple[int, str, str, str, str, float, int, int, str]


def road_changes(
    before: PlacedRoads, after: PlacedRoads, matches_before: Matches, matches_after: Matches
) -> RoadChanges:
    """Changes of the ways that lanes were or are matched to, by way id, then kind and key.

    "new" is a way that lanes are matched to now and that did not exist; "gone" one that lanes were matched to
    and that exists no longer. Ways that exist at both dates are compared tag by tag and in their course.
    """
    used = np.union1d(matches_before.way_id, matches_after.way_id)
    used = used[used > 0]
    old, new = _rows(before, used), _rows(after, used)
    rows: list[_Row] = []
    for way, i, j in zip(used.tolist(), old.tolist(), new.tolist(), strict=True):
        version_old = int(before.network.version[i]) if i >= 0 else 0
        version_new, stamp = (
            (int(after.network.version[j]), str(after.network.timestamp[j])) if j >= 0 else (0, "")
        )
        versions = (version_old, version_new, stamp)
        if i < 0 or j < 0:
            rows.append((way, "new" if i < 0 else "gone", "", "", "", np.nan, *versions))
            continue
        moved = _moved_m(_course(before, i), _course(after, j))
        if moved > MOVED_MIN_M:
            rows.append((way, "geometry", "", "", "", moved, *versions))
        a, b = before.network.tags.of_element(i), after.network.tags.of_element(j)
        rows += [
            (way, "tag", key, a.get(key, ""), b.get(key, ""), np.nan, *versions)
            for key in sorted(a.keys() | b.keys())
            if a.get(key) != b.get(key)
        ]
    return _table(rows)


def _rows(roads: PlacedRoads, way_ids: Ints) -> Ints:
    """Row of every way, -1 where it does not exist."""
    order = np.argsort(roads.network.way_id, kind="stable")
    ids = roads.network.way_id[order]
    at = np.minimum(np.searchsorted(ids, way_ids), max(len(ids) - 1, 0))
    return np.where(ids[at] == way_ids, order[at], -1) if len(ids) else np.full(len(way_ids), -1)


def _course(roads: PlacedRoads, row: int) -> Floats:
    course: Floats = roads.xy_m[roads.network.offset[row] : roads.network.offset[row + 1]]
    return course


def _moved_m(a: Floats, b: Floats) -> float:
    """Greatest distance of either course from the other (Hausdorff)."""
    if len(a) < 2 or len(b) < 2 or (a.shape == b.shape and np.array_equal(a, b)):
        return 0.0
    return float(shapely.hausdorff_distance(shapely.linestrings(a), shapely.linestrings(b), densify=0.1))


def _table(rows: list[_Row]) -> RoadChanges:
    columns = list(zip(*rows, strict=True)) if rows else [()] * 9
    return RoadChanges(
        way_id=np.array(columns[0], dtype=np.int64),
        kind=strings(columns[1]),
        key=strings(columns[2]),
        old=strings(columns[3]),
        new=strings(columns[4]),
        moved_m=np.array(columns[5], dtype=np.float64),
        version_old=np.array(columns[6], dtype=np.int64),
        version_new=np.array(columns[7], dtype=np.int64),
        timestamp_new=strings(columns[8]),
    )
