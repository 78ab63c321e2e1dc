"""What the pose graph found."""

from __future__ import annotations

from dataclasses import dataclass

from flexmap_tasks.model.alignment import RigidMotion
from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings


@dataclass(frozen=True, slots=True, eq=False)
class GraphNodes:
    """The adjusted poses, thinned to one every few metres.

    row : (n,) int64, row of the SLAM trajectory
    source_xyz_m : (n, 3) float64, where SLAM put the pose; source_yaw_rad : (n,) its heading there
    xyz_m : (n, 3) float64, where it lies in the map frame; yaw_rad : (n,) its heading there
    sigma_m : (n, 3) float64, predicted standard deviation: east, north, up (NaN without altitude)
    covariance_en_m2 : (n,) float64, of east and north; sigma_yaw_rad : (n,) float64
    tilt_xy_rad : (n, 2) float64, roll and pitch corrected: slope added along x and y of the SLAM frame
    sigma_tilt_rad : (n,) float64, its standard deviation per axis (NaN without altitude)
    """

    row: Ints
    source_xyz_m: Floats
    source_yaw_rad: Floats
    xyz_m: Floats
    yaw_rad: Floats
    sigma_m: Floats
    covariance_en_m2: Floats
    sigma_yaw_rad: Floats
    tilt_xy_rad: Floats
    sigma_tilt_rad: Floats

    def __len__(self) -> int:
        return len(self.row)


@dataclass(frozen=True, slots=True)
class GraphFigures:
    """What was estimated beside the poses.

    timed : whether time stamps tied GNSS to SLAM; otherwise only the distance across the track counts
    lever_forward_m, lever_left_m : antenna seen from the SLAM body, along and left of the direction of travel
    scale : map metres per SLAM metre; clock_offset_s : SLAM stamp minus GNSS stamp of one moment
    sigma_* : their predicted standard deviations
    noise_along_m, noise_across_m, noise_yaw_rad : of SLAM over 3 m; noise_gnss : factor on the stated sigmas
    revisit_edges : pairs of poses on different passes of one place; their share that the graph agrees with
    revisit_disagreement_m : what nine of ten passes stay under: how far the graph has a pass from where SLAM saw it
    from another pass of the same place; 0 without such places
    scale_up : metres of height per SLAM metre, 1 where heights are as SLAM has them
    noise_climb_m, noise_tilt_rad : of SLAM's height, and of its roll and pitch, over 3 m; noise_altitude : factor on
    the stated sigmas of altitudes; None without altitudes
    height : what heights are: "altitude" as GNSS states them, "SLAM", or "model" and the vertical datum of that
    height_share : share of the nodes at which an altitude or the model tells the height
    """

    timed: bool
    lever_forward_m: float
    lever_left_m: float
    scale: float
    clock_offset_s: float
    sigma_lever_forward_m: float
    sigma_lever_left_m: float
    sigma_scale: float
    sigma_clock_offset_s: float
    noise_along_m: float
    noise_across_m: float
    noise_yaw_rad: float
    noise_gnss: float
    revisit_edges: int
    revisit_agreement: float
    revisit_disagreement_m: float
    scale_up: float
    noise_climb_m: float | None
    noise_tilt_rad: float | None
    noise_altitude: float | None
    height: str
    height_share: float


@dataclass(frozen=True, slots=True, eq=False)
class GnssUse:
    """Every fix of the GNSS track, and what became of it.

    row : (n,) int64, row in the recording; used : (n,) bool
    reason : (n,) str, why it was left out, "" where it was used
    residual_m : (n,) float64, distance from the adjusted antenna track where used, else NaN
    altitude_used : (n,) bool; altitude_reason : (n,) str, why the altitude of a fix in use was left out, or that its
    stretch counts with an unknown offset; altitude_residual_m : (n,) float64, adjusted height less altitude where it
    was used, else NaN
    """

    row: Ints
    used: Bools
    reason: Strings
    residual_m: Floats
    altitude_used: Bools
    altitude_reason: Strings
    altitude_residual_m: Floats

    def __len__(self) -> int:
        return len(self.row)


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraph:
    """The adjusted drive.

    motion : the robust rigid start; nodes, figures, gnss_use : see there
    """

    motion: RigidMotion
    nodes: GraphNodes
    figures: GraphFigures
    gnss_use: GnssUse


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Distances from GNSS that was withheld, one row per node that could be asked.

    row : (n,) int64, row of the SLAM trajectory; along_m : (n,) float64, place on the GNSS line
    distance_m : (n,) float64, antenna to the withheld line on the same pass
    sigma_m : (n,) float64, what the solution itself predicted (of the body, per axis)
    """

    row: Ints
    along_m: Floats
    distance_m: Floats
    sigma_m: Floats

    def __len__(self) -> int:
        return len(self.row)


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutHeights:
    """Adjusted heights of the antenna less altitudes that were withheld, one row per altitude that could be asked.

    row : (n,) int64, row of the SLAM trajectory; along_m : (n,) float64, place on SLAM's way
    error_m : (n,) float64; sigma_m : (n,) float64, what the solution itself predicted of the body's height
    """

    row: Ints
    along_m: Floats
    error_m: Floats
    sigma_m: Floats

    def __len__(self) -> int:
        return len(self.row)
