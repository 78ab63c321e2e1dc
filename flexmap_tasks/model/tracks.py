"""What a drive leaves behind: GNSS fixes, SLAM poses, and the GNSS track in the map frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.model.arrays import Bools, Floats, Ints, require
from flexmap_tasks.model.projection import Projection

STATUS_UNKNOWN = -2
"""No status was given (text files); the others are sensor_msgs/NavSatStatus: -1 none, 0 fix, 1 SBAS, 2 GBAS."""

STATUS_NONE = -1
"""The receiver had no fix; such a row may lack its position."""


def rows_in_time_order(stamp_ns: Ints) -> Ints:
    """Rows sorted by stamp; of rows with exactly the same stamp only the first one in the recording."""
    _, first = np.unique(stamp_ns, return_index=True)
    return first.astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class GnssFixes:
    """GNSS fixes in the order they were recorded.

    lon_deg, lat_deg : (n,) float64, WGS84 degrees
    alt_m : (n,) float64, metres as recorded (ROS: above the ellipsoid), NaN where none was given
    sigma_east_m, sigma_north_m, sigma_up_m : (n,) float64, one standard deviation, NaN where unknown
    status : (n,) int64, NavSatStatus or STATUS_UNKNOWN
    stamp_ns : (n,) int64 since the epoch, or None when the recording has no time
    """

    lon_deg: Floats
    lat_deg: Floats
    alt_m: Floats
    sigma_east_m: Floats
    sigma_north_m: Floats
    sigma_up_m: Floats
    status: Ints
    stamp_ns: Ints | None

    def __len__(self) -> int:
        return len(self.lon_deg)

    def __post_init__(self) -> None:
        n = len(self.lon_deg)
        columns = (
            self.lat_deg,
            self.alt_m,
            self.sigma_east_m,
            self.sigma_north_m,
            self.sigma_up_m,
            self.status,
        )
        require(all(len(c) == n for c in columns), "GNSS columns differ in length")
        require(self.stamp_ns is None or len(self.stamp_ns) == n, "GNSS stamps differ in length")


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses in the order they were driven.

    xyz_m : (n, 3) float64, metres, in the SLAM frame or, after alignment, in the map frame
    quaternion : (n, 4) float64, x y z w, unit length, body to frame
    stamp_ns : (n,) int64 since the epoch, or None when the recording has no time
    """

    xyz_m: Floats
    quaternion: Floats
    stamp_ns: Ints | None

    def __len__(self) -> int:
        return len(self.xyz_m)

    def __post_init__(self) -> None:
        n = len(self.xyz_m)
        require(self.xyz_m.shape == (n, 3), "poses need x, y, z")
        require(self.quaternion.shape == (n, 4), "poses need a quaternion each")
        require(bool(np.isfinite(self.xyz_m).all()), "poses must be finite")
        require(self.stamp_ns is None or len(self.stamp_ns) == n, "pose stamps differ in length")


@dataclass(frozen=True, slots=True, eq=False)
class GnssTrack:
    """GNSS fixes in the map frame, fixes without a position left out.

    xyz_m : (n, 3) float64, metres in the map frame; z is NaN where no altitude was given
    sigma_m : (n, 3) float64, east, north, up; NaN where unknown
    status : (n,) int64, NavSatStatus or STATUS_UNKNOWN
    row : (n,) int64, row of the fix in the recording
    observed : (n,) bool, False where the straight step to this fix crosses a jump or an outage
    stamp_ns : (n,) int64 since the epoch, or None
    """

    xyz_m: Floats
    sigma_m: Floats
    status: Ints
    row: Ints
    observed: Bools
    stamp_ns: Ints | None

    def __len__(self) -> int:
        return len(self.xyz_m)


@dataclass(frozen=True, slots=True, eq=False)
class Projected:
    """The GNSS track together with the projection that made it."""

    gnss_track: GnssTrack
    projection: Projection
