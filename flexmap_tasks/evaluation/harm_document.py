"""What a tool took away from the elements of a map: tags, members, references, metadata."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

import numpy as np

from flexmap_tasks.geometry.utm import to_utm, utm_epsg
from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.osm import OsmDocument, OsmNodes, OsmRelations, OsmWays, Tags, rows_of

RECOMPUTED = frozenset({"local_x", "local_y", "mgrs_code", "ele"})
"""Tags of a node that follow from where it lies."""
DISAGREE_M = 0.05
MAX_TURN_DEG, MAX_SCALE = 2.0, 1e-3
"""Between a local frame and UTM lie at most grid scale and convergence."""
_NAME = re.compile(r"\s*<\s*([^\s/>!?]+)")
Elements = OsmNodes | OsmWays | OsmRelations


def lost_and_emptied(before: OsmDocument, after: OsmDocument, deleted: Ints) -> dict[str, int]:
    """Elements and tags that are gone or empty, by kind; `deleted` were meant to go."""
    harm: dict[str, int] = {}
    written = 0
    kinds: tuple[tuple[str, Elements, Elements], ...] = (
        ("node", before.nodes, after.nodes),
        ("way", before.ways, after.ways),
        ("relation", before.relations, after.relations),
    )
    for kind, old, new in kinds:
        harm[f"{kind}s lost"] = int(np.setdiff1d(np.setdiff1d(old.id, new.id), deleted).size)
        there = set(new.id.tolist())
        was, now = _pairs(old.id, old.tags), _pairs(new.id, new.tags)
        harm[f"tags lost on {kind}s"] = sum(
            pair not in now and pair[0] in there and pair[1] not in RECOMPUTED for pair in was
        )
        empty = [pair for pair, value in now.items() if value == ""]
        harm[f"tags emptied on {kind}s"] = sum(was.get(pair, "") != "" for pair in empty)
        written += sum(was.get(pair) != "" for pair in empty)
    harm["relations that lost members"] = _relations_short_of_members(before.relations, after.relations)
    harm["empty tag values written"] = written
    kept = set(_names(after.other_xml))
    harm["metadata elements lost"] = sum(name not in kept for name in _names(before.other_xml))
    return harm


def nodes_moved(before: OsmNodes, after: OsmNodes) -> int:
    """Nodes whose lat or lon is written otherwise."""
    row = rows_of(after.id, before.id)
    both = row >= 0
    columns = ((b.attributes.column("lat"), b.attributes.column("lon")) for b in (before, after))
    (lat0, lon0), (lat1, lon1) = columns
    moved = (lat0[both] != lat1[row[both]]) | (lon0[both] != lon1[row[both]])
    return int(np.count_nonzero(moved))


def local_frame(nodes: OsmNodes) -> tuple[int, int]:
    """How many nodes carry local_x and local_y, and how many of these do not fit lat and lon by 5 cm.

    The local frame may be any sane plane: UTM after one best shift, with scale and turn only as far as grid
    scale and convergence reach.
    """
    local = np.column_stack([_numbers(nodes.tags.column(key)) for key in ("local_x", "local_y")])
    tagged = np.isfinite(local).all(axis=1)
    use = tagged & np.isfinite(nodes.lonlat_deg).all(axis=1)
    if np.count_nonzero(use) < 2:
        return int(tagged.sum()), 0
    lonlat = nodes.lonlat_deg[use]
    utm = to_utm(lonlat, utm_epsg(float(lonlat[0, 0]), float(lonlat[0, 1])))
    u, w = ((xy - xy.mean(axis=0)) @ (1, 1j) for xy in (utm, local[use]))
    spread = float((np.abs(u) ** 2).sum())
    turn = complex((w * u.conj()).sum() / spread) if spread else 1 + 0j
    if abs(abs(turn) - 1) > MAX_SCALE or abs(np.degrees(np.angle(turn))) > MAX_TURN_DEG:
        turn = 1 + 0j
    return int(tagged.sum()), int(np.count_nonzero(~(np.abs(w - turn * u) <= DISAGREE_M)))


def _pairs(ids: Ints, tags: Tags) -> dict[tuple[int, str], str]:
    owner = ids[tags.owner()].tolist()
    return dict(zip(zip(owner, tags.key.tolist(), strict=True), tags.value.tolist(), strict=True))


def _relations_short_of_members(before: OsmRelations, after: OsmRelations) -> int:
    """Relations, lanelets apart, that miss a member they had."""
    other = np.flatnonzero(before.tags.column("type") != "lanelet")
    row = rows_of(after.id, before.id)
    return sum(
        bool(_members(before, i) - _members(after, int(row[i]))) for i in other.tolist() if row[i] >= 0
    )


def _members(relations: OsmRelations, row: int) -> Counter[tuple[str, int, str]]:
    at = slice(int(relations.offset[row]), int(relations.offset[row + 1]))
    columns = (relations.member_type[at], relations.member_ref[at].tolist(), relations.member_role[at])
    return Counter(zip(*columns, strict=True))


def _names(other_xml: Iterable[str]) -> list[str]:
    return [found[1] for found in map(_NAME.match, other_xml) if found]


def _numbers(text: np.ndarray) -> Floats:
    out = np.full(len(text), np.nan)
    for i, value in enumerate(text.tolist()):
        try:
            out[i] = float(value) if value else np.nan
        except ValueError:
            continue
    return out
