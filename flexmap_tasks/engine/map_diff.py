"""What differs between two maps of one place: lanelets, their tags, and how far their bounds moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.model.lanelets import lanelet_relations
from flexmap_tasks.model.osm import OsmDocument, Tags, node_rows, rows_of

EARTH_RADIUS_M = 6_371_008.8


@dataclass(frozen=True, slots=True)
class TagChange:
    """A lanelet's attribute that differs; None where it has none."""

    lanelet_id: int
    key: str
    old: str | None
    new: str | None


@dataclass(frozen=True, slots=True)
class MapDiff:
    """Changes of a map; ids in ascending order.

    added, removed : lanelet ids; tags : attributes of the lanelets both have
    nodes_added, nodes_removed : how many; moved : how many of the common nodes lie elsewhere
    moved_mean_m, moved_max_m : over all common nodes, metres over ground; heights are not compared
    """

    added: tuple[int, ...]
    removed: tuple[int, ...]
    tags: tuple[TagChange, ...]
    nodes_added: int
    nodes_removed: int
    moved: int
    moved_mean_m: float
    moved_max_m: float


def diff_maps(old: OsmDocument, new: OsmDocument) -> MapDiff:
    """The changes from `old` to `new`."""
    old_rows, new_rows = lanelet_relations(old), lanelet_relations(new)
    old_ids, new_ids = old.relations.id[old_rows], new.relations.id[new_rows]
    both = np.intersect1d(old_ids, new_ids)
    old_tags = old.relations.tags.take(old_rows[rows_of(old_ids, both)])
    new_tags = new.relations.tags.take(new_rows[rows_of(new_ids, both)])
    moved_m, nodes_added, nodes_removed = _moved_m(old, new)
    return MapDiff(
        tuple(np.setdiff1d(new_ids, old_ids).tolist()),
        tuple(np.setdiff1d(old_ids, new_ids).tolist()),
        tuple(_tag_changes(both, old_tags, new_tags)),
        nodes_added,
        nodes_removed,
        int((moved_m > 0).sum()),
        float(moved_m.mean()) if len(moved_m) else 0.0,
        float(moved_m.max(initial=0.0)),
    )


def _tag_changes(ids: NDArray[np.int64], old: Tags, new: Tags) -> list[TagChange]:
    changes: list[TagChange] = []
    for i, lanelet in enumerate(ids.tolist()):
        before, now = old.of_element(i), new.of_element(i)
        changes += [
            TagChange(lanelet, key, before.get(key), now.get(key))
            for key in sorted(before.keys() | now.keys())
            if before.get(key) != now.get(key)
        ]
    return changes


def _moved_m(old: OsmDocument, new: OsmDocument) -> tuple[NDArray[np.float64], int, int]:
    """Distance of every node that both maps use in a line, and how many only one of them uses."""
    old_used, new_used = _used_nodes(old), _used_nodes(new)
    both = np.intersect1d(old_used, new_used)
    a = np.radians(old.nodes.lonlat_deg[rows_of(old.nodes.id, both)])
    b = np.radians(new.nodes.lonlat_deg[rows_of(new.nodes.id, both)])
    same = (a == b).all(axis=1)
    shrink = np.cos((a[:, 1] + b[:, 1]) / 2)
    moved = EARTH_RADIUS_M * np.hypot((b[:, 0] - a[:, 0]) * shrink, b[:, 1] - a[:, 1])
    moved = np.where(same, 0.0, moved)
    known = np.isfinite(moved)  # a map without lat and lon says nothing about places
    return moved[known], len(new_used) - len(both), len(old_used) - len(both)


def _used_nodes(document: OsmDocument) -> NDArray[np.int64]:
    rows = node_rows(document)
    return np.unique(document.nodes.id[rows[rows >= 0]])
