"""What moves things: rigid motion, control points, rubber sheet, and the warp made of them."""

from __future__ import annotations

from dataclasses import dataclass

from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings, require


@dataclass(frozen=True, slots=True, eq=False)
class RigidMotion:
    """x_fixed = grid_scale * rotation @ x_moving + translation_m; z is left as it is.

    rotation : (2, 2) float64, orthonormal, det +1
    translation_m : (2,) float64, metres in the fixed frame
    grid_scale : the known grid scale that is applied (1.0 when switched off)
    fitted_scale : ratio of lengths found by the fit beside `grid_scale`; reported, never applied
    rmse_m : root mean square distance of the fitted samples, metres
    """

    rotation: Floats
    translation_m: Floats
    grid_scale: float
    fitted_scale: float
    rmse_m: float

    def __post_init__(self) -> None:
        require(self.rotation.shape == (2, 2) and self.translation_m.shape == (2,), "a planar motion")


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


@dataclass(frozen=True, slots=True, eq=False)
class RubberSheet:
    """A triangulated plane with one affine map per triangle; a rigid shift outside of it.

    source_xy_m, target_xy_m : (v, 2) float64, the vertices before and after
    triangles : (t, 3) int64, rows of the vertices, counter-clockwise
    """

    source_xy_m: Floats
    target_xy_m: Floats
    triangles: Ints


@dataclass(frozen=True, slots=True, eq=False)
class Warp:
    """One thing that moves track, map and cloud alike: rigid motion, then the sheet if there is one."""

    motion: RigidMotion
    sheet: RubberSheet | None
