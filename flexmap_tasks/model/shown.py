"""What report and layers are drawn from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from flexmap_tasks.model.alignment import JudgedPoints, Warp
from flexmap_tasks.model.conflation import LaneCheck, Matches, RoadChanges, Transfers
from flexmap_tasks.model.maps import Findings, LaneletMap, RoadNetwork
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import GnssTrack, Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """Values of one run; None is what it did not make. A stage is fed with them field by field.

    slam, source_map : in the SLAM frame; warp : from there to the map frame, in which everything is drawn
    final_map : the finished map; map_warp : the warp to draw it with where it stayed in the SLAM frame
    matches : pieces of the lanelets of `source_map`; transfers, lane_check : lanelets of `final_map`
    changes : of the matched roads since another date of OpenStreetMap
    """

    gathered: ClassVar[bool] = True

    projection: Projection
    gnss: GnssTrack
    slam: Trajectory
    warp: Warp
    control_points: JudgedPoints | None
    source_map: LaneletMap | None
    final_map: LaneletMap | None
    map_warp: Warp | None
    roads: RoadNetwork | None
    matches: Matches | None
    transfers: Transfers | None
    lane_check: LaneCheck | None
    changes: RoadChanges | None
    drive_findings: Findings | None
    map_findings: Findings | None
    transfer_findings: Findings | None
    bundle_findings: Findings | None
    cloud_findings: Findings | None
