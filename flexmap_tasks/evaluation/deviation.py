"""How far the SLAM track lies from the GNSS line, the paper's measure of an alignment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.geometry.polyline import nearest_on_polyline
from flexmap_tasks.model.arrays import Bools, Floats
from flexmap_tasks.model.tracks import GnssTrack

TIE_M = 1e-6
"""A pose as near to an observed step as to an unobserved one has GNSS."""


@dataclass(frozen=True, slots=True, eq=False)
class Deviation:
    """Distance of every pose to the line through all fixes, straight across outages.

    distance_m : (n,) float64; valid : (n,) bool, the nearest step of the line was observed
    """

    distance_m: Floats
    valid: Bools


def deviation(poses_m: Floats, gnss: GnssTrack) -> Deviation:
    """Distances in the plane of (n, 2) or (n, 3) poses to the GNSS line; all NaN when it has fewer than two fixes.

    The line takes the straight chord across an outage as the truth, which it is not: figures over all poses
    compare with the paper's, figures over valid poses say more.
    """
    line, observed = gnss.xyz_m[:, :2], gnss.observed[1:]
    distance = nearest_on_polyline(poses_m[:, :2], line).distance_m
    if observed.all():
        return Deviation(distance, np.isfinite(distance))
    to_observed = nearest_on_polyline(poses_m[:, :2], line, observed).distance_m
    return Deviation(distance, to_observed <= distance + TIE_M)
