"""Review items as a layer for JOSM: the outlines of the lanelets in question, never to be uploaded."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import shapely

from flexmap_tasks.formats.clean_text import clean
from flexmap_tasks.formats.osm_xml_write import write_osm_xml
from flexmap_tasks.model.arrays import Ints, strings
from flexmap_tasks.model.osm import OsmDocument, OsmNodes, OsmRelations, OsmWays, Tags, rows_of
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.report.layers import Lanes
from flexmap_tasks.report.review_items import ReviewItems

LONGEST_VALUE = 255
"""Characters that OSM allows in a value."""


def josm_layer(items: ReviewItems, lanelets: Lanes, projection: Projection) -> bytes:
    """One closed way per lanelet with items; `fixme` holds them all, ids are negative: nothing exists in OSM."""
    ids, first = np.unique(items.lanelet_id, return_inverse=True)
    row = rows_of(lanelets.id, ids)
    drawn = np.flatnonzero(row >= 0)
    rings = [shapely.get_coordinates(lanelets.ring[row[i]])[:-1] for i in drawn.tolist()]
    size = np.array([len(r) for r in rings], dtype=np.int64)
    start = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
    lonlat = projection.to_lonlat_deg(np.concatenate([*rings, np.empty((0, 2))]))
    node_id = -1 - np.arange(start[-1], dtype=np.int64)
    closed = [np.append(node_id[a:b], node_id[a]) for a, b in pairwise(start.tolist())]
    nodes = _nodes(node_id, lonlat)
    ways = OsmWays(
        -1 - start[-1] - np.arange(len(drawn), dtype=np.int64),
        np.concatenate([[0], np.cumsum(size + 1)]).astype(np.int64),
        np.concatenate([*closed, np.empty(0, dtype=np.int64)]),
        Tags.of({"version": "1", "visible": "true"} for _ in drawn),
        Tags.of(_tags(items, np.flatnonzero(first == i)) for i in drawn.tolist()),
        np.arange(len(drawn), dtype=np.int64) + start[-1],
    )
    root = {"version": "0.6", "generator": "flexmap", "upload": "never"}
    nothing = np.zeros(0, dtype=np.int64)
    none = strings([])
    relations = OsmRelations(
        nothing, np.zeros(1, np.int64), none, nothing, none, Tags.of([]), Tags.of([]), nothing
    )
    return write_osm_xml(OsmDocument(root, nodes, ways, relations, none, nothing))


def _nodes(ids: Ints, lonlat_deg: np.ndarray) -> OsmNodes:
    attributes = Tags.of(
        {"version": "1", "visible": "true", "lat": f"{lat:.9f}", "lon": f"{lon:.9f}"}
        for lon, lat in lonlat_deg.tolist()
    )
    return OsmNodes(
        ids, lonlat_deg, attributes, Tags.of({} for _ in ids), np.arange(len(ids), dtype=np.int64)
    )


def _tags(items: ReviewItems, rows: Ints) -> dict[str, str]:
    asked = [
        f"{items.subject[i]}: map {items.have[i] or '-'}, OSM {items.offer[i] or '-'} ({items.reason[i]})"
        for i in rows.tolist()
    ]
    texts = {
        "fixme": "; ".join(asked),
        "note": f"lanelet {items.lanelet_id[rows[0]]}",
        "flexmap:lanelet": str(items.lanelet_id[rows[0]]),
        "flexmap:items": str(len(rows)),
        "area": "yes",
    }
    return {key: clean(text)[:LONGEST_VALUE] for key, text in texts.items()}
