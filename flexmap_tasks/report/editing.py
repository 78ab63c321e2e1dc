"""The page on which control points are picked, and what it is told after every change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.model.alignment import ControlPoints, RigidMotion, Warp
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.maps import LaneletMap
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import GnssTrack, Trajectory
from flexmap_tasks.report import decisions, drive
from flexmap_tasks.report.embed import Json, Texts, millimetres
from flexmap_tasks.report.html import editor_page
from flexmap_tasks.report.report import drive_data, start_map
from flexmap_tasks.report.review_items import review_items


def control_point_page(
    title: str,
    projection: Projection,
    gnss: GnssTrack,
    slam: Trajectory,
    warp: Warp,
    points: ControlPoints | None,
    source_map: LaneletMap | None,
    method: str,
    base: str,
    places: tuple[str, ...],
) -> bytes:
    """The editor for a drive; `warp` is the one now in force, `source_map` in the SLAM frame.

    method : how runs align, which is how the page shows what the pairs do
    base : digest of the file that `points` come from; places : the editor's pages
    """
    texts = Texts()
    data: Json = {
        **drive_data(projection, gnss, slam, warp, texts, gnss.xyz_m[:, :2]),
        "map": title,
        "method": method,
        "editor": {"base": base},
        "points": drive.points_of(points, warp, texts),
        "before": start_map(source_map, warp, texts),
        "after": None,
        "review": decisions.review_of(review_items(None, None, None), texts),
        "quality": [],
        "texts": texts.table(),
    }
    return editor_page(title, data, places)


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """What pairs would do.

    warp : the one they make; antenna_m : (k, 2) where the antenna goes, where the alignment knows its lever arm
    residual_m, left_out_m : (n,) how far each pair is from its target, and would be if it were not used
    """

    warp: Warp
    antenna_m: Floats | None = None
    residual_m: Floats | None = None
    left_out_m: Floats | None = None


def preview(
    points: ControlPoints, effect: Effect, motion: RigidMotion, slam: Trajectory, gnss: GnssTrack
) -> Json:
    """The track with its distance to the GNSS line, what becomes of every pair, and how far the sheet stretches."""
    moved = effect.warp.apply(slam.xyz_m)[:, :2]
    before, _ = drive.deviation(motion.apply_xy(slam.xyz_m[:, :2]), gnss)
    after, valid = drive.deviation(moved if effect.antenna_m is None else effect.antenna_m, gnss)
    return {
        "track": millimetres(moved),
        "before_rmse_m": _rms(before),
        "after_rmse_m": _rms(after),
        "valid_rmse_m": _rms(after[valid]),
        "shift_m": np.hypot(*(points.target_xy_m - points.source_xy_m).T).tolist(),
        "residual_m": _known(effect.residual_m, len(points)),
        "left_out_m": _known(effect.left_out_m, len(points)),
        "sheet": drive.sheet_of(effect.warp),
    }


def _known(values: Floats | None, count: int) -> list[float | None]:
    """Numbers for JSON, which has no NaN."""
    if values is None:
        return [None] * count
    return [float(v) if np.isfinite(v) else None for v in values]


def _rms(values: Floats) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.sqrt((known**2).mean())) if len(known) else None
