"""The DAG: one recording becomes one map release. Reads like the paper; runners give it meaning."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from flexmap_tasks.alignment.align_track import align_track
from flexmap_tasks.alignment.control_points import control_points
from flexmap_tasks.alignment.project import project_utm
from flexmap_tasks.alignment.rubber_sheet import rigid_warp, rubber_sheet
from flexmap_tasks.alignment.umeyama import umeyama
from flexmap_tasks.conflation.collapse import collapse
from flexmap_tasks.conflation.match import match
from flexmap_tasks.conflation.place_roads import place_roads
from flexmap_tasks.conflation.transfer import transfer
from flexmap_tasks.config import FlexMapConfig, OsmInput, Params
from flexmap_tasks.engine.graph import Graph, Ref, SourceRef
from flexmap_tasks.evaluation.quality import evaluate
from flexmap_tasks.georeferencing.bundle import georeference
from flexmap_tasks.georeferencing.cloud import merge_tile, pointcloud_metadata, tile_extent, warp_tile
from flexmap_tasks.georeferencing.map import georeference_map
from flexmap_tasks.ingest.gnss import ingest_gnss
from flexmap_tasks.ingest.lanelet_map import ingest_lanelet_map
from flexmap_tasks.ingest.osm_fetch import fetch_osm, track_box
from flexmap_tasks.ingest.osm_roads import ingest_osm_roads
from flexmap_tasks.ingest.point_cloud import ingest_point_cloud
from flexmap_tasks.ingest.slam import ingest_slam


def map_update(config: FlexMapConfig) -> Graph:
    """Everything one map update does, and what its release holds."""
    graph = Graph()
    fixes = graph.run(ingest_gnss, only(config.gnss), source=SourceRef(config.gnss.file))
    slam = graph.run(ingest_slam, only(config.slam), source=SourceRef(config.slam.file))
    return graph


def only(settings: Params) -> Params:
    """The settings of an input without its path: what the stage gets."""
    base = type(settings).__mro__[1]
    return base.model_validate({name: getattr(settings, name) for name in base.model_fields})
