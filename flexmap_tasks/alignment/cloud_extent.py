"""The box of a tiled point cloud: all that the rubber sheet needs to know of it."""

from __future__ import annotations

from flexmap_tasks.engine.stage import stage
from flexmap_tasks.model.alignment import Extent
from flexmap_tasks.model.clouds import TileIndex


@stage("cloud_extent")
def cloud_extent(index: TileIndex) -> Extent:
    """Box around all points, metres, in the SLAM frame.

    Being a stage of its own, it keeps a change inside the cloud from touching the warp.
    """
    return Extent(
        float(index.x_min_m.min()),
        float(index.y_min_m.min()),
        float(index.x_max_m.max()),
        float(index.y_max_m.max()),
    )
