"""A person's edits of a released map, brought along into the map of today.

What was edited is the released map: its lanelets may be cut, its nodes lie where that release put them. Its
elements and tags are taken over as they were saved; every node moves by what today's alignment moves its
surroundings against the release, and by what the person moved it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.osm_xml_rules import check_references, numbers
from flexmap_tasks.geometry.utm import to_utm, utm_epsg
from flexmap_tasks.model.arrays import Bools, Floats, Ints, strings
from flexmap_tasks.model.maps import Findings, LaneletMap
from flexmap_tasks.model.osm import OsmDocument, OsmNodes, OsmRelations, OsmWays, rows_of
from flexmap_tasks.model.projection import Projection

PLACE_MIN_DEG = 6e-8
"""Editors round degrees to seven decimals: what moves less was not moved by a person."""
LOCAL_MIN_M = 1e-3
STILL_MIN_M = 1e-3
"""An alignment that moves a node by less than a millimetre leaves it where it is."""
NEIGHBOURS = 4


@stage("map_with_edits")
def carry_edits(
    lanelet_map: LaneletMap, released: LaneletMap, edited: LaneletMap, projection: Projection | None
) -> LaneletMap:
    """The edited map in the frame of `lanelet_map`, which is the recorded map as today's alignment puts it.

    projection : of the map frame; None where the map stays in the frame of the SLAM
    A moved node is told by lat and lon, or, where these are as released, by local_x and local_y: editors of
    OpenStreetMap write the first, editors of Lanelet2 maps both. Heights are told by `ele`.
    Raises InputError where released and edited map have nothing in common with the recorded one.
    """
    edited = _without_deleted(released.document, edited)
    then, now = _places(released, edited, projection)
    nodes = edited.document.nodes.id
    in_release, in_source = (
        rows_of(released.document.nodes.id, nodes),
        rows_of(lanelet_map.document.nodes.id, nodes),
    )
    both = rows_of(lanelet_map.document.nodes.id, released.document.nodes.id)
    known = np.flatnonzero(both >= 0)
    if not len(known):
        rule = "holds no node of lanelet_map.file; give the release that was made of it"
        raise InputError("lanelet_map.edits.released", rule)
    shift = lanelet_map.xyz_m[both[known]] - then[known]
    shift = np.where(np.abs(shift) < STILL_MIN_M, 0.0, shift)
    xyz_m = now + _spread(then[known], shift, now)
    same = np.flatnonzero((in_release >= 0) & (in_source >= 0))
    xyz_m[same] = lanelet_map.xyz_m[in_source[same]] + (now[same] - then[in_release[same]])
    return LaneletMap(edited.document, xyz_m, _findings(lanelet_map, released, edited))


def _without_deleted(released: OsmDocument, edited: LaneletMap) -> LaneletMap:
    """The edited map without what its editor has marked `action="delete"`, and the release has not."""
    document = edited.document
    nodes, ways, relations = (
        np.flatnonzero(~np.isin(now.id, np.setdiff1d(_marked(now), _marked(then))))
        for now, then in (
            (document.nodes, released.nodes),
            (document.ways, released.ways),
            (document.relations, released.relations),
        )
    )
    kept = replace(
        document,
        nodes=document.nodes.take(nodes),
        ways=document.ways.take(ways),
        relations=document.relations.take(relations),
    )
    check_references(kept, "lanelet_map.edits.edited")
    return replace(edited, document=kept, xyz_m=edited.xyz_m[nodes])


def _marked(elements: OsmNodes | OsmWays | OsmRelations) -> Ints:
    """Ids of elements that an editor of OpenStreetMap has deleted and kept in its file until it is uploaded."""
    ids: Ints = elements.id[elements.attributes.column("action") == "delete"]
    return ids


def _places(released: LaneletMap, edited: LaneletMap, projection: Projection | None) -> tuple[Floats, Floats]:
    """Nodes of both maps in one frame; a node that was not moved has the very same place in both."""
    old, new = released.document, edited.document
    epsg = _zone(released) if projection is None else projection.epsg
    then, there = _plane(released, epsg, projection)
    now, here = _plane(edited, epsg, projection)
    if not (there.all() and here.any()):
        then, now = (
            released.xyz_m[:, :2],
            edited.xyz_m[:, :2],
        )  # blank degrees: both are drawn in local_x, local_y
        here = np.ones(len(now), dtype=bool)
    then, now = (np.column_stack([xy, m.xyz_m[:, 2]]) for xy, m in ((then, released), (now, edited)))
    row = rows_of(old.nodes.id, new.nodes.id)
    at = np.flatnonzero(row >= 0)
    was = row[at]
    local = _local_m(new)[at] - _local_m(old)[was]
    local -= np.median(local[~np.isnan(local[:, 0])], axis=0) if np.isfinite(local).any() else 0.0
    step = now[at] - then[was]
    turned = np.abs(new.nodes.lonlat_deg[at] - old.nodes.lonlat_deg[was]).max(axis=1) > PLACE_MIN_DEG
    pushed = np.nan_to_num(np.abs(local).max(axis=1)) > LOCAL_MIN_M
    step[:, :2] = np.where(turned[:, None], step[:, :2], np.where(pushed[:, None], np.nan_to_num(local), 0.0))
    now[at] = then[was] + step
    drawn = np.flatnonzero((row < 0) & ~here)
    if len(drawn):  # new, and drawn without lat and lon
        frame = np.median((then[was] - released.xyz_m[was])[:, :2], axis=0)
        now[drawn, :2] = edited.xyz_m[drawn, :2] + frame
    return then, now


def _zone(lanelet_map: LaneletMap) -> int:
    lonlat = lanelet_map.document.nodes.lonlat_deg
    has = ~np.isnan(lonlat).any(axis=1)
    return utm_epsg(*np.median(lonlat[has], axis=0).tolist()) if has.any() else utm_epsg(0.0, 0.0)


def _plane(lanelet_map: LaneletMap, epsg: int, projection: Projection | None) -> tuple[Floats, Bools]:
    """(n, 2) lat and lon in the plane, metres, and which nodes have them."""
    lonlat = lanelet_map.document.nodes.lonlat_deg
    xy = to_utm(lonlat, epsg) if projection is None else projection.to_xy_m(lonlat)
    has: Bools = np.asarray(~np.isnan(lonlat).any(axis=1))
    return xy, has


def _local_m(document: OsmDocument) -> Floats:
    """(n, 2) local_x and local_y, NaN where absent."""
    columns: Floats = np.column_stack(
        [numbers(document.nodes.tags.column(k))[0] for k in ("local_x", "local_y")]
    )
    return columns


def _spread(at_m: Floats, shift_m: Floats, wanted_m: Floats) -> Floats:
    """(n, 3) the shift around every wanted place, from the nearest nodes that have one, by inverse distance."""
    if not np.any(shift_m):
        return np.zeros_like(wanted_m)
    found = cKDTree(at_m[:, :2]).query(wanted_m[:, :2], k=range(1, min(NEIGHBOURS, len(at_m)) + 1))
    distance, near = np.asarray(found[0]), np.asarray(found[1])
    weight = 1.0 / np.maximum(distance, STILL_MIN_M)
    total: Floats = np.einsum("ij,ijk->ik", weight / weight.sum(axis=1, keepdims=True), shift_m[near])
    return total


def _findings(lanelet_map: LaneletMap, released: LaneletMap, edited: LaneletMap) -> Findings:
    """What reading the edited map brought to light, and what of the recorded map the release did not hold."""
    late = np.setdiff1d(_lanelets(lanelet_map), _lanelets(released))
    found = edited.findings
    text = "stands in the recorded map and not in the release that was edited; it is left out"
    return replace(
        found,
        code=strings([*found.code, *["lanelet-not-in-edited-release"] * len(late)]),
        severity=strings([*found.severity, *["warning"] * len(late)]),
        primitive=strings([*found.primitive, *["lanelet"] * len(late)]),
        id=np.concatenate([found.id, late]),
        message=strings([*found.message, *[text] * len(late)]),
    )


def _lanelets(lanelet_map: LaneletMap) -> Ints:
    relations = lanelet_map.document.relations
    ids: Ints = relations.id[relations.tags.column("type") == "lanelet"]
    return ids
