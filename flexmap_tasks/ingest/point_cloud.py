"""A point cloud file of any size, cut into tiles of the SLAM frame."""

from __future__ import annotations

from flexmap_tasks.config import PointCloudParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.cloud_reader import open_cloud
from flexmap_tasks.formats.pcd import PcdReader
from flexmap_tasks.ingest.tiling import tile_cloud
from flexmap_tasks.model.clouds import Tiles
from flexmap_tasks.model.source import Source


@stage("tiles")
def ingest_point_cloud(source: Source, params: PointCloudParams) -> Tiles:
    """Read a PCD, LAS, LAZ or COPC file into tiles; points keep the order of the file within their tile.

    Raises InputError when the file breaks its format or holds no usable point.
    """
    reader = open_cloud(source)
    if isinstance(reader, PcdReader) and reader.moved_viewpoint and params.viewpoint == "refuse":
        raise InputError(
            source.name,
            f"VIEWPOINT is {' '.join(f'{v:g}' for v in reader.header.viewpoint)}; points are expected in the SLAM "
            "frame with VIEWPOINT 0 0 0 1 0 0 0; if they are, set point_cloud.viewpoint to ignore",
            "header",
        )
    return tile_cloud(reader, source.name, params)
