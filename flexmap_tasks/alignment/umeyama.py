"""The rigid start: both tracks sampled evenly over their length, then Umeyama's best motion."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.config import UmeyamaParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.geometry.polyline import resample_evenly, steps_m
from flexmap_tasks.geometry.rigid import fit_planar_motion
from flexmap_tasks.model.alignment import RigidMotion
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import GnssTrack, Trajectory

MIN_LENGTH_M = 1.0
"""A track shorter than this stands still: its direction is noise."""

MAX_LENGTH_RATIO = 2.0
"""Tracks of one drive differ in length by scatter and outages, not by this factor."""

MAX_RMSE_SHARE = 0.25
"""What may be left after the fit, as a share of the track's own spread around its middle."""


@stage("alignment")
def umeyama(slam: Trajectory, gnss: GnssTrack, projection: Projection, params: UmeyamaParams) -> RigidMotion:
    """The motion from the SLAM frame into the map frame; rotation and translation, scale only reported.

    Raises AlignmentError when a track has fewer than three distinct places or stands still, or when the
    two cannot be one drive.
    """
    slam_xy, gnss_xy = slam.xyz_m[:, :2], gnss.xyz_m[:, :2]
    lengths = _check(slam_xy, "SLAM trajectory"), _check(gnss_xy, "GNSS track")
    _check_lengths(*lengths)
    grid_scale = projection.grid_scale_factor if params.grid_scale else 1.0
    source = grid_scale * resample_evenly(slam_xy, params.points)
    target = resample_evenly(gnss_xy, params.points)
    fit = fit_planar_motion(source, target)
    spread = float(np.sqrt(((target - target.mean(axis=0)) ** 2).sum(axis=1).mean()))
    if fit.rmse > MAX_RMSE_SHARE * spread:
        raise AlignmentError(
            "tracks",
            f"SLAM and GNSS cannot be one drive: after the best rigid motion {fit.rmse:.1f} m remain, the track "
            f"itself spreads {spread:.1f} m around its middle; check that both files are of the same drive "
            "and run in the same direction",
        )
    return RigidMotion(fit.rotation, fit.translation, grid_scale, fit.scale, fit.rmse)


def _check(xy_m: Floats, name: str) -> float:
    """Length of the track in metres."""
    distinct = len(np.unique(xy_m, axis=0))
    if distinct < 3:
        raise AlignmentError(name, f"needs at least 3 distinct places, found {distinct}")
    length = float(steps_m(xy_m).sum())
    extent = float(np.hypot(*np.ptp(xy_m, axis=0)))
    if extent < MIN_LENGTH_M:
        raise AlignmentError(
            name, f"stands still: all {len(xy_m)} places lie within {extent:.2f} m; a drive is needed"
        )
    return length


def _check_lengths(slam_m: float, gnss_m: float) -> None:
    if max(slam_m, gnss_m) > MAX_LENGTH_RATIO * min(slam_m, gnss_m):
        raise AlignmentError(
            "tracks",
            f"SLAM and GNSS cannot be one drive: the SLAM trajectory is {slam_m:.1f} m long, the GNSS track "
            f"{gnss_m:.1f} m; lengths may differ by a factor of {MAX_LENGTH_RATIO:g}",
        )
