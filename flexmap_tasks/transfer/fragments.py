"""Fragments: lanelets that lead nowhere and are more than the road has lanes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.model.conflation import LaneCheck
from flexmap_tasks.model.lanelets import end_nodes
from flexmap_tasks.model.maps import LaneletMap, Lanelets
from flexmap_tasks.model.osm import OsmDocument, rows_of
from flexmap_tasks.model.review import ReviewDecisions
from flexmap_tasks.transfer.facts import LaneletFacts
from flexmap_tasks.transfer.lane_check import LaneCounts

GAP_M = 1.5
"""A lone lanelet further from a carriageway than this is a road of its own."""
ANGLE_RAD = np.radians(20.0)


@dataclass(frozen=True, slots=True, eq=False)
class Fragment:
    """A lanelet beyond the number of lanes that leads nowhere, and why it is taken for one.

    lanes_map, lanes_osm : of its carriageway, with it
    """

    lanelet_id: int
    way_id: int
    lanes_map: int
    lanes_osm: int
    reason: str


def unconnected(lanelet_map: LaneletMap, facts: LaneletFacts) -> Bools:
    """(k,) bool: lanelets for cars that share an end with no other, that no relation names and that carry no rule."""
    free = ~(_connected(lanelet_map, facts.lanelets) | _needed(lanelet_map.document, facts.lanelets))
    free &= facts.open_to_cars & np.isfinite(facts.length_m)
    return free


def judged(
    found: list[Fragment], decisions: ReviewDecisions | None, remove: bool
) -> list[tuple[Fragment, str, str]]:
    """Each fragment with what becomes of it, "remove", "keep" or "review", and why; a person's word goes first.

    decisions : on fragments; the last one on the same lanelet, way and numbers of lanes counts
    """
    said = {} if decisions is None else {decisions.key_of(d): d for d in range(len(decisions))}
    out = []
    for f in found:
        d = said.get((f.lanelet_id, f.way_id, "fragment", str(f.lanes_map), str(f.lanes_osm)))
        if decisions is None or d is None:
            out.append((f, "remove" if remove else "review", f.reason))
        elif decisions.accept[d] == "accept":
            out.append((f, "remove", f"{f.reason}; accepted {decisions.by(d)}"))
        else:
            out.append((f, "keep", f"{f.reason}; rejected {decisions.by(d)}"))
    return out


def fragments(
    lanelet_map: LaneletMap, facts: LaneletFacts, counts: LaneCounts, check: LaneCheck, free: Bools
) -> list[Fragment]:
    """Lanelets that share an end with no other (`free`) and that a carriageway has beyond OSM's count.

    A lanelet that shares a bound belongs to its neighbours' carriageway; one that lies close beside a carriageway
    and was matched to no other road is beyond it.
    """
    lanelets = facts.lanelets
    if not len(check.lanelet_id):
        return []
    tied = _tied(lanelets, counts, check, free)
    known = np.array([r.lanelet_id for r in tied], dtype=np.int64)
    return tied + _beside(lanelet_map, facts, counts, check, free & ~np.isin(lanelets.id, known))


def _tied(lanelets: Lanelets, counts: LaneCounts, check: LaneCheck, free: Bools) -> list[Fragment]:
    """Of the lanelets of a carriageway beyond the count, the outermost go first."""
    row = rows_of(lanelets.id, check.lanelet_id)
    excess = np.where(check.verdict == "differ", check.lanes_map - check.lanes_osm, 0)
    at = np.flatnonzero((excess > 0) & free[row] & (counts.centerline[row] >= 0))
    at = at[np.lexsort((check.lanelet_id[at], -counts.lane[row[at]], counts.centerline[row[at]]))]
    line, out = counts.centerline[row[at]], []
    left = {int(c): int(excess[at[line == c]].min()) for c in np.unique(line)}
    for i, c in zip(at.tolist(), line.tolist(), strict=True):
        if left[c] > 0:
            left[c] -= 1
            reason = f"a fragment without predecessor and successor; {check.reason[i]}"
            out.append(_fragment(check, i, int(check.lanelet_id[i]), int(check.lanes_map[i]), reason))
    return out


def _beside(
    lanelet_map: LaneletMap, facts: LaneletFacts, counts: LaneCounts, check: LaneCheck, free: Bools
) -> list[Fragment]:
    """Lone lanelets along the edge of a carriageway that has as many lanes as OSM says without them."""
    lanelets = facts.lanelets
    verdict: Strings = np.full(len(lanelets), "", dtype=object)
    row = rows_of(lanelets.id, check.lanelet_id)
    verdict[row] = check.verdict
    entry = np.full(len(lanelets), -1, dtype=np.int64)
    entry[row] = np.arange(len(row))
    lone = np.flatnonzero(free & (verdict == "unmatched") & (counts.all <= 1))
    full = np.flatnonzero(
        (entry >= 0) & (check.lanes_osm > 0)[entry] & (check.lanes_map >= check.lanes_osm)[entry]
    )
    out = []
    for k, n in _side_by_side(lanelet_map, facts, lone, full):
        i = int(entry[n])
        reason = (
            f"a fragment without predecessor and successor beside lanelet {lanelets.id[n]}; {check.reason[i]}"
        )
        lanes = int(check.lanes_map[i]) + 1
        out.append(_fragment(check, i, int(lanelets.id[k]), lanes, f"{reason} without it"))
    return out


def _fragment(check: LaneCheck, i: int, lanelet_id: int, lanes: int, reason: str) -> Fragment:
    return Fragment(lanelet_id, int(check.way_id[i]), lanes, int(check.lanes_osm[i]), reason)


def _side_by_side(
    lanelet_map: LaneletMap, facts: LaneletFacts, lone: Ints, full: Ints
) -> list[tuple[int, int]]:
    """(lone, neighbour) rows: the nearest of `full` that runs along the lone lanelet with hardly a gap."""
    if not len(lone) or not len(full):
        return []
    line = facts.centreline
    lines = shapely.linestrings(
        line.xyz_m[:, :2], indices=np.repeat(np.arange(len(line)), np.diff(line.offset))
    )
    middle = shapely.line_interpolate_point(lines[lone], 0.5, normalized=True)
    width = _widths_m(lanelet_map, facts.lanelets)
    tree = shapely.STRtree(lines[full])
    (at, hit), distance = tree.query_nearest(middle, return_distance=True, all_matches=False)
    k, n = lone[at], full[hit]
    near = distance <= (width[k] + width[n]) * 0.5 + GAP_M
    across = np.abs(_heading_at(lines[k], middle[at]) - _heading_at(lines[n], middle[at])) % np.pi
    along = np.minimum(across, np.pi - across) <= ANGLE_RAD
    return list(zip(k[near & along].tolist(), n[near & along].tolist(), strict=True))


def _widths_m(lanelet_map: LaneletMap, lanelets: Lanelets) -> Floats:
    """(k,) mean of the widths at start and end."""
    xy = lanelet_map.xyz_m[end_nodes(lanelet_map, lanelets), :2]
    widths: Floats = np.hypot(*np.moveaxis(xy[:, [0, 2]] - xy[:, [1, 3]], -1, 0)).mean(axis=1)
    return widths


def _heading_at(lines: NDArray[np.object_], points: NDArray[np.object_]) -> Floats:
    """(n,) direction of each line at the place nearest to its point, radians."""
    at = shapely.line_locate_point(lines, points)
    ends = [shapely.get_coordinates(shapely.line_interpolate_point(lines, at + step)) for step in (-0.5, 0.5)]
    run = ends[1] - ends[0]
    heading: Floats = np.arctan2(run[:, 1], run[:, 0])
    return heading


def _connected(lanelet_map: LaneletMap, lanelets: Lanelets) -> Bools:
    """(k,) bool: another lanelet begins or ends where this one does, whichever way it runs."""
    ends = end_nodes(lanelet_map, lanelets)
    pairs = np.concatenate([np.sort(ends[:, :2], axis=1), np.sort(ends[:, 2:], axis=1)])
    _, inverse, count = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    shared = count[inverse.ravel()] > 1
    k = len(lanelets)
    return np.asarray(shared[:k] | shared[k:])


def _needed(document: OsmDocument, lanelets: Lanelets) -> Bools:
    """(k,) bool: a relation names the lanelet, or the lanelet names a rule."""
    relations = document.relations
    owner = np.repeat(np.arange(len(relations.id)), np.diff(relations.offset))
    to_relation = relations.member_type == "relation"
    named = np.isin(lanelets.id, relations.member_ref[to_relation])
    return np.asarray(named | np.isin(lanelets.relation_row, owner[to_relation]))


def without(lanelet_map: LaneletMap, lanelet_ids: Ints) -> LaneletMap:
    """The map without these lanelets; their ways and nodes stay."""
    relations = lanelet_map.document.relations
    keep = np.flatnonzero(
        ~((relations.tags.column("type") == "lanelet") & np.isin(relations.id, lanelet_ids))
    )
    document = replace(lanelet_map.document, relations=relations.take(keep))
    return replace(lanelet_map, document=document)
