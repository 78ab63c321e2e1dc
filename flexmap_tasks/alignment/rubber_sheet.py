"""The rubber sheet (White and Griffin 1985): the plane cut into triangles, each moved by its corners."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.config import RubberSheetParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.geometry.sheet import affine_maps
from flexmap_tasks.geometry.triangulation import canonical, delaunay, ring, twice_area
from flexmap_tasks.model.alignment import ControlPoints, Extent, RigidMotion, RubberSheet, Warp
from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.maps import LaneletMap
from flexmap_tasks.model.tracks import Trajectory

MIN_MARGIN_M = 1.0
"""The rectangle keeps at least this distance: nothing may lie on its border."""

MARGIN_SHARE = RubberSheetParams().margin_share
"""For a sheet that is only tried."""

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
    moving = [slam.xyz_m[:, :2]]
    if lanelet_map is not None:
        moving.append(lanelet_map.xyz_m[:, :2])
    if cloud_extent is not None:
        moving.append(cloud_extent.corners())
    everything = np.concatenate([motion.apply_xy(xy) for xy in moving])
    sheet = sheet_through(used.source_xy_m, used.target_xy_m, everything, params.margin_share)
    _refuse_folds(sheet, used)
    return Warp(motion, sheet)


def sheet_through(
    source_xy_m: Floats, target_xy_m: Floats, everything_m: Floats, margin_share: float = MARGIN_SHARE
) -> RubberSheet:
    """The sheet through pairs (n, 2), whatever their order, in a rectangle around all of them and everything else.

    Its vertices are the pairs, then four corners of the rectangle, then four of the ring. It may be folded.
    """
    order = np.lexsort([*target_xy_m.T[::-1], *source_xy_m.T[::-1]])
    source, target = source_xy_m[order], target_xy_m[order]
    inner, outer = _frames(np.concatenate([everything_m, source]), margin_share)
    shift = target - source
    nearest = ((inner[:, None] - source) ** 2).sum(axis=2).argmin(axis=1)
    corner_shift = shift[nearest]
    outside = corner_shift.mean(axis=0)
    n = len(source)
    around = ring(np.arange(n, n + 4), np.arange(n + 4, n + 8))
    return RubberSheet(
        source_xy_m=np.concatenate([source, inner, outer]),
        target_xy_m=np.concatenate([target, inner + corner_shift, outer + outside]),
        triangles=canonical(np.concatenate([delaunay(np.concatenate([source, inner])), around])),
        outside_shift_m=outside,
    )


def stretches(sheet: RubberSheet) -> Floats:
    """(t, 2) largest and smallest stretch of every triangle; the smallest is negative where it folds."""
    corners = sheet.source_xy_m[sheet.triangles], sheet.target_xy_m[sheet.triangles]
    linear = affine_maps(*corners)[:, :, :2]
    value = np.linalg.svd(linear, compute_uv=False)
    turned_over: Floats = np.where(np.linalg.det(linear) < 0, -1.0, 1.0)
    return np.column_stack([value[:, 0], value[:, 1] * turned_over])


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


def _refuse_folds(sheet: RubberSheet, used: ControlPoints) -> None:
    before = twice_area(sheet.source_xy_m[sheet.triangles])
    after = twice_area(sheet.target_xy_m[sheet.triangles])
    folded: Ints = np.flatnonzero(after < MIN_AREA_SHARE * before)
    if len(folded):
        worst = int(folded[(after / before)[folded].argmin()])
        corners = sheet.source_xy_m[sheet.triangles[worst]]
        nearest = ((corners[:, None] - used.source_xy_m) ** 2).sum(axis=2).argmin(axis=1)
        raise AlignmentError(
            "control points",
            f"{len(folded)} triangles of the rubber sheet fold over; the worst lies between "
            f"{', '.join(sorted(set(used.label[nearest].tolist())))} and becomes "
            f"{after[worst] / before[worst]:.2f} of its area; correct or exclude one of these points",
        )
