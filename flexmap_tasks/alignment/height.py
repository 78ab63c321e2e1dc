"""Heights of the nodes, and what became of every altitude."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flexmap_tasks.alignment.antenna_heights import Told, told_heights
from flexmap_tasks.alignment.drive import Drive
from flexmap_tasks.alignment.ground_heights import ground_heights
from flexmap_tasks.alignment.solve import Solved
from flexmap_tasks.alignment.vertical_graph import ALTITUDE, CLIMB, TILT, Heights, Lifted, lifted
from flexmap_tasks.config import PoseGraphParams
from flexmap_tasks.model.arrays import Bools, Floats, Strings
from flexmap_tasks.model.height_model import HeightModel
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import GnssTrack, Trajectory


class Raised(NamedTuple):
    """lift_m, tilt, sigma_m, sigma_tilt : of the nodes, see `Lifted`; zero and NaN where nothing tells

    altitude_used, altitude_reason, altitude_residual_m : of all fixes, see `GnssUse`
    height, share, scale, noise_* : see `GraphFigures`
    """

    lift_m: Floats
    tilt: Floats
    sigma_m: Floats
    sigma_tilt: Floats
    altitude_used: Bools
    altitude_reason: Strings
    altitude_residual_m: Floats
    height: str = "SLAM"
    share: float = 0.0
    scale: float = 1.0
    noise_climb_m: float | None = None
    noise_tilt_rad: float | None = None
    noise_altitude: float | None = None


def raised(
    slam: Trajectory,
    gnss: GnssTrack,
    drive: Drive,
    solved: Solved,
    projection: Projection,
    params: PoseGraphParams,
    model: HeightModel | None,
) -> Raised:
    """Lift and tilt of every node after the plane is adjusted; heights stay as SLAM has them where nothing tells."""
    if params.height == "keep":
        return _kept(drive, gnss)
    # the plane's scale holds that of the grid, which heights know nothing of
    scale = float(np.exp(solved.solution.state.shared[2])) / projection.grid_scale_factor
    if params.height == "model":
        if model is None:
            raise ValueError("a height model is needed")
        heights = ground_heights(drive, solved.solution.state, model, projection, params.body_up_m, scale)
        found = _lifted(drive, solved, scale, heights)
        return _with(found, _kept(drive, gnss), heights, scale)._replace(
            height=f"model, vertical datum {model.vertical_datum}"
        )
    told = told_heights(slam, gnss, drive, solved, params.antenna_up_m, scale)
    without = _kept(drive, gnss)._replace(altitude_reason=told.reason)
    if len(told.fix) == 0:
        return without
    found = _lifted(drive, solved, scale, told.heights)
    return _with_altitudes(_with(found, without, told.heights, scale), told, found)


def _kept(drive: Drive, gnss: GnssTrack) -> Raised:
    n, fixes = len(drive.node), len(gnss)
    unknown = np.full(n, np.nan)
    none = np.full(fixes, "", dtype=object)
    return Raised(
        np.zeros(n), np.zeros((n, 2)), unknown, unknown, np.zeros(fixes, bool), none, np.full(fixes, np.nan)
    )


def _lifted(drive: Drive, solved: Solved, scale: float, heights: Heights) -> Lifted:
    xyz_m = np.column_stack([drive.pose[drive.node, :2], drive.z_m[drive.node]])
    return lifted(xyz_m, solved.known.revisit, scale, heights)


def _with(found: Lifted, other: Raised, heights: Heights, scale: float) -> Raised:
    noise = found.scale[[CLIMB, TILT, ALTITUDE]].tolist()
    return other._replace(
        lift_m=found.lift_m,
        tilt=found.tilt,
        sigma_m=found.sigma_m,
        sigma_tilt=found.sigma_tilt,
        share=len(np.unique(heights.node[heights.stretch < 0])) / len(found.lift_m),
        scale=scale,
        noise_climb_m=noise[0],
        noise_tilt_rad=noise[1],
        noise_altitude=noise[2],
    )


def _with_altitudes(found: Raised, told: Told, lift: Lifted) -> Raised:
    used, residual = found.altitude_used.copy(), found.altitude_residual_m.copy()
    used[told.fix] = True
    residual[told.fix] = lift.residual_m
    return found._replace(altitude_used=used, altitude_residual_m=residual, height="altitude")
