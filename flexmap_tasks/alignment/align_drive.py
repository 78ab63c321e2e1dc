"""Another drive through the area, adjusted by itself in the map's frame."""

from __future__ import annotations

from collections.abc import Mapping

from flexmap_tasks.alignment.pose_graph import pose_graph
from flexmap_tasks.alignment.project import projected_track
from flexmap_tasks.config import DriveName, PoseGraphParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import AlignmentError, CoverageError
from flexmap_tasks.model.fusion import AlignedDrive
from flexmap_tasks.model.height_model import HeightModel
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import GnssFixes, Trajectory


@stage("aligned_drive")
def align_drive(
    slam: Trajectory,
    fixes: GnssFixes,
    projection: Projection,
    params: PoseGraphParams,
    height_model: HeightModel | None = None,
) -> AlignedDrive:
    """The drive's own pose graph with its own lever arm, clock, scale and noise, or why there is none.

    slam : localised in the frame of the map's SLAM; projection, height_model : the map's
    One drive of many that cannot be aligned is no reason to stop: it does not raise AlignmentError.
    """
    try:
        graph = pose_graph(
            slam, projected_track(fixes, projection), projection, None, None, params, height_model
        )
    except (AlignmentError, CoverageError) as error:
        return AlignedDrive(None, f"cannot be aligned: {error}", len(slam), len(fixes))
    return AlignedDrive(graph, "", len(slam), len(fixes))


@stage("gathered_drives")
def gather_drives(
    drive: AlignedDrive, others: Mapping[str, AlignedDrive] | None, params: DriveName
) -> dict[str, AlignedDrive]:
    """The other drives and one more, by name: what `fuse_drives` takes as one."""
    return {**(others or {}), params.name: drive}
