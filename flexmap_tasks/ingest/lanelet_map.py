"""A Lanelet2 map, read without loss, with its nodes in a metric frame.

Where a node lies, in this order:

1. Where every node carries `local_x` and `local_y`, these are the frame: it is the one the map was drawn in
   (Vector Map Builder, MapToolbox), and lat and lon may be blank or stem from a made-up origin.
2. Where none does, lat and lon are projected as Lanelet2's UtmProjector does: UTM in the zone of the first node,
   minus that node. A map drawn in the SLAM frame and written around any made-up origin comes back in metres,
   shifted by a constant, which the rigid start takes out again.
3. Where only some do, the others are projected as in 2 and shifted by the median difference of the nodes that
   have both; this is reported.

z is `ele`, 0 where there is none.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.osm_xml import read_osm_xml
from flexmap_tasks.formats.osm_xml_rules import check_references, check_unique, numbers
from flexmap_tasks.geometry.utm import to_utm, utm_epsg
from flexmap_tasks.model.arrays import Bools, Floats, strings
from flexmap_tasks.model.lanelets import BoundState, bounds, lanelet_relations, usable_ways
from flexmap_tasks.model.maps import Findings, LaneletMap
from flexmap_tasks.model.osm import OsmDocument
from flexmap_tasks.model.source import Source

LARGEST_M = 1e8
"""No coordinate of a map on this planet is larger."""

WIDEST_M = 300_000.0
"""A map that reaches further holds a mistake: beyond half a zone's width UTM is no plane any more."""

Finding = tuple[str, str, str, int, str]


@stage("lanelet_map")
def ingest_lanelet_map(source: Source) -> LaneletMap:
    """Read a Lanelet2 file; what is odd about it but can be kept stands in `findings`.

    Raises InputError for what is no OSM XML, doubled ids, references to what is not there, coordinates that
    are no numbers, a node without any position, and a file without lanelets.
    """
    document = read_osm_xml(source.path, source.name)
    check_unique(document, source.name)
    check_references(document, source.name)
    if not len(lanelet_relations(document)):
        raise InputError(source.name, "expected a Lanelet2 map, found no relation with type=lanelet")
    xyz_m, notes = _positions(document, source.name)
    return LaneletMap(document, xyz_m, _findings(notes + _bound_findings(document)))


def _positions(document: OsmDocument, name: str) -> tuple[Floats, list[Finding]]:
    nodes = document.nodes
    local = np.column_stack([_metres(document, name, key) for key in ("local_x", "local_y")])
    ele = _metres(document, name, "ele")
    half = np.flatnonzero(np.isnan(local[:, 0]) != np.isnan(local[:, 1]))
    if len(half):
        rule = "has only one of local_x and local_y; give both or none"
        raise InputError(name, rule, f"node {nodes.id[half[0]]}")
    drawn = ~np.isnan(local[:, 0])
    xy_m, notes = (local, []) if drawn.all() else _projected(document, name, local, drawn)
    flat = np.isnan(ele)
    if flat.any():
        text = f"{np.count_nonzero(flat)} of {len(flat)} nodes have no ele; 0 m is taken"
        notes.append(("nodes-without-ele", "info", "map", 0, text))
    return np.column_stack([xy_m, np.where(flat, 0.0, ele)]), notes


def _projected(document: OsmDocument, name: str, local: Floats, drawn: Bools) -> tuple[Floats, list[Finding]]:
    """Positions where not every node carries local_x and local_y."""
    nodes = document.nodes
    known = ~np.isnan(nodes.lonlat_deg[:, 0])
    lost = np.flatnonzero(~known & ~drawn)
    if len(lost):
        rule = "has no position; give lat and lon, or local_x and local_y"
        raise InputError(name, rule, f"node {nodes.id[lost[0]]}")
    first = nodes.lonlat_deg[np.flatnonzero(known)[0]]
    utm = to_utm(nodes.lonlat_deg, utm_epsg(float(first[0]), float(first[1])))
    utm -= utm[np.flatnonzero(known)[0]]
    outside = np.flatnonzero(known & ~(np.hypot(utm[:, 0], utm[:, 1]) <= WIDEST_M))
    if len(outside):
        rule = f"lies more than {WIDEST_M / 1000:g} km from the first node; check lat and lon"
        raise InputError(name, rule, f"node {nodes.id[outside[0]]}")
    if not drawn.any():
        return utm, []
    both = drawn & known
    if not both.any():
        rule = "some nodes have only local_x and local_y, the others only lat and lon, and none has both"
        raise InputError(name, rule + "; give local_x and local_y everywhere")
    shifted = utm + np.median(local[both] - utm[both], axis=0)
    count = np.count_nonzero(~drawn)
    text = f"{count} of {len(drawn)} nodes have no local_x and local_y; they are placed by lat and lon"
    note = ("mixed-coordinates", "warning", "map", 0, text)
    return np.where(drawn[:, None], local, shifted), [note]


def _metres(document: OsmDocument, name: str, key: str) -> Floats:
    """(n,) metres of a node tag, NaN where it is absent or empty."""
    text = document.nodes.tags.column(key)
    value, blank = numbers(text)
    bad = np.flatnonzero(~blank & ~(np.abs(value) <= LARGEST_M))
    if len(bad):
        rule = f"{key} must be a number of metres, found {str(text[bad[0]])[:40]!r}"
        raise InputError(name, rule, f"node {document.nodes.id[bad[0]]}")
    return value


SIDES: tuple[Literal["left", "right"], ...] = ("left", "right")
_MISSING = "has {} {} bound; it is kept as it is and takes no part in matching"
_SHORT = "has a {} bound of less than two different nodes; it is kept as it is and takes no part in matching"


def _bound_findings(document: OsmDocument) -> list[Finding]:
    rows = lanelet_relations(document)
    out: list[Finding] = []
    usable = usable_ways(document)
    for side in SIDES:
        _, state = bounds(document, rows, side, usable)
        for i in np.flatnonzero(state != BoundState.GOOD).tolist():
            lanelet = int(document.relations.id[rows[i]])
            if state[i] == BoundState.SHORT:
                out.append(("lanelet-bound-too-short", "error", "lanelet", lanelet, _SHORT.format(side)))
            else:
                word = "no" if state[i] == BoundState.MISSING else "more than one"
                out.append(
                    ("lanelet-without-bound", "error", "lanelet", lanelet, _MISSING.format(word, side))
                )
    return sorted(out, key=lambda finding: finding[3])


def _findings(rows: list[Finding]) -> Findings:
    code, severity, primitive, message = (strings(row[i] for row in rows) for i in (0, 1, 2, 4))
    return Findings(code, severity, primitive, np.array([row[3] for row in rows], dtype=np.int64), message)
