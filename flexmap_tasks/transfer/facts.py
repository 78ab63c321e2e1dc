"""What transfer needs to know of every lanelet before it decides anything."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.model.lanelets import Polylines, centrelines, end_nodes, lanelets_of, lengths_m
from flexmap_tasks.model.maps import LaneletMap, Lanelets
from flexmap_tasks.model.osm import OsmDocument, Tags, rows_of
from flexmap_tasks.transfer.values import format_kmh, speed_kmh

OPEN_SUBTYPES = ("", "road", "highway", "play_street", "exit")
"""Subtypes that Lanelet2 lets cars drive on."""


@dataclass(frozen=True, slots=True, eq=False)
class LaneletFacts:
    """What transfer needs to know of every lanelet, by row of `lanelets`.

    open_to_cars : (k,) bool; forks : (k,) bool, it turns, or begins or ends together with another lanelet
    centreline : (k,) lines; length_m : (k,) float64, their lengths in the plane
    drawn_way : (k,) int64 row of the way that is its member `centerline`, -1 for none, -2 where several share
    one; drawn_inverted : (k,) bool, it runs against the lanelet
    speed_rule : (k,) str, what a speed limit rule (regulatory element) says of it in km/h, "?" where it cannot be
    read, "" without a rule; Lanelet2 then ignores the tag
    tags : of the lanelets, in the same rows
    """

    lanelets: Lanelets
    open_to_cars: Bools
    forks: Bools
    centreline: Polylines
    length_m: Floats
    drawn_way: Ints
    drawn_inverted: Bools
    speed_rule: Strings
    tags: Tags


def facts_of(lanelet_map: LaneletMap) -> LaneletFacts:
    """The lanelets of the map with length, tags, and whether cars may use them."""
    lanelets = lanelets_of(lanelet_map)
    tags = lanelet_map.document.relations.tags.take(lanelets.relation_row)
    open_to_cars = np.array([_open(tags.of_element(i)) for i in range(len(lanelets))], dtype=bool)
    lines = centrelines(lanelet_map, lanelets)
    drawn = _drawn_centrelines(lanelet_map.document, lanelets)
    inverted = _against(lanelet_map, drawn, lines)
    forks = _forks(end_nodes(lanelet_map, lanelets)) | (tags.column("turn_direction") != None)  # noqa: E711
    rules = speed_rules(lanelet_map.document, lanelets)
    return LaneletFacts(lanelets, open_to_cars, forks, lines, lengths_m(lines), drawn, inverted, rules, tags)


def _forks(ends: Ints) -> Bools:
    """(k,) bool: another lanelet has the same two nodes at its start, or at its end."""
    out = np.zeros(len(ends), dtype=bool)
    for pair in (ends[:, :2], ends[:, 2:]):
        _, inverse, times = np.unique(pair, axis=0, return_inverse=True, return_counts=True)
        out |= times[inverse.ravel()] > 1
    return out


def speed_rules(document: OsmDocument, lanelets: Lanelets) -> Strings:
    """(k,) str: see `LaneletFacts.speed_rule`."""
    relations = document.relations
    limit = (relations.tags.column("type") == "regulatory_element") & (
        relations.tags.column("subtype") == "speed_limit"
    )
    hit = np.flatnonzero(
        (relations.member_role == "regulatory_element") & (relations.member_type == "relation")
    )
    rule = rows_of(relations.id, relations.member_ref[hit])
    hit, rule = hit[rule >= 0], rule[rule >= 0]
    hit, rule = hit[limit[rule]], rule[limit[rule]]
    out: Strings = np.full(len(lanelets), "", dtype=object)
    lanelet = rows_of(lanelets.relation_row, np.searchsorted(relations.offset, hit, side="right") - 1)
    for k, r in zip(lanelet.tolist(), rule.tolist(), strict=True):
        sign = relations.tags.of_element(r).get("sign_type", "")
        speed = speed_kmh(sign.removeprefix("de274-"), {})
        out[k] = "?" if speed is None or not 0 < speed < 1000 or out[k] else format_kmh(speed)
    return out


def _drawn_centrelines(document: OsmDocument, lanelets: Lanelets) -> Ints:
    relations = document.relations
    hit = np.flatnonzero((relations.member_role == "centerline") & (relations.member_type == "way"))
    owner = np.searchsorted(relations.offset, hit, side="right") - 1
    way = rows_of(document.ways.id, relations.member_ref[hit])
    lanelet = rows_of(lanelets.relation_row, owner)
    hit, way, lanelet = hit[lanelet >= 0], way[lanelet >= 0], lanelet[lanelet >= 0]
    out = np.full(len(lanelets), -1, dtype=np.int64)
    out[lanelet] = way
    several = np.bincount(lanelet, minlength=len(lanelets)) > 1
    shared = np.bincount(way[way >= 0], minlength=len(document.ways.id)) > 1
    shared[lanelets.left_way] = shared[lanelets.right_way] = True
    out[several | ((out >= 0) & shared[out])] = -2
    return out


def _against(lanelet_map: LaneletMap, drawn: Ints, lines: Polylines) -> Bools:
    """(k,) bool: the drawn centreline runs against the lanelet, judged from end to end."""
    out = np.zeros(len(drawn), dtype=bool)
    has = np.flatnonzero(drawn >= 0)
    offset, ref = lanelet_map.document.ways.offset, lanelet_map.document.ways.ref
    has = has[np.diff(offset)[drawn[has]] > 0]
    ends = [
        rows_of(lanelet_map.document.nodes.id, ref[at])
        for at in (offset[drawn[has]], offset[drawn[has] + 1] - 1)
    ]
    run = lanelet_map.xyz_m[ends[1]] - lanelet_map.xyz_m[ends[0]]
    along = lines.xyz_m[lines.offset[has + 1] - 1] - lines.xyz_m[lines.offset[has]]
    out[has] = np.einsum("ij,ij->i", run[:, :2], along[:, :2]) < 0
    return out


def _open(tags: Mapping[str, str]) -> bool:
    """Lanelet2's default rules for a car: `participant` tags override the subtype."""
    overrides = [k for k in tags if k.split(":")[0] == "participant"]
    for key in ("participant:vehicle:car", "participant:vehicle", "participant"):
        if key in tags:
            return tags[key].lower() in ("yes", "true", "1")
    return not overrides and tags.get("subtype", "") in OPEN_SUBTYPES
