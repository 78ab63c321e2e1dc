"""Heights of the nodes, and what became of every altitude."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flexmap_tasks.alignment.antenna_heights import Told, told_heights
from flexmap_tasks.alignment.drive import Drive
from flexmap_tasks.alignment.solve import Solved
from flexmap_tasks.alignment.vertical_graph import ALTITUDE, CLIMB, TILT, Lifted, lifted
from flexmap_tasks.config import PoseGraphParams
from flexmap_tasks.model.arrays import Bools, Floats, Strings
from flexmap_tasks.model.tracks import GnssTrack, Trajectory


class Raised(NamedTuple):
    """lift_m, tilt, sigma_m, sigma_tilt : of the nodes, see `Lifted`; zero and NaN where no altitude tells
    scale : metres of height per SLAM metre

    altitude_used, altitude_reason, altitude_residual_m : of all fixes, see `GnssUse`; noise_* : see `GraphFigures`
    """

    lift_m: Floats
    tilt: Floats
    sigma_m: Floats
    sigma_tilt: Floats
    altitude_used: Bools
    altitude_reason: Strings
    altitude_residual_m: Floats
    scale: float = 1.0
    noise_climb_m: float | None = None
    noise_tilt_rad: float | None = None
    noise_altitude: float | None = None


def raised(
    slam: Trajectory,
    gnss: GnssTrack,
    drive: Drive,
    solved: Solved,
    grid_scale: float,
    params: PoseGraphParams,
) -> Raised:
    """Lift and tilt of every node after the plane is adjusted; heights stay as SLAM has them where nothing tells.

    grid_scale : metres of the map's plane per metre on the ground, which heights know nothing of
    """
    scale = float(np.exp(solved.solution.state.shared[2])) / grid_scale
    told = told_heights(slam, gnss, drive, solved, params.antenna_up_m, scale)
    n, nodes = len(drive.node), drive.pose[drive.node]
    if len(told.fix) == 0:
        unknown = np.full(n, np.nan)
        return _with_altitudes(
            Lifted(np.zeros(n), np.zeros((n, 2)), unknown, unknown, np.empty(0), np.empty(0)), told
        )
    xyz_m = np.column_stack([nodes[:, :2], drive.z_m[drive.node]])
    return _with_altitudes(lifted(xyz_m, solved.known.revisit, scale, told.heights), told)._replace(
        scale=scale
    )


def _with_altitudes(found: Lifted, told: Told) -> Raised:
    used, residual = np.zeros(len(told.reason), bool), np.full(len(told.reason), np.nan)
    used[told.fix] = True
    residual[told.fix] = found.residual_m
    out = Raised(*found[:4], used, told.reason, residual)
    if len(told.fix) == 0:
        return out
    noise = found.scale[[CLIMB, TILT, ALTITUDE]].tolist()
    return out._replace(noise_climb_m=noise[0], noise_tilt_rad=noise[1], noise_altitude=noise[2])
