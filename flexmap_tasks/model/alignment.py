"""What moves things: rigid motion, control points, rubber sheet, and the warp made of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from flexmap_tasks.geometry import sheet as kernels
from flexmap_tasks.geometry.blend import SPACING_M
from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings, require
from flexmap_tasks.model.bend import Bend


@dataclass(frozen=True, slots=True)
class Extent:
    """An axis-parallel box, metres, in the frame of what it bounds."""

    x_min_m: float
    y_min_m: float
    x_max_m: float
    y_max_m: float

    @classmethod
    def of(cls, xy_m: Floats) -> Extent | None:
        """The box around finite points, (n, 2) or (n, 3); None when there are none."""
        points = xy_m[np.isfinite(xy_m[:, :2]).all(axis=1), :2]
        if len(points) == 0:
            return None
        (x_min, y_min), (x_max, y_max) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        return cls(x_min, y_min, x_max, y_max)

    def corners(self) -> Floats:
        """(4, 2) the corners, counter-clockwise from the lower left."""
        return np.array(
            [
                [self.x_min_m, self.y_min_m],
                [self.x_max_m, self.y_min_m],
                [self.x_max_m, self.y_max_m],
                [self.x_min_m, self.y_max_m],
            ]
        )


@dataclass(frozen=True, slots=True, eq=False)
class RigidMotion:
    """x_fixed = grid_scale * rotation @ x_moving + translation_m; z is left as it is.

    rotation : (2, 2) float64, orthonormal, det +1
    translation_m : (2,) float64, metres in the fixed frame
    grid_scale : the known grid scale that is applied (1.0 when switched off)
    fitted_scale : ratio of lengths found by the fit beside `grid_scale`; reported, never applied
    rmse_m : root mean square distance of the fitted samples, metres
    """

    as_json: ClassVar[bool] = True

    rotation: Floats
    translation_m: Floats
    grid_scale: float
    fitted_scale: float
    rmse_m: float

    def __post_init__(self) -> None:
        require(self.rotation.shape == (2, 2) and self.translation_m.shape == (2,), "a planar motion")

    @property
    def angle_rad(self) -> float:
        """Counter-clockwise turn from the moving to the fixed frame."""
        return float(np.arctan2(self.rotation[1, 0], self.rotation[0, 0]))

    @property
    def linear(self) -> Floats:
        """(2, 2) grid_scale * rotation."""
        return self.grid_scale * self.rotation

    def apply_xy(self, xy_m: Floats) -> Floats:
        """(n, 2) places in the fixed frame of (n, 2) places in the moving one."""
        a, t = self.linear, self.translation_m
        x, y = xy_m[:, 0], xy_m[:, 1]  # written out: a matrix product may round differently for other n
        return np.column_stack([a[0, 0] * x + a[0, 1] * y + t[0], a[1, 0] * x + a[1, 1] * y + t[1]])

    def inverse(self) -> RigidMotion:
        """The motion back."""
        rotation = np.ascontiguousarray(self.rotation.T)
        return RigidMotion(
            rotation,
            -(rotation @ self.translation_m) / self.grid_scale,
            1.0 / self.grid_scale,
            1.0 / self.fitted_scale,
            self.rmse_m,
        )


@dataclass(frozen=True, slots=True, eq=False)
class ControlPoints:
    """Pairs that say where a place of the moving track lies on the fixed one.

    label : (n,) str, the name the user gave (or the row)
    source_xy_m : (n, 2) float64, after the rigid start, in the fixed frame
    target_xy_m : (n, 2) float64, in the fixed frame
    sigma_m : (n,) float64, one standard deviation of the pair
    used : (n,) bool
    reason : (n,) str, why it is used or not
    """

    label: Strings
    source_xy_m: Floats
    target_xy_m: Floats
    sigma_m: Floats
    used: Bools
    reason: Strings

    def __len__(self) -> int:
        return len(self.label)

    def take(self, rows: Ints | Bools) -> ControlPoints:
        """The points of the given rows, in that order."""
        return ControlPoints(
            self.label[rows],
            self.source_xy_m[rows],
            self.target_xy_m[rows],
            self.sigma_m[rows],
            self.used[rows],
            self.reason[rows],
        )


@dataclass(frozen=True, slots=True, eq=False)
class JudgedPoints(ControlPoints):
    """Control points and how they are met, those in use first, the worst of them at the top.

    residual_m : (n,) float64, distance from the target that the warp leaves
    leave_one_out_m : (n,) float64, the same for an alignment without that point; NaN where nothing else tells
    """

    residual_m: Floats
    leave_one_out_m: Floats


@dataclass(frozen=True, slots=True, eq=False)
class RubberSheet:
    """A triangulated plane with one affine map per triangle; one shift for all the rest of the plane.

    source_xy_m, target_xy_m : (v, 2) float64, the vertices before and after, in the fixed frame
    triangles : (t, 3) int64, rows of the vertices, counter-clockwise
    outside_shift_m : (2,) float64, how everything outside of all triangles is shifted
    """

    as_json: ClassVar[bool] = True

    source_xy_m: Floats
    target_xy_m: Floats
    triangles: Ints
    outside_shift_m: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Warp:
    """One thing that moves track, map and cloud alike.

    A rigid motion alone; or the motion, then a rubber sheet; or a bend made of poses, which already holds the
    motion. `unbend` is a bend walked backwards; `motion` then leads back as well.
    """

    motion: RigidMotion
    sheet: RubberSheet | None
    bend: Bend | None = None
    unbend: Bend | None = None

    def apply(self, xyz_m: Floats) -> Floats:
        """(n, 3) places in the fixed frame of (n, 3) places in the moving one; z is kept, NaN stays NaN."""
        if self.bend is not None:
            return self.bend.apply(xyz_m)
        if self.unbend is not None:
            return self.unbend.undo(xyz_m, self.motion.apply_xy(xyz_m), self.motion.linear)
        return kernels.move(_mesh(self, len(xyz_m)), xyz_m)

    def apply_drawn(self, xyz_m: Floats) -> Floats:
        """The same for nodes of a map: one whose heights are all 0 does not know them, and lies where poses do."""
        if self.bend is None or xyz_m[:, 2].any():
            return self.apply(xyz_m)
        height = self.bend.height_at_m(xyz_m)
        moved = self.apply(np.column_stack([xyz_m[:, :2], height]))
        moved[:, 2] -= height
        return moved

    def apply_at(self, xyz_m: Floats, stamp_ns: Ints) -> Floats:
        """(n, 3) places moved by the corrections of the times (n,) at which they were seen; the rest by place.

        Times are the SLAM trajectory's; a negative one is unknown. A warp without times moves all by place.
        """
        if self.bend is None or self.bend.stamp_ns is None:
            return self.apply(xyz_m)
        known = stamp_ns >= 0
        out = np.empty((len(xyz_m), 3))
        out[known] = self.bend.apply_at(xyz_m[known], stamp_ns[known])
        if not known.all():
            out[~known] = self.apply(xyz_m[~known])
        return out

    def jacobian(self, xyz_m: Floats) -> Floats:
        """(n, 2, 2) how the plane is turned and stretched at (n, 3) places of the moving frame."""
        if self.bend is not None or self.unbend is not None:
            return self._numeric_jacobian(xyz_m)
        mesh = _mesh(self, len(xyz_m))
        return mesh.affine[kernels.locate(mesh, xyz_m), :, :2]

    def sigma_m(self, xyz_m: Floats) -> Floats:
        """(n,) predicted horizontal standard deviation at places of the moving frame; NaN where none is known."""
        return np.full(len(xyz_m), np.nan) if self.bend is None else self.bend.sigma_at_m(xyz_m)

    def sigma_up_m(self, xyz_m: Floats) -> Floats:
        """(n,) predicted standard deviation of height at places of the moving frame; NaN where none is known."""
        return np.full(len(xyz_m), np.nan) if self.bend is None else self.bend.sigma_up_at_m(xyz_m)

    def _numeric_jacobian(self, xyz_m: Floats) -> Floats:
        step = SPACING_M / 2
        columns = []
        for axis in (0, 1):
            ahead, behind = xyz_m.copy(), xyz_m.copy()
            ahead[:, axis] += step
            behind[:, axis] -= step
            columns.append((self.apply(ahead) - self.apply(behind))[:, :2] / (2 * step))
        return np.stack(columns, axis=2)

    def inverse(self) -> Warp:
        """The warp from the fixed frame back to the moving one, exact."""
        back = self.motion.inverse()
        if self.bend is not None or self.unbend is not None:
            return Warp(back, None, bend=self.unbend, unbend=self.bend)
        if self.sheet is None:
            return Warp(back, None)
        return Warp(
            back,
            RubberSheet(
                back.apply_xy(self.sheet.target_xy_m),
                back.apply_xy(self.sheet.source_xy_m),
                self.sheet.triangles,
                -(back.linear @ self.sheet.outside_shift_m),
            ),
        )

    def restrict(self, extent: Extent) -> Warp:
        """The part of the warp that a box in the moving frame touches, as a value of its own.

        Inside the box it gives the same bits as the whole; outside of it, nothing is promised. What lies
        elsewhere in the whole warp does not change this value, so it can name the result of a tile.
        """
        motion = RigidMotion(
            self.motion.rotation, self.motion.translation_m, self.motion.grid_scale, 1.0, 0.0
        )
        if self.bend is not None:
            still = RigidMotion(np.eye(2), np.zeros(2), 1.0, 1.0, 0.0)  # the bend holds all of the motion
            return Warp(still, None, bend=self.bend.restrict(extent.corners()[[0, 2]]))
        if self.sheet is None:
            return Warp(motion, None, unbend=self.unbend)
        sheet, mesh, corners = self.sheet, _mesh(self, 1), extent.corners()
        triangles = sheet.triangles[kernels.touching(mesh, corners[0], corners[2])]
        rows = np.unique(triangles)
        leaves = (kernels.locate(mesh, np.column_stack([corners, np.zeros(4)])) == len(sheet.triangles)).any()
        outside = sheet.outside_shift_m if leaves else np.zeros(2)
        return Warp(
            motion,
            RubberSheet(
                sheet.source_xy_m[rows], sheet.target_xy_m[rows], np.searchsorted(rows, triangles), outside
            ),
        )


@lru_cache(maxsize=8)
def _mesh_of_size(warp: Warp, points: int) -> kernels.Mesh:
    back = warp.motion.inverse()
    outside = np.column_stack([warp.motion.linear, warp.motion.translation_m])
    if warp.sheet is None:
        none = np.empty((0, 2))
        return kernels.build_mesh(none, none, np.empty((0, 3), np.int64), outside, points)
    sheet = warp.sheet
    outside[:, 2] += sheet.outside_shift_m
    return kernels.build_mesh(
        back.apply_xy(sheet.source_xy_m), sheet.target_xy_m, sheet.triangles, outside, points
    )


def _mesh(warp: Warp, points: int) -> kernels.Mesh:
    """The whole warp as a mesh in the moving frame, remembered by the order of magnitude of `points`."""
    return _mesh_of_size(warp, 1 << min((max(points, 1) - 1).bit_length() | 3, 23))
