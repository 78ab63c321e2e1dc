"""Lanelets that are broken in themselves, and what a move did to their shape."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
import shapely

from flexmap_tasks.geometry.lanelets import fractions
from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.model.lanelets import Polylines, bound_polylines, lanelets_of
from flexmap_tasks.model.maps import LaneletMap, Lanelets
from flexmap_tasks.model.osm import OsmDocument, node_rows, rows_of

WIDTH_PLACES = 9
"""Cross sections per lanelet, its ends included."""


def broken_geometry(document: OsmDocument) -> dict[str, int]:
    """How often each kind of damage stands in a map."""
    relations = document.relations
    rows = np.flatnonzero(relations.tags.column("type") == "lanelet")
    left, right = _bound(document, "left")[rows], _bound(document, "right")[rows]
    absent = (left < 0) | (right < 0)
    few, repeats = _few_nodes(document), _repeats(document)
    pairs = Counter(zip(left[~absent].tolist(), right[~absent].tolist(), strict=True))
    return {
        "lanelets without two bounds": int(absent.sum()),
        "lanelets with a one-point bound": int(few[left[~absent]].sum() + few[right[~absent]].sum()),
        "lanelets with repeated points in a bound": int(
            repeats[left[~absent]].sum() + repeats[right[~absent]].sum()
        ),
        "lanelets that share both bounds": sum(n - 1 for n in pairs.values()),
        "ways with a missing node": int(_incomplete(document).sum()),
        "relations with a missing member": _dangling(document),
    }


def _bound(document: OsmDocument, side: str) -> Ints:
    """(r,) row of the one way with that role in each relation, -1 where there is none, several, or no such way."""
    relations = document.relations
    hit = np.flatnonzero((relations.member_role == side) & (relations.member_type == "way"))
    owner = np.searchsorted(relations.offset, hit, side="right") - 1
    way = np.full(len(relations.id), -1, dtype=np.int64)
    way[owner] = rows_of(document.ways.id, relations.member_ref[hit])
    way[np.bincount(owner, minlength=len(way)) != 1] = -1
    return way


def _incomplete(document: OsmDocument) -> Bools:
    """(w,) a node is missing."""
    owner = np.repeat(np.arange(len(document.ways.id)), np.diff(document.ways.offset))
    missing: Bools = np.bincount(owner[node_rows(document) < 0], minlength=len(document.ways.id)) > 0
    return missing


def _few_nodes(document: OsmDocument) -> Bools:
    """(w,) fewer than two different nodes."""
    ways = document.ways
    return np.array([len(set(ways.ref[a:b].tolist())) < 2 for a, b in _spans(ways.offset)], dtype=bool)


def _repeats(document: OsmDocument) -> Bools:
    """(w,) a node stands twice in a row."""
    ways = document.ways
    owner = np.repeat(np.arange(len(ways.id)), np.diff(ways.offset))
    twice = (ways.ref[1:] == ways.ref[:-1]) & (owner[1:] == owner[:-1])
    repeats: Bools = np.bincount(owner[1:][twice], minlength=len(ways.id)) > 0
    return repeats


def _dangling(document: OsmDocument) -> int:
    relations = document.relations
    missing = np.zeros(len(relations.member_ref), dtype=bool)
    for kind, ids in (("node", document.nodes.id), ("way", document.ways.id), ("relation", relations.id)):
        of_kind = relations.member_type == kind
        missing[of_kind] = rows_of(ids, relations.member_ref[of_kind]) < 0
    owner = np.searchsorted(relations.offset, np.flatnonzero(missing), side="right") - 1
    return len(np.unique(owner))


def _spans(offset: Ints) -> list[tuple[int, int]]:
    return list(zip(offset[:-1].tolist(), offset[1:].tolist(), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class ShapeChange:
    """What became of the lanelets that both maps have.

    lanelet_id : (k,) int64; width_before_m, width_after_m : (k, WIDTH_PLACES)
    folded : (k,) bool, a proper outline before, crossing itself or turned over after
    skipped : lanelets of the first map that were cut or are gone
    """

    lanelet_id: Ints
    width_before_m: Floats
    width_after_m: Floats
    folded: Bools
    skipped: int

    @property
    def width_change_m(self) -> Floats:
        """(k * WIDTH_PLACES,) how much wider or narrower."""
        return np.abs(self.width_after_m - self.width_before_m).ravel()


def shape_change(before: LaneletMap, after: LaneletMap) -> ShapeChange:
    """Compare lanelets whose four corners are the same nodes in both maps, turned as they are in the first."""
    old = lanelets_of(before)
    row = rows_of(after.document.relations.id, old.id)
    left, right = (np.append(_bound(after.document, side), -1)[row] for side in ("left", "right"))
    whole = ~np.append(_few_nodes(after.document) | _incomplete(after.document), True)
    keep = np.flatnonzero(whole[left] & whole[right])
    old, new = _take(old, keep), replace(_take(old, keep), left_way=left[keep], right_way=right[keep])
    same = (_corner_ids(before, old) == _corner_ids(after, new)).all(axis=1)
    kept, skipped = _take(old, same), len(row) - int(same.sum())
    old, new = kept, _take(new, same)
    good, area = _outline(before, old)
    still_good, area_after = _outline(after, new)
    folded = good & (~still_good | (np.sign(area) != np.sign(area_after)))
    return ShapeChange(old.id, _widths(before, old), _widths(after, new), folded, skipped)


def _take(lanelets: Lanelets, rows: Ints | Bools) -> Lanelets:
    return Lanelets(*(getattr(lanelets, name)[rows] for name in Lanelets.__dataclass_fields__))


def _corner_ids(lanelet_map: LaneletMap, lanelets: Lanelets) -> Ints:
    """(k, 4) ids of the first and last nodes of both bounds."""
    ids = lanelet_map.document.nodes.id
    sides = bound_polylines(lanelet_map, lanelets, "left"), bound_polylines(lanelet_map, lanelets, "right")
    return np.stack([ids[s.node_row[at]] for s in sides for at in (s.offset[:-1], s.offset[1:] - 1)], axis=1)


def _widths(lanelet_map: LaneletMap, lanelets: Lanelets) -> Floats:
    """(k, WIDTH_PLACES) distance of the bounds at equal shares of their lengths, in the plane."""
    left = bound_polylines(lanelet_map, lanelets, "left")
    right = bound_polylines(lanelet_map, lanelets, "right")
    gap = _evenly(left) - _evenly(right)
    width: Floats = np.hypot(gap[..., 0], gap[..., 1])
    return width


def _evenly(line: Polylines) -> Floats:
    """(k, WIDTH_PLACES, 2) places at equal shares of each line's length."""
    owner = np.repeat(np.arange(len(line)), np.diff(line.offset))
    along = 2.0 * owner + fractions(line.offset, line.xyz_m)
    wanted = (2.0 * np.arange(len(line))[:, None] + np.linspace(0, 1, WIDTH_PLACES)).ravel()
    if not len(line):
        return np.empty((0, WIDTH_PLACES, 2))
    columns = [np.interp(wanted, along, line.xyz_m[:, k]) for k in (0, 1)]
    return np.stack(columns, axis=-1).reshape(len(line), WIDTH_PLACES, 2)


def _outline(lanelet_map: LaneletMap, lanelets: Lanelets) -> tuple[Bools, Floats]:
    """Whether left bound there and right bound back do not cross, and twice the signed area."""
    left = bound_polylines(lanelet_map, lanelets, "left")
    right = bound_polylines(lanelet_map, lanelets, "right")
    rings = [
        np.concatenate([left.xyz_m[a:b, :2], right.xyz_m[c:d, :2][::-1]])
        for (a, b), (c, d) in zip(_spans(left.offset), _spans(right.offset), strict=True)
    ]
    area = np.array([_twice_area(ring) for ring in rings])
    outlines: Strings = np.array([shapely.Polygon(ring) for ring in rings], dtype=object)
    return np.asarray(shapely.is_valid(outlines)), area


def _twice_area(ring: Floats) -> float:
    x, y = (ring - ring[0]).T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())
