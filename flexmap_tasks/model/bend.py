"""A deformation made of poses."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from flexmap_tasks.geometry import blend
from flexmap_tasks.model.arrays import Floats, Ints

_PAGES = 1024
"""Blocks of the lattice held at a time: 140 MB."""

_UNDO_ROUNDS, _UNDO_M = 60, 1e-10
"""Walking backwards gains a digit or two per round where the plane is bent by some per cent."""


@dataclass(frozen=True, slots=True, eq=False)
class Bend:
    """Near a pose the plane moves as the pose did, between them smoothly.

    source_xy_m, target_xy_m : (n, 2) float64, the poses before (moving frame) and after (fixed frame)
    turn_rad, stretch : (n,) float64, how the plane is turned and scaled at each
    lift_m : (n,) float64, added to heights; sigma_m : (n,) float64, horizontal standard deviation
    blend_m : (n,) float64, all equal: width of the blend
    """

    source_xy_m: Floats
    target_xy_m: Floats
    turn_rad: Floats
    stretch: Floats
    lift_m: Floats
    sigma_m: Floats
    blend_m: Floats

    def __len__(self) -> int:
        return len(self.turn_rad)

    def apply(self, xyz_m: Floats) -> Floats:
        """(n, 4) x, y, z in the fixed frame and the standard deviation there, of (n, 3) places."""
        points = np.ascontiguousarray(xyz_m)
        blocks = blend.blocks_of(points)
        whole = 0 < len(blocks) <= _PAGES
        out = np.empty((len(points), blend.CHANNELS))
        if not whole:
            out.fill(np.nan)
        for start in range(0, len(blocks), _PAGES):
            part = blocks[start : start + _PAGES]
            pages = np.stack([_block(self, int(i), int(j)) for i, j in part])
            low = part.min(axis=0)
            table = np.full(part.max(axis=0) - low + 1, -1, np.int64)
            table[tuple((part - low).T)] = np.arange(len(part))
            if whole:
                blend.look_up(pages, table, int(low[0]), int(low[1]), points, out)
                break
            moved = np.empty_like(out)
            blend.look_up(pages, table, int(low[0]), int(low[1]), points, moved)
            here = np.isfinite(moved[:, 0])
            out[here] = moved[here]
        return out

    def undo(self, xyz_m: Floats, start_xy_m: Floats, back: Floats) -> Floats:
        """(n, 3) places that `apply` moves to the given ones (Newton with a fixed slope).

        start_xy_m : (n, 2) first guess; back : (2, 2) about the inverse of the slope
        """
        place = np.column_stack([start_xy_m, np.zeros(len(xyz_m))])
        for _ in range(_UNDO_ROUNDS):
            moved = self.apply(place)
            step = (xyz_m[:, :2] - moved[:, :2]) @ back.T
            place[:, :2] += step
            if not (np.abs(step) > _UNDO_M).any():
                break
        place[:, 2] = xyz_m[:, 2] - moved[:, 2]
        return place

    def restrict(self, box: Floats) -> Bend:
        """The poses that matter inside a box of the moving frame, (2, 2) lower left and upper right corner."""
        low = np.floor(box[0] / blend.SPACING_M) * blend.SPACING_M
        high = (np.floor(box[1] / blend.SPACING_M) + 1) * blend.SPACING_M
        return self.take(blend.seen_from(self.motions(), low, high))

    def take(self, rows: Ints) -> Bend:
        """The poses of the given rows."""
        return Bend(*(getattr(self, field.name)[rows] for field in fields(self)))

    def motions(self) -> blend.Motions:
        """The same for the kernels."""
        return blend.Motions(
            self.source_xy_m, self.target_xy_m, self.turn_rad, self.stretch, self.lift_m, self.sigma_m,
            float(self.blend_m[0]),
        )  # fmt: skip


@lru_cache(maxsize=_PAGES)
def _block(bend: Bend, i: int, j: int) -> Floats:
    return blend.block(bend.motions(), i, j)
