"""The lanelet map moved into the map frame."""

from __future__ import annotations

from dataclasses import replace

from flexmap_tasks.engine.stage import stage
from flexmap_tasks.model.alignment import Warp
from flexmap_tasks.model.maps import LaneletMap


@stage("georeferenced_map")
def georeference_map(lanelet_map: LaneletMap, warp: Warp) -> LaneletMap:
    """Every node moved by the warp that moved the track; the document still says what the file said.

    Coordinates in attributes and tags are written from `xyz_m` when the map is.
    """
    return replace(lanelet_map, xyz_m=warp.apply_drawn(lanelet_map.xyz_m))
