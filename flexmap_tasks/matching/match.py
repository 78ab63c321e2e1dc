"""Which way of OpenStreetMap every metre of every lane belongs to."""

from __future__ import annotations

from flexmap_tasks.config import MatchParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.matching.buffers.match_by_buffers import match_by_buffers
from flexmap_tasks.matching.paths.match_by_paths import match_by_paths
from flexmap_tasks.model.conflation import Centerlines, Matched
from flexmap_tasks.model.maps import LaneletMap, PlacedRoads


@stage("matches")
def match(
    centerlines: Centerlines, lanelet_map: LaneletMap, roads: PlacedRoads, params: MatchParams
) -> Matched:
    """Match the collapsed map to the roads by `params.method`.

    Both in the same frame. Every metre of every member of `centerlines` is in exactly one row of the result.
    """
    if params.method == "buffer_growing":
        return match_by_buffers(centerlines, lanelet_map, roads, params)
    return match_by_paths(centerlines, lanelet_map, roads, params.path)
