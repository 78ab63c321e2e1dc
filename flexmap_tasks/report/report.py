"""One HTML file that shows what a run did: opens from disk, needs no network."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from flexmap_tasks.config import ReportParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.model.alignment import RigidMotion, Warp
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.maps import LaneletMap
from flexmap_tasks.model.pose_graph import GnssUse, GraphNodes, HeldOut
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.quality import Quality
from flexmap_tasks.model.review import Decided
from flexmap_tasks.model.shown import Shown
from flexmap_tasks.model.tracks import GnssTrack, Trajectory
from flexmap_tasks.report import decisions, drive, maps
from flexmap_tasks.report.decided import decided_rows
from flexmap_tasks.report.embed import Json, Texts
from flexmap_tasks.report.html import page
from flexmap_tasks.report.review_items import review_items

REPORT_FILE = "report.html"
ROADS_MARGIN_M = 200.0
GRID = 9
"""Nodes per side of the grid from which the page interpolates latitude and longitude; 1 cm at 5 km."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """How the run was judged; None is what it did not make. A stage is fed with it field by field.

    antenna : where the alignment has the antenna at each of `graph_nodes`; decided : by people, before this run
    """

    gathered: ClassVar[bool] = True

    quality: Quality
    gnss_use: GnssUse | None
    held_out: HeldOut | None
    graph_nodes: GraphNodes | None
    antenna: Trajectory | None
    decided: Decided | None


@stage("report")
def report(shown: Shown, judged: Judged, params: ReportParams) -> dict[str, bytes]:
    """`report.html`."""
    return {REPORT_FILE: page(params.map, report_data(shown, judged, params))}


def report_data(shown: Shown, judged: Judged, params: ReportParams) -> Json:
    """All that the page is told."""
    texts = Texts()
    final = final_map_of(shown)
    told = ("drive", "map", "transfer", "bundle", "cloud")
    found = [f for name in told if (f := getattr(shown, f"{name}_findings")) is not None]
    changes = judged.decided.changes if judged.decided else None
    items = review_items(shown.matches, shown.transfers, shown.lane_check, shown.changes, changes)
    near = np.concatenate([shown.gnss.xyz_m[:, :2], *([final.xyz_m[:, :2]] if final is not None else [])])
    return {
        **drive_data(shown.projection, shown.gnss, shown.slam, shown.warp, texts, near, judged),
        **_conflation_data(shown, near, texts),
        "points": drive.points_of(shown.control_points, shown.warp, texts),
        "before": start_map(shown.source_map, shown.warp, texts),
        "after": maps.map_of(final, texts) if final is not None else None,
        "review": decisions.review_of(items, texts),
        "decisions": decided_rows(judged.decided, shown),
        "findings": decisions.findings_of(found, final, texts),
        "quality": [dataclasses.asdict(m) for m in judged.quality.measures],
        "motion": _motion(shown.warp.motion),
        "map": params.map,
        "tiles": params.background.model_dump() if params.background else None,
        "texts": texts.table(),
    }


def drive_data(
    projection: Projection, gnss: GnssTrack, slam: Trajectory, warp: Warp, texts: Texts, near: Floats,
    judged: Judged | None = None,
) -> Json:  # fmt: skip
    """The tracks, how they were brought together, and the frame they lie in."""
    use, held_out = (judged.gnss_use, judged.held_out) if judged else (None, None)
    antenna = (judged.graph_nodes, judged.antenna) if judged else None
    return {
        "gnss": drive.gnss_of(gnss, use, texts),
        "slam": drive.slam_of(slam, gnss, warp, held_out, antenna),
        "ties": drive.ties_of(gnss, use, slam, warp, antenna),
        "calibration": drive.calibration_of(held_out),
        "sheet": drive.sheet_of(warp),
        "frame": frame_of(projection, near),
    }


def start_map(source_map: LaneletMap | None, warp: Warp, texts: Texts) -> Json | None:
    """The map as the rigid start leaves it."""
    if source_map is None:
        return None
    return maps.map_of(maps.moved(source_map, Warp(warp.motion, None)), texts)


def final_map_of(shown: Shown) -> LaneletMap | None:
    """The finished map in the map frame."""
    if shown.final_map is None or shown.map_warp is None:
        return shown.final_map
    return maps.moved(shown.final_map, shown.map_warp)


def _conflation_data(shown: Shown, near: Floats, texts: Texts) -> Json:
    """Roads and what was decided with them."""
    matches, transfers, check, roads = shown.matches, shown.transfers, shown.lane_check, shown.roads
    data: Json = {
        "matches": decisions.matches_of(matches, texts) if matches is not None else None,
        "transfers": decisions.transfers_of(transfers, texts) if transfers is not None else None,
        "lane_check": decisions.lane_check_of(check, texts) if check is not None else None,
        "changes": decisions.changes_of(shown.changes, shown.projection, texts) if shown.changes else None,
    }
    if roads is None:
        return data
    xy_m = shown.projection.to_xy_m(roads.lonlat_deg)
    data["roads"], _ = maps.roads_of(roads, xy_m, near, ROADS_MARGIN_M, texts)
    if matches is not None and shown.source_map is not None:
        links = decisions.links_between(matches, maps.moved(shown.source_map, shown.warp), roads, xy_m)
        data["links"] = decisions.links_of(links)
    return data


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
