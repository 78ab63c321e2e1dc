"""What became of the matched roads between two dates of OpenStreetMap."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely

from flexmap_tasks.engine.stage import stage
from flexmap_tasks.model.arrays import Floats, Ints, strings
from flexmap_tasks.model.conflation import Matches, RoadChanges
from flexmap_tasks.model.maps import PlacedRoads
from flexmap_tasks.model.osm import rows_of

MOVED_MIN_M = 0.05
"""OpenStreetMap writes places to about a centimetre."""


class _State(NamedTuple):
    """A way at both dates: its row in each, -1 where it did not exist."""

    way: int
    old: int
    new: int


class _Change(NamedTuple):
    kind: str
    key: str = ""
    old: str = ""
    new: str = ""
    moved_m: float = float("nan")


@stage("road_changes")
def road_changes(
    before: PlacedRoads, after: PlacedRoads, matches_before: Matches, matches_after: Matches
) -> RoadChanges:
    """Changes of the ways that lanes were or are matched to, by way id, then kind and key.

    "new" is a way that lanes are matched to now and that did not exist; "gone" one that lanes were matched to
    and that exists no longer. Ways that exist at both dates are compared tag by tag and in their course.
    """
    used = np.union1d(matches_before.way_id, matches_after.way_id)
    used = used[used > 0]
    columns = (used, rows_of(before.network.way_id, used), rows_of(after.network.way_id, used))
    states = [_State(*row) for row in zip(*(c.tolist() for c in columns), strict=True)]
    found = [(state, change) for state in states for change in _changes(before, after, state)]
    return _table(before, after, found, _lanelets(matches_before, matches_after))


def _changes(before: PlacedRoads, after: PlacedRoads, at: _State) -> list[_Change]:
    if at.old < 0 or at.new < 0:
        return [_Change("new" if at.old < 0 else "gone")]
    moved = _moved_m(_course(before, at.old), _course(after, at.new))
    a, b = before.network.tags.of_element(at.old), after.network.tags.of_element(at.new)
    return ([_Change("geometry", moved_m=moved)] if moved > MOVED_MIN_M else []) + [
        _Change("tag", key, a.get(key, ""), b.get(key, ""))
        for key in sorted(a.keys() | b.keys())
        if a.get(key) != b.get(key)
    ]


def _course(roads: PlacedRoads, row: int) -> Floats:
    course: Floats = roads.xy_m[roads.network.offset[row] : roads.network.offset[row + 1]]
    return course


def _moved_m(a: Floats, b: Floats) -> float:
    """Greatest distance of either course from the other (Hausdorff)."""
    if len(a) < 2 or len(b) < 2 or (a.shape == b.shape and np.array_equal(a, b)):
        return 0.0
    return float(shapely.hausdorff_distance(shapely.linestrings(a), shapely.linestrings(b), densify=0.1))


def _lanelets(*matches: Matches) -> dict[int, str]:
    """Ids of the lanelets on each way at either date, ascending, with blanks between."""
    way, lanelet = (np.concatenate([getattr(m, name) for m in matches]) for name in ("way_id", "lanelet_id"))
    pairs = np.unique(np.stack([way, lanelet], axis=1), axis=0)
    start = np.flatnonzero(np.append(True, pairs[1:, 0] != pairs[:-1, 0])[: len(pairs)])
    groups = np.split(pairs[:, 1], start[1:])
    return {int(w): " ".join(map(str, g.tolist())) for w, g in zip(pairs[start, 0], groups, strict=True)}


def _table(
    before: PlacedRoads, after: PlacedRoads, found: list[tuple[_State, _Change]], lanelets: dict[int, str]
) -> RoadChanges:
    old, new = (np.array([getattr(s, name) for s, _ in found], dtype=np.int64) for name in ("old", "new"))
    place = np.where((new >= 0)[:, None], _middle_deg(after, new), _middle_deg(before, old))
    return RoadChanges(
        way_id=np.array([s.way for s, _ in found], dtype=np.int64),
        **{name: strings(getattr(c, name) for _, c in found) for name in ("kind", "key", "old", "new")},
        moved_m=np.array([c.moved_m for _, c in found], dtype=np.float64),
        version_old=_version(before, old),
        version_new=_version(after, new),
        timestamp_old=strings(before.network.timestamp[i] if i >= 0 else "" for i in old.tolist()),
        timestamp_new=strings(after.network.timestamp[i] if i >= 0 else "" for i in new.tolist()),
        lanelets=strings(lanelets.get(s.way, "") for s, _ in found),
        lon_deg=place[:, 0],
        lat_deg=place[:, 1],
    )


def _version(roads: PlacedRoads, row: Ints) -> Ints:
    return np.where(row >= 0, np.append(roads.network.version, 0)[row], 0)


def _middle_deg(roads: PlacedRoads, row: Ints) -> Floats:
    """(n, 2) the vertex in the middle of every way, NaN for row -1."""
    offset = roads.network.offset
    vertex = (offset[row] + offset[row + 1]) // 2 if len(roads.network) else row
    lonlat = np.append(roads.network.lonlat_deg, [[np.nan, np.nan]], axis=0)
    middle: Floats = lonlat[np.where(row >= 0, vertex, -1)]
    return middle
