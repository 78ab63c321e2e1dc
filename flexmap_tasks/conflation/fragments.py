"""Fragments: lanelets that lead nowhere and are more than the road has lanes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexmap_tasks.conflation.lane_check import LaneCounts
from flexmap_tasks.geometry.lanelets import gather
from flexmap_tasks.model.arrays import Bools, Ints
from flexmap_tasks.model.conflation import LaneCheck
from flexmap_tasks.model.lanelets import end_nodes
from flexmap_tasks.model.maps import LaneletMap, Lanelets
from flexmap_tasks.model.osm import OsmDocument, rows_of


@dataclass(frozen=True, slots=True, eq=False)
class Removed:
    """A lanelet that was taken out of the map, and why."""

    lanelet_id: int
    way_id: int
    reason: str


def fragments(
    lanelet_map: LaneletMap, lanelets: Lanelets, counts: LaneCounts, check: LaneCheck
) -> list[Removed]:
    """Lanelets that share an end with no other and that a carriageway has beyond OSM's count.

    Never one that another relation names or that carries a rule. Of several, the outermost go first.
    """
    row = rows_of(lanelets.id, check.lanelet_id)
    free = ~(_connected(lanelet_map, lanelets) | _needed(lanelet_map.document, lanelets))
    excess = np.where(check.verdict == "differ", check.lanes_map - check.lanes_osm, 0)
    at = np.flatnonzero((excess > 0) & free[row] & (counts.centerline[row] >= 0))
    at = at[np.lexsort((check.lanelet_id[at], -counts.lane[row[at]], counts.centerline[row[at]]))]
    line, out = counts.centerline[row[at]], []
    left = {int(c): int(excess[at[line == c]].min()) for c in np.unique(line)}
    for i, c in zip(at.tolist(), line.tolist(), strict=True):
        if left[c] > 0:
            left[c] -= 1
            reason = f"a fragment without predecessor and successor; {check.reason[i]}"
            out.append(Removed(int(check.lanelet_id[i]), int(check.way_id[i]), reason))
    return out


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
    offset, flat = gather(relations.offset, keep, np.zeros(len(keep), dtype=bool))
    kept = replace(
        relations,
        id=relations.id[keep],
        offset=offset,
        member_type=relations.member_type[flat],
        member_ref=relations.member_ref[flat],
        member_role=relations.member_role[flat],
        attributes=relations.attributes.take(keep),
        tags=relations.tags.take(keep),
        position=relations.position[keep],
    )
    return replace(lanelet_map, document=replace(lanelet_map.document, relations=kept))
