"""Whether roads run through towns or between them: from the land along them and the signs on them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import shapely

from flexmap_tasks.formats.osm_roads_elements import Land, RoadElements
from flexmap_tasks.geometry.lanelets import offsets
from flexmap_tasks.model.arrays import Bools, Floats, Ints
from flexmap_tasks.model.osm import rows_of

BESIDE_M = 25.0
"""Land this near lies along the road: it often ends where the road begins."""
STEP_M = 15.0
METRES_PER_DEGREE = 111_320.0


def land_along(offset: Ints, lonlat_deg: Floats, elements: RoadElements) -> tuple[Floats, Floats]:
    """(w,) shares of every way's length along built-up land, and along open land only.

    offset, lonlat_deg : vertices of the ways
    """
    ways = len(offset) - 1
    if not ways or not elements.lands:
        return np.zeros(ways), np.zeros(ways)
    middle = np.median(lonlat_deg, axis=0)
    metres = METRES_PER_DEGREE * np.array([np.cos(np.radians(middle[1])), 1.0])
    owner = np.repeat(np.arange(ways), np.diff(offset))
    lines = shapely.linestrings((lonlat_deg - middle) * metres, indices=owner)
    count = np.ceil(shapely.length(lines) / STEP_M).astype(np.int64).clip(1, 200)
    of = np.repeat(np.arange(ways), count)
    share = (np.arange(len(of)) - offsets(count)[of] + 0.5) / count[of]
    points = shapely.line_interpolate_point(lines[of], share, normalized=True)
    node_xy = (elements.lonlat_deg - middle) * metres
    town, land = (
        _beside(points, [x for x in elements.lands if x.built_up == use], elements.node_id, node_xy)
        for use in (True, False)
    )
    mean = np.stack([np.bincount(of, weights=hit, minlength=ways) / count for hit in (town, land & ~town)])
    return mean[0], mean[1]


def _beside(points: shapely.Geometry, lands: list[Land], node_id: Ints, node_xy: Floats) -> Bools:
    """(n,) points with one of the areas beside them."""
    near = np.zeros(len(points), dtype=bool)
    areas = [area for land in lands for area in _areas(land, node_id, node_xy)]
    if areas:
        near[shapely.STRtree(areas).query(points, predicate="dwithin", distance=BESIDE_M)[0]] = True
    return near


def _areas(land: Land, node_id: Ints, node_xy: Floats) -> list[shapely.Geometry]:
    """The rings that the outlines make; none where one is broken."""
    lines = []
    for refs in land.outlines:
        row = rows_of(node_id, np.array(refs, dtype=np.int64))
        if len(row) > 1 and (row >= 0).all():
            lines.append(shapely.linestrings(node_xy[row]))
    found: list[shapely.Geometry] = list(shapely.get_parts(shapely.polygonize(lines))) if lines else []
    return found


def inside_by_signs(offset: Ints, node_id: Ints, limits: Mapping[int, int]) -> Ints:
    """(w,) +1 for ways that begin or end at a sign with the town on their side, -1 with the town beyond it, else 0.

    A sign in the middle of a way says nothing of the whole.
    """
    nodes = np.array(sorted(limits), dtype=np.int64)
    sense = np.append(np.array([limits[n] for n in nodes.tolist()], dtype=np.int64), 0)
    first, last = (sense[rows_of(nodes, node_id[at])] for at in (offset[:-1], offset[1:] - 1))
    inside: Ints = np.sign(first - last)
    return inside
