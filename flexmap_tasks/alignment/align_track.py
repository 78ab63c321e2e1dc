"""The SLAM trajectory moved by the warp."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.engine.stage import stage
from flexmap_tasks.geometry.turns import turned_about_z
from flexmap_tasks.model.alignment import Warp
from flexmap_tasks.model.tracks import Trajectory


@stage("aligned_track")
def align_track(slam: Trajectory, warp: Warp) -> Trajectory:
    """The poses in the fixed frame: positions moved, orientations turned as the plane turns there.

    The turn of a piecewise affine map is the rotation nearest to its linear part (polar decomposition).
    """
    linear = warp.jacobian(slam.xyz_m)
    yaw = np.arctan2(linear[:, 1, 0] - linear[:, 0, 1], linear[:, 0, 0] + linear[:, 1, 1])
    return Trajectory(warp.apply(slam.xyz_m), turned_about_z(slam.quaternion, yaw), slam.stamp_ns)
