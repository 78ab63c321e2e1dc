"""A deformation made of poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from flexmap_tasks.geometry import blend
from flexmap_tasks.model.arrays import Floats, Ints

_UNDO_ROUNDS, _UNDO_M = 60, 1e-10
"""Walking backwards gains a digit or two per round where the plane is bent by some per cent."""


@dataclass(frozen=True, slots=True, eq=False)
class Bend:
    """Near a pose everything moves as the pose did, between them smoothly.

    source_xy_m, target_xy_m : (n, 2) float64, the poses before (moving frame) and after (fixed frame)
    turn_rad, stretch : (n,) float64, how the plane is turned and scaled at each
    lift_m : (n,) float64, added to heights
    sigma_m, sigma_turn_rad : (n,) float64, standard deviations of the place, per axis, and of the turn
    blend_m : (n,) float64, all equal: width of the blend
    source_z_m : (n,) float64, heights of the poses before; tilt_xy_rad : (n, 2) float64, roll and pitch corrected:
    slope added along x and y of the moving frame, about the pose; stretch_up : (n,) float64, of heights above it
    sigma_up_m, sigma_tilt_rad : (n,) float64, standard deviations of lift, NaN where unknown, and of tilt per axis
    stamp_ns : (n,) int64, ascending, when each pose was driven; None where nothing is to be moved by its time
    """

    source_xy_m: Floats
    target_xy_m: Floats
    turn_rad: Floats
    stretch: Floats
    lift_m: Floats
    sigma_m: Floats
    sigma_turn_rad: Floats
    blend_m: Floats
    source_z_m: Floats
    tilt_xy_rad: Floats
    stretch_up: Floats
    sigma_up_m: Floats
    sigma_tilt_rad: Floats
    stamp_ns: Ints | None = None

    @classmethod
    def level(
        cls,
        source_xy_m: Floats,
        target_xy_m: Floats,
        turn_rad: Floats,
        stretch: Floats,
        lift_m: Floats,
        sigma_m: Floats,
        sigma_turn_rad: Floats,
        blend_m: Floats,
        stamp_ns: Ints | None = None,
        source_z_m: Floats | None = None,
    ) -> Bend:
        """Of poses that are not tilted, at height 0 if not said otherwise, with heights of unknown deviation."""
        zero = np.zeros(len(turn_rad))
        return cls(
            source_xy_m, target_xy_m, turn_rad, stretch, lift_m, sigma_m, sigma_turn_rad, blend_m,
            zero if source_z_m is None else source_z_m, np.zeros((len(zero), 2)), zero + 1.0, zero + np.nan, zero,
            stamp_ns,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.turn_rad)

    def apply(self, xyz_m: Floats) -> Floats:
        """(n, 3) places in the fixed frame of (n, 3) places; NaN stays NaN, a height counts as that of the poses."""
        return self._over(xyz_m, np.empty((len(xyz_m), 3)), lambda page: page.shift, blend.move)

    def apply_at(self, xyz_m: Floats, stamp_ns: Ints) -> Floats:
        """(n, 3) places moved as the drive was corrected at (n,) times: between the two poses around each.

        Before the first pose and after the last, as that one. A point seen at a known time follows the pass that
        saw it, where a place alone would follow the mean of all passes. Raises ValueError without stamps.
        """
        if self.stamp_ns is None:
            raise ValueError("the poses of this bend have no time")
        after = np.clip(np.searchsorted(self.stamp_ns, stamp_ns), 1, len(self) - 1)
        lapse = np.maximum(self.stamp_ns[after] - self.stamp_ns[after - 1], 1)
        share = np.clip((stamp_ns - self.stamp_ns[after - 1]) / lapse, 0.0, 1.0)
        out = np.zeros((len(xyz_m), 3))
        for k, weight in ((after - 1, 1.0 - share), (after, share)):
            x, y = (xyz_m[:, :2] - self.source_xy_m[k]).T
            above = np.where(np.isnan(xyz_m[:, 2]), 0.0, xyz_m[:, 2] - self.source_z_m[k])
            slope_x, slope_y = self.tilt_xy_rad[k].T
            up = self.lift_m[k] + (self.stretch_up[k] - 1.0) * above + slope_x * x + slope_y * y
            x, y = x - slope_x * above, y - slope_y * above
            cos, sin = self.stretch[k] * np.cos(self.turn_rad[k]), self.stretch[k] * np.sin(self.turn_rad[k])
            out[:, 0] += weight * (self.target_xy_m[k, 0] + cos * x - sin * y)
            out[:, 1] += weight * (self.target_xy_m[k, 1] + sin * x + cos * y)
            out[:, 2] += weight * (up + xyz_m[:, 2])
        return out

    def sigma_at_m(self, xyz_m: Floats) -> Floats:
        """(n,) horizontal standard deviation per axis where (n, 3) places go."""
        return self._over(xyz_m, np.empty(len(xyz_m)), lambda page: page.sigma, blend.sample)

    def sigma_up_at_m(self, xyz_m: Floats) -> Floats:
        """(n,) standard deviation of height where (n, 3) places go, NaN where a pose around has none."""
        return self._over(xyz_m, np.empty(len(xyz_m)), lambda page: page.sigma_up, blend.sample)

    def height_at_m(self, xyz_m: Floats) -> Floats:
        """(n,) height of the poses around (n, 3) places of the moving frame."""
        return self._over(
            xyz_m, np.empty(len(xyz_m)), lambda page: np.ascontiguousarray(page.shift[:, :, 6]), blend.sample
        )

    def _over(
        self,
        xyz_m: Floats,
        out: Floats,
        channel: Callable[[blend.Page], Floats],
        kernel: Callable[[blend.Atlas, Floats, Floats], None],
    ) -> Floats:
        """A kernel over all points, some pages at a time."""
        points = np.ascontiguousarray(xyz_m)
        first = True
        for part in blend.parts_of(blend.blocks_of(points)):
            by = blend.atlas([channel(_block(self, int(i), int(j))) for i, j in part], part)
            if first:
                kernel(by, points, out)
                first = False
                continue
            more = np.empty_like(out)
            kernel(by, points, more)
            known = ~np.isnan(more if more.ndim == 1 else more[:, 0])
            out[known] = more[known]
        if first:
            out.fill(np.nan)
        return out

    def undo(self, xyz_m: Floats, start_xy_m: Floats, back: Floats) -> Floats:
        """(n, 3) places that `apply` moves to the given ones (Newton with a fixed slope).

        start_xy_m : (n, 2) first guess; back : (2, 2) about the inverse of the slope
        """
        place = np.column_stack([start_xy_m, xyz_m[:, 2]])
        for _ in range(_UNDO_ROUNDS):
            gap = xyz_m - self.apply(place)
            step = np.column_stack([gap[:, :2] @ back.T, gap[:, 2]])
            place += step
            if not (np.abs(step) > _UNDO_M).any():
                break
        return place

    def restrict(self, box: Floats) -> Bend:
        """The poses that matter inside a box of the moving frame, (2, 2) lower left and upper right corner."""
        low = np.floor(box[0] / blend.SPACING_M) * blend.SPACING_M
        high = (np.floor(box[1] / blend.SPACING_M) + 1) * blend.SPACING_M
        return self.take(blend.seen_from(self.motions(), _tree(self), low, high))

    def take(self, rows: Ints) -> Bend:
        """The poses of the given rows, their times left out."""
        columns = (getattr(self, field.name) for field in fields(self) if field.name != "stamp_ns")
        return Bend(*(column[rows] for column in columns))

    def motions(self) -> blend.Motions:
        """The same for the kernels."""
        return blend.Motions(
            self.source_xy_m, self.target_xy_m, self.turn_rad, self.stretch, self.source_z_m, self.lift_m,
            self.tilt_xy_rad, self.stretch_up, self.sigma_m, self.sigma_turn_rad, self.sigma_up_m,
            self.sigma_tilt_rad, float(self.blend_m[0]),
        )  # fmt: skip


@lru_cache(maxsize=8)
def _tree(bend: Bend) -> cKDTree:
    return cKDTree(bend.source_xy_m)


@lru_cache(maxsize=blend.MOST_PAGES)
def _block(bend: Bend, i: int, j: int) -> blend.Page:
    return blend.block(bend.motions(), _tree(bend), i, j)
