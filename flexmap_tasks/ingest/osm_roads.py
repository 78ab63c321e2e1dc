"""OpenStreetMap's roads as a table: by way id, independent of how the extract is written."""

from __future__ import annotations

from itertools import chain

import numpy as np

from flexmap_tasks.config import OsmRoadsParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.osm_roads import read_road_elements
from flexmap_tasks.formats.osm_roads_elements import RoadElements
from flexmap_tasks.ingest.surroundings import inside_by_signs, land_along
from flexmap_tasks.model.arrays import Bools, Floats, Ints, strings
from flexmap_tasks.model.maps import RoadNetwork
from flexmap_tasks.model.osm import Tags
from flexmap_tasks.model.source import Source


@stage("osm_roads")
def ingest_osm_roads(source: Source, params: OsmRoadsParams) -> RoadNetwork:
    """Every way vehicles drive on.

    The newest state of each element counts, deleted ones are absent. Of a way whose nodes are partly missing
    (cut at the extract's border) the longest run of present nodes is kept and `note` says so; a way without two
    places has no course and is left out. Neighbouring nodes at one place become one.

    Raises InputError when the file is no OpenStreetMap data, or incomplete by its server's own word.
    """
    elements = read_road_elements(source, frozenset(params.highways))
    if "error" in elements.remark.lower():
        rule = f'its server did not finish: "{elements.remark[:200]}"; fetch the extract again'
        raise InputError(source.name, rule)
    return road_network(elements)


def road_network(elements: RoadElements) -> RoadNetwork:
    """The roads among the elements, each with a course."""
    ids = np.array(sorted(i for i, way in elements.ways.items() if way.road), dtype=np.int64)
    ways = [elements.ways[i] for i in ids.tolist()]
    size = np.array([len(way.refs) for way in ways], dtype=np.int64)
    ref = np.fromiter(chain.from_iterable(way.refs for way in ways), dtype=np.int64, count=int(size.sum()))
    owner = np.repeat(np.arange(len(ways)), size)
    place, present = _find(elements.node_id, ref)
    lonlat = np.full((len(ref), 2), np.nan)
    lonlat[present] = elements.lonlat_deg[place[present]]
    keep = _one_per_place(owner, lonlat, _longest_run(owner, lonlat, present))
    left = np.bincount(owner[keep], minlength=len(ways))
    keep &= (left >= 2)[owner]
    rows = np.flatnonzero(left >= 2)
    absent = np.bincount(owner[~present], minlength=len(ways))
    chosen = [ways[i] for i in rows.tolist()]
    offset = np.concatenate([[0], np.cumsum(left[rows])]).astype(np.int64)
    built_up, open_land = land_along(offset, lonlat[keep], elements)
    return RoadNetwork(
        way_id=ids[rows],
        version=np.array([way.version for way in chosen], dtype=np.int64),
        timestamp=strings(way.timestamp for way in chosen),
        offset=offset,
        node_id=ref[keep],
        lonlat_deg=lonlat[keep],
        tags=Tags.of(dict(way.tags) for way in chosen),
        note=strings(
            f"{absent[i]} of its {size[i]} nodes are missing from the extract" if absent[i] else ""
            for i in rows.tolist()
        ),
        built_up=built_up,
        open_land=open_land,
        city_limit=inside_by_signs(offset, ref[keep], elements.city_limits),
    )


def _find(node_id: Ints, ref: Ints) -> tuple[Ints, Bools]:
    """Row of each reference in the ascending `node_id`, and whether it is there."""
    if len(node_id) == 0:
        return np.zeros(len(ref), dtype=np.int64), np.zeros(len(ref), dtype=bool)
    place = np.minimum(np.searchsorted(node_id, ref), len(node_id) - 1)
    return place, node_id[place] == ref


def _longest_run(owner: Ints, lonlat_deg: Floats, present: Bools) -> Bools:
    """Of each way the vertices of its longest run of present nodes, the first one of equals."""
    if present.all():
        return present.copy()
    starts = np.ones(len(owner), dtype=bool)
    starts[1:] = (owner[1:] != owner[:-1]) | (present[1:] != present[:-1])
    run = np.cumsum(starts) - 1
    step = np.zeros(len(owner))
    east = np.diff(lonlat_deg[:, 0]) * np.cos(np.radians(lonlat_deg[:-1, 1]))
    step[1:] = np.hypot(east, np.diff(lonlat_deg[:, 1]))
    step[starts | ~present] = 0.0
    length = np.round(np.bincount(run, weights=step), 9)  # a tenth of a millimetre: equals are equal
    first = np.flatnonzero(starts)
    length[~present[first]] = -1.0
    order = np.lexsort((first, -length, owner[first]))
    best = order[np.append(True, np.diff(owner[first][order]) != 0)]
    chosen = np.zeros(len(length), dtype=bool)
    chosen[best] = True
    kept: Bools = present & chosen[run]
    return kept


def _one_per_place(owner: Ints, lonlat_deg: Floats, keep: Bools) -> Bools:
    """Leave out vertices that repeat the place before them; an end of the way stays an end."""
    rows = np.flatnonzero(keep)
    if len(rows) < 2:
        return keep
    same = np.zeros(len(rows), dtype=bool)
    same[1:] = (owner[rows[1:]] == owner[rows[:-1]]) & (lonlat_deg[rows[1:]] == lonlat_deg[rows[:-1]]).all(
        axis=1
    )
    last = np.append(owner[rows[1:]] != owner[rows[:-1]], True)
    for i in np.flatnonzero(same & last).tolist():
        first = i
        while same[first]:
            first -= 1
        if (
            first > 0 and owner[rows[first - 1]] == owner[rows[i]]
        ):  # the way begins elsewhere: its end node stays
            same[first], same[i] = True, False
    keep = keep.copy()
    keep[rows[same]] = False
    return keep
