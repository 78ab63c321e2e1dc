"""How far the SLAM track lies from the GNSS line, the paper's measure of an alignment."""

from __future__ import annotations

from dataclasses import dataclass

from flexmap_tasks.geometry.polyline import distance_and_seen
from flexmap_tasks.model.arrays import Bools, Floats
from flexmap_tasks.model.tracks import GnssTrack


@dataclass(frozen=True, slots=True, eq=False)
class Deviation:
    """Distance of every pose to the line through all fixes, straight across outages.

    distance_m : (n,) float64; valid : (n,) bool, has GNSS beside it: see `distance_and_seen`
    """

    distance_m: Floats
    valid: Bools


def deviation(poses_m: Floats, gnss: GnssTrack) -> Deviation:
    """Distances in the plane of (n, 2) or (n, 3) poses to the GNSS line; all NaN when it has fewer than two fixes.

    The line takes the straight chord across an outage as the truth, which it is not: figures over all poses
    compare with the paper's, figures over valid poses say more.
    """
    return Deviation(*distance_and_seen(poses_m[:, :2], gnss.xyz_m[:, :2], gnss.observed[1:]))
