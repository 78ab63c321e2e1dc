"""Heights that can be trusted: altitudes withheld in blocks, heights adjusted again without them."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.alignment.altitudes import measured
from flexmap_tasks.alignment.antenna_heights import told_heights
from flexmap_tasks.alignment.pose_graph import checked_drive, first_stamp, no_control
from flexmap_tasks.alignment.solve import solve
from flexmap_tasks.alignment.vertical_graph import lifted
from flexmap_tasks.config import GraphHeldOutParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.geometry.polyline import arc_length_m
from flexmap_tasks.model.pose_graph import HeldOutHeights
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import GnssTrack, Trajectory

FEWEST = 3
"""Altitudes that must be left when a fold is withheld."""


@stage("heldout_heights")
def heldout_heights(
    slam: Trajectory, gnss: GnssTrack, projection: Projection, params: GraphHeldOutParams
) -> HeldOutHeights:
    """Adjusted heights less altitudes that they were not told of; none where the drive has no altitudes.

    Blocks are those of `heldout`, along SLAM's way. The plane stays as all of GNSS has it, and stretches that
    stand off are not asked.
    """
    if not (measured(gnss.xyz_m[:, 2]) == "").any():
        none = np.empty(0)
        return HeldOutHeights(np.empty(0, np.int64), none, none, none)
    drive = checked_drive(slam, params.graph)
    log_scale = float(np.log(projection.grid_scale_factor))
    solved = solve(drive, gnss, first_stamp(slam), log_scale, no_control(), params.graph)
    scale = float(np.exp(solved.solution.state.shared[2])) / projection.grid_scale_factor
    heights = told_heights(slam, gnss, drive, solved, params.graph.antenna_up_m, scale).heights
    nodes = np.column_stack([drive.pose[drive.node, :2], drive.z_m[drive.node]])
    along = arc_length_m(nodes[:, :2])[heights.node]
    fold = (along // params.block_m).astype(np.int64) % params.folds
    error, sigma = np.full(len(along), np.nan), np.full(len(along), np.nan)
    for k in range(params.folds):
        asked = (fold == k) & (heights.stretch < 0)
        told = np.flatnonzero(fold != k)
        if not asked.any() or len(told) < FEWEST:
            continue
        found = lifted(nodes, solved.known.revisit, scale, heights.take(told))
        node = heights.node[asked]
        up = found.lift_m[node] + (found.tilt[node] * heights.arm_m[asked]).sum(axis=1)
        error[asked], sigma[asked] = up - heights.misfit_m[asked], found.sigma_m[node]
    asked = np.isfinite(error)
    row = drive.node[heights.node[asked]].astype(np.int64)
    return HeldOutHeights(row, along[asked], error[asked], sigma[asked])
