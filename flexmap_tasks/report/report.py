"""One HTML file that shows what a run did: opens from disk, needs no network."""

from __future__ import annotations

import dataclasses

import numpy as np

from flexmap_tasks.config import ReportParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.model.alignment import ControlPoints, RigidMotion, Warp
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.conflation import LaneCheck, Matches, Transfers
from flexmap_tasks.model.maps import Findings, LaneletMap, RoadNetwork
from flexmap_tasks.model.pose_graph import GnssUse, HeldOut
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.quality import Quality
from flexmap_tasks.model.tracks import GnssTrack, Trajectory
from flexmap_tasks.report import decisions, drive, maps
from flexmap_tasks.report.embed import Json, Texts
from flexmap_tasks.report.html import page
from flexmap_tasks.report.review_items import review_items

REPORT_FILE = "report.html"
ROADS_MARGIN_M = 200.0
GRID = 9
"""Nodes per side of the grid from which the page interpolates latitude and longitude; 1 cm at 5 km."""


@stage("report")
def report(
    projection: Projection,
    gnss: GnssTrack,
    slam: Trajectory,
    warp: Warp,
    quality: Quality,
    control_points: ControlPoints | None,
    gnss_use: GnssUse | None,
    held_out: HeldOut | None,
    source_map: LaneletMap | None,
    final_map: LaneletMap | None,
    map_warp: Warp | None,
    roads: RoadNetwork | None,
    matches: Matches | None,
    transfers: Transfers | None,
    lane_check: LaneCheck | None,
    map_findings: Findings | None,
    transfer_findings: Findings | None,
    bundle_findings: Findings | None,
    params: ReportParams,
) -> dict[str, bytes]:
    """`report.html`.

    slam, source_map : in the SLAM frame; warp : from there to the map frame, in which everything is drawn
    final_map : the finished map; map_warp : the warp to draw it with where it stayed in the SLAM frame
    matches : pieces of the lanelets of `source_map`; transfers, lane_check : lanelets of `final_map`
    What the run did not make is None.
    """
    texts = Texts()
    start = Warp(warp.motion, None)
    final = maps.moved(final_map, map_warp) if final_map is not None and map_warp is not None else final_map
    findings = [f for f in (map_findings, transfer_findings, bundle_findings) if f is not None]
    data: Json = {
        "gnss": drive.gnss_of(gnss, gnss_use, texts),
        "slam": drive.slam_of(slam, gnss, warp, held_out),
        "points": drive.points_of(control_points, warp, texts),
        "sheet": drive.sheet_of(warp),
        "before": maps.map_of(maps.moved(source_map, start), texts) if source_map is not None else None,
        "after": maps.map_of(final, texts) if final is not None else None,
        "matches": decisions.matches_of(matches, texts) if matches is not None else None,
        "transfers": decisions.transfers_of(transfers, texts) if transfers is not None else None,
        "lane_check": decisions.lane_check_of(lane_check, texts) if lane_check is not None else None,
        "review": decisions.review_of(review_items(matches, transfers, lane_check), texts),
        "findings": decisions.findings_of(findings, final, texts),
        "quality": [dataclasses.asdict(m) for m in quality.measures],
        "motion": _motion(warp.motion),
    }
    near = np.concatenate([gnss.xyz_m[:, :2], *([final.xyz_m[:, :2]] if final is not None else [])])
    if roads is not None:
        xy_m = projection.to_xy_m(roads.lonlat_deg)
        data["roads"], _ = maps.roads_of(roads, xy_m, near, ROADS_MARGIN_M, texts)
        if matches is not None and source_map is not None:
            links = decisions.links_between(matches, maps.moved(source_map, warp), roads, xy_m)
            data["links"] = decisions.links_of(links)
    data["frame"] = frame_of(projection, near)
    data["map"] = params.map
    data["texts"] = texts.table()
    return {REPORT_FILE: page(params.map, data)}


def _motion(motion: RigidMotion) -> Json:
    return {
        "angle_deg": float(np.degrees(motion.angle_rad)),
        "x_m": float(motion.translation_m[0]),
        "y_m": float(motion.translation_m[1]),
        "rmse_m": motion.rmse_m,
    }


def frame_of(projection: Projection, near: Floats) -> Json:
    """The projection, and a grid of longitude and latitude over everything that is drawn."""
    known = near[np.isfinite(near).all(axis=1)]
    low, high = (known.min(axis=0), known.max(axis=0)) if len(known) else (np.zeros(2), np.zeros(2))
    low, high = low - ROADS_MARGIN_M, high + ROADS_MARGIN_M
    x, y = (np.linspace(low[i], high[i], GRID) for i in (0, 1))
    lonlat_deg = projection.to_lonlat_deg(np.column_stack([np.tile(x, GRID), np.repeat(y, GRID)]))
    return {
        **dataclasses.asdict(projection),
        "zone": projection.zone,
        "low_m": low.tolist(),
        "high_m": high.tolist(),
        "grid": GRID,
        "lonlat_deg": [[round(v, 9) for v in row] for row in lonlat_deg.tolist()],
    }
