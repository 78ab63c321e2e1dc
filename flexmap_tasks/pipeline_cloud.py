"""The point cloud's part of the DAG."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from flexmap_tasks.config import (
    CloudCheckParams,
    FlexMapConfig,
    PcdParams,
    PointCloudParams,
    ScanParams,
    ScanTilesParams,
    SlamParams,
)
from flexmap_tasks.engine.graph import Graph, Ref, SourceRef
from flexmap_tasks.georeferencing.cloud import (
    check_cloud,
    merge_tile,
    pointcloud_metadata,
    tile_extent,
    warp_tile,
)
from flexmap_tasks.georeferencing.frame import cloud_frame, projector_file
from flexmap_tasks.ingest.point_cloud import ingest_point_cloud
from flexmap_tasks.ingest.scans import ingest_scans
from flexmap_tasks.pipeline_parts import Aligned, Cloud, only


def ingest_cloud(graph: Graph, config: FlexMapConfig, slam: Ref) -> Ref | None:
    """Tiles of the SLAM frame, from a file or from scans; None where the configuration has no cloud."""
    cloud = config.point_cloud
    if cloud is None:
        return None
    params, source = only(PointCloudParams, cloud), SourceRef(cloud.file)
    if not cloud.has_scans:
        return graph.run(ingest_point_cloud, params, source=source)
    scans = ScanTilesParams(tiles=params, scans=only(ScanParams, cloud), poses=only(SlamParams, config.slam))
    return graph.run(ingest_scans, scans, source=source, slam=slam, poses=SourceRef(config.slam.file))


def georeference_cloud(
    graph: Graph, config: FlexMapConfig, tiles: Ref, aligned: Aligned, bundle: Ref | None
) -> Cloud:
    """The tiles moved into the map frame; `bundle` is the lanelet map's files, if there is one."""
    assert config.point_cloud is not None  # noqa: S101 - there are tiles
    params, moved = only(PointCloudParams, config.point_cloud), config.alignment.master == "gnss"

    # A point of a scan follows the poses that saw it, wherever they were: the whole warp concerns its tile.
    def touched(key: str, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """The part of the warp that moves one tile."""
        return {"warp": values["warp"].restrict(tile_extent(key, params))} if "warp" in values else {}

    frame = None
    if moved and config.georeference.projector == "MGRS":
        frame = graph.run(cloud_frame, config.georeference, projection=aligned.projection, bundle=bundle)
    warped = graph.run_each(
        warp_tile,
        "tile",
        params,
        tile=tiles.field("tiles"),
        warp=aligned.warp if moved else None,
        frame=frame,
        narrow=None if config.point_cloud.has_scans else touched,
    )
    merged = graph.run_each(
        merge_tile, "parts", only(PcdParams, config.point_cloud), parts=warped.transpose()
    )
    graph.publish("pointcloud_map/", merged)
    metadata = graph.run(pointcloud_metadata, params, tiles=merged.keys())
    graph.publish(".", metadata)
    if bundle is None and moved:
        graph.publish(".", graph.run(projector_file, config.georeference, projection=aligned.projection))
    found = graph.run(
        check_cloud,
        only(CloudCheckParams, config.point_cloud),
        found=tiles.field("findings"),
        index=tiles.field("index"),
        slam=aligned.slam,
        tiles=merged.keys(),
    )
    graph.publish("cloud_findings.parquet", found)
    return Cloud(metadata, merged.keys(), found)
