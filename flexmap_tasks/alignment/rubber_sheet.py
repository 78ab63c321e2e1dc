"""The rubber sheet (White and Griffin 1985): the plane cut into triangles, each moved by its corners."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.config import RubberSheetParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.geometry.triangulation import canonical, delaunay, ring, twice_area
from flexmap_tasks.model.alignment import ControlPoints, Extent, RigidMotion, RubberSheet, Warp
from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.maps import LaneletMap
from flexmap_tasks.model.tracks import Trajectory

MIN_MARGIN_M = 1.0
"""The rectangle keeps at least this distance: nothing may lie on its border."""

MIN_AREA_SHARE = 1e-3
"""A triangle that shrinks below this share of its area is as good as folded."""


@stage("warp")
def rubber_sheet(
    points: ControlPoints,
    motion: RigidMotion,
    slam: Trajectory,
    lanelet_map: LaneletMap | None,
    cloud_extent: Extent | None,
    params: RubberSheetParams,
) -> Warp:
    """The sheet through all control points in use, over everything that will be moved.

    The rectangle around it all moves at its corners as the nearest control point does, as in the original.
    Around it lies a ring of the rectangle's own size that leads over to the mean of the corners' shifts,
    so that nothing tears at the border and the way back is exact everywhere. The result does not depend
    on the order of the control points.

    cloud_extent : box of the point cloud in the SLAM frame
    Raises AlignmentError, naming the control points, when a triangle folds.
    """
    used = points.take(np.flatnonzero(points.used))
    used = used.take(np.lexsort([*used.target_xy_m.T[::-1], *used.source_xy_m.T[::-1]]))
    moving = [slam.xyz_m[:, :2]]
    if lanelet_map is not None:
        moving.append(lanelet_map.xyz_m[:, :2])
    if cloud_extent is not None:
        moving.append(cloud_extent.corners())
    everything = np.concatenate([*(motion.apply_xy(xy) for xy in moving), used.source_xy_m])
    inner, outer = _frames(everything, params.margin_share)
    shift = used.target_xy_m - used.source_xy_m
    nearest = ((inner[:, None] - used.source_xy_m) ** 2).sum(axis=2).argmin(axis=1)
    corner_shift = shift[nearest]
    outside = corner_shift.mean(axis=0)
    n = len(used)
    sheet = RubberSheet(
        source_xy_m=np.concatenate([used.source_xy_m, inner, outer]),
        target_xy_m=np.concatenate([used.target_xy_m, inner + corner_shift, outer + outside]),
        triangles=canonical(
            np.concatenate(
                [
                    delaunay(np.concatenate([used.source_xy_m, inner])),
                    ring(np.arange(n, n + 4), np.arange(n + 4, n + 8)),
                ]
            )
        ),
        outside_shift_m=outside,
    )
    _refuse_folds(sheet, [*used.label, *(used.label[k] for k in nearest), *["the far field"] * 4])
    return Warp(motion, sheet)


@stage("warp")
def rigid_warp(motion: RigidMotion) -> Warp:
    """The rigid start alone."""
    return Warp(motion, None)


def _frames(xy_m: Floats, margin_share: float) -> tuple[Floats, Floats]:
    """Corners of the rectangle around all points, and of the ring around it."""
    low, high = np.nanmin(xy_m, axis=0), np.nanmax(xy_m, axis=0)
    margin = np.maximum((high - low) * margin_share, MIN_MARGIN_M)
    inner = Extent(*(low - margin).tolist(), *(high + margin).tolist()).corners()
    reach = float((high - low + 2 * margin).max())
    outer = Extent(*(low - margin - reach).tolist(), *(high + margin + reach).tolist()).corners()
    return inner, outer


def _refuse_folds(sheet: RubberSheet, label: list[str]) -> None:
    before = twice_area(sheet.source_xy_m[sheet.triangles])
    after = twice_area(sheet.target_xy_m[sheet.triangles])
    folded: Ints = np.flatnonzero(after < MIN_AREA_SHARE * before)
    if len(folded):
        worst = int(folded[(after / before)[folded].argmin()])
        names = sorted({label[k] for k in sheet.triangles[worst].tolist()})
        raise AlignmentError(
            "control points",
            f"{len(folded)} triangles of the rubber sheet fold over; the worst lies between "
            f"{', '.join(names)} and becomes {after[worst] / before[worst]:.2f} of its area; "
            "correct or exclude one of these points",
        )
