"""Control points: the user's pairs, found on both tracks and checked."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.alignment.automatic_points import with_automatic
from flexmap_tasks.config import PairParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.formats.control_points_csv import (
    ControlPointLine,
    Place,
    incomplete,
    read_control_points,
)
from flexmap_tasks.model.alignment import ControlPoints, RigidMotion
from flexmap_tasks.model.arrays import Floats, strings
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import GnssTrack, Trajectory

MIN_POINTS = 3
"""Fewer do not say how the plane is bent."""

SAME_PLACE_M = 1e-3
"""Two points nearer than this are one."""

AGREE_M = 0.02
"""Two ways to say where a point is agree within this: coordinates are given to the centimetre."""

AFTER_FIT = ("source_map_x_m", "source_lat_deg")
AGREE_AFTER_FIT_M = 0.5
"""The same for places after the rigid start, which another fit may have put elsewhere."""

COLLINEAR_SHARE = 1e-3
"""Points that leave their best line by less than this share of their length lie on it."""


@stage("control_points")
def control_points(
    source: Source,
    slam: Trajectory,
    gnss: GnssTrack,
    motion: RigidMotion,
    projection: Projection,
    params: PairParams,
    automatic: ControlPoints | None = None,
) -> ControlPoints:
    """The pairs of the user's file, both sides in the map frame, the source after the rigid start.

    automatic : points under those of the file: a line with the name of one stands in its place and takes from it
    what it does not give; one that is then nearer than the spacing to a pair of the user's, or would stretch the
    sheet too much with them, is left out

    Raises AlignmentError, with line and name, for the same place used twice, a row that a track does not have,
    and pairs too far apart to belong together; for a rubber sheet also for fewer than three pairs in use, and for
    pairs on one line.
    """
    lines = read_control_points(source)
    known = {} if automatic is None else {name: k for k, name in enumerate(automatic.label.tolist())}
    sources, targets, sigma = [], [], []
    for line in lines:
        base = known.get(line.name)
        ways = [_source_xy(source, line, place, slam, motion, projection) for place in line.source]
        sources.append(_side(source, line, "source", ways, automatic, base))
        ways = [_target_xy(source, line, place, gnss, projection) for place in line.target]
        targets.append(_side(source, line, "target", ways, automatic, base))
        inherited = params.sigma_m if automatic is None or base is None else automatic.sigma_m[base]
        sigma.append(inherited if line.sigma_m is None else line.sigma_m)
    used = np.array([line.use for line in lines], dtype=bool)
    points = ControlPoints(
        label=strings(line.name for line in lines),
        source_xy_m=np.array(sources).reshape(-1, 2),
        target_xy_m=np.array(targets).reshape(-1, 2),
        sigma_m=np.array(sigma, dtype=np.float64),
        used=used,
        reason=strings(_reason(line, line.name in known) for line in lines),
    )
    kept = [line for line in lines if line.use]
    if kept:
        _check_distances(source, kept, points, params.max_rigid_distance_m)
        _check_doubled(source, kept, points.source_xy_m[used], "source")
        _check_doubled(source, kept, points.target_xy_m[used], "target")
    if automatic is not None:
        points = with_automatic(points, automatic, motion.apply_xy(slam.xyz_m[:, :2]), params.automatic)
    if params.sheet:
        _check_count(source, int(points.used.sum()))
        _check_collinear(source, points.source_xy_m[points.used])
    return points


def _reason(line: ControlPointLine, over_automatic: bool) -> str:
    if not line.use:
        return "excluded by the user"
    return "given by the user in place of an automatic point" if over_automatic else "given by the user"


def _side(
    source: Source,
    line: ControlPointLine,
    side: str,
    ways: list[Floats],
    automatic: ControlPoints | None,
    base: int | None,
) -> Floats:
    """Where a side of a pair is: as the line says, or as the automatic point of its name."""
    if ways:
        return _settle(source, line, getattr(line, side), ways)
    if automatic is None or base is None:
        raise incomplete(source, line.where, side)
    xy: Floats = getattr(automatic, f"{side}_xy_m")[base]
    return xy


def _settle(source: Source, line: ControlPointLine, places: tuple[Place, ...], xy_m: list[Floats]) -> Floats:
    """The one position of a side given in several ways: the first, or the one that was changed by hand."""
    positions = np.array(xy_m)
    loose = np.array([p.kind in AFTER_FIT for p in places])
    limit = np.where(loose[:, None] | loose, AGREE_AFTER_FIT_M, AGREE_M)
    apart = np.hypot(*(positions[:, None] - positions).transpose(2, 0, 1))
    differs = apart > limit
    if not differs.any():
        return xy_m[0]
    others = len(places) - 1
    odd = [i for i in range(len(places)) if differs[i].sum() == others and differs.sum() == 2 * others]
    if others >= 2 and len(odd) == 1:
        return xy_m[odd[0]]
    first, second = (int(i[0]) for i in np.nonzero(differs))
    raise AlignmentError(
        source.name,
        f"{places[first].kind} and {places[second].kind} lie {apart[first, second]:.2f} m apart; keep one of the two",
        line.where,
    )


def _source_xy(
    source: Source,
    line: ControlPointLine,
    place: Place,
    slam: Trajectory,
    motion: RigidMotion,
    projection: Projection,
) -> Floats:
    kind, values = place.kind, place.values
    if kind == "source_row":
        row = _row(source, line, values[0], len(slam), "the SLAM trajectory")
        at = slam.xyz_m[row]
    elif kind == "source_x_m":
        at = np.array(values)
    else:
        return np.array(values) if kind == "source_map_x_m" else _project(source, line, projection, values)
    moved: Floats = motion.apply_xy(at[None])[0]
    return moved


def _target_xy(
    source: Source, line: ControlPointLine, place: Place, gnss: GnssTrack, projection: Projection
) -> Floats:
    kind, values = place.kind, place.values
    if kind != "target_row":
        return np.array(values) if kind == "target_x_m" else _project(source, line, projection, values)
    row = _row(source, line, values[0], int(gnss.row[-1]) + 1, "the GNSS recording")
    at = np.flatnonzero(gnss.row == row)
    if len(at) == 0:
        raise AlignmentError(source.name, f"row {row} of the GNSS recording has no position", line.where)
    xy: Floats = gnss.xyz_m[at[0], :2]
    return xy


def _row(source: Source, line: ControlPointLine, value: float, rows: int, track: str) -> int:
    if value >= rows:
        raise AlignmentError(
            source.name, f"row {value:.0f} is beyond {track}, whose last row is {rows - 1}", line.where
        )
    return int(value)


def _project(
    source: Source, line: ControlPointLine, projection: Projection, latlon: tuple[float, ...]
) -> Floats:
    xy: Floats = projection.to_xy_m(np.array([[latlon[1], latlon[0]]]))[0]
    if not np.isfinite(xy).all():
        raise AlignmentError(
            source.name,
            f"{latlon[0]:g}, {latlon[1]:g} lies outside of UTM zone {projection.zone}",
            line.where,
        )
    return xy


def _check_count(source: Source, count: int) -> None:
    if count < MIN_POINTS:
        raise AlignmentError(
            source.name, f"has {count} control points in use; a rubber sheet needs at least {MIN_POINTS}"
        )


def _check_distances(
    source: Source, kept: list[ControlPointLine], points: ControlPoints, limit: float
) -> None:
    gap = np.hypot(*(points.source_xy_m - points.target_xy_m)[points.used].T)
    worst = int(gap.argmax())
    if gap[worst] > limit:
        raise AlignmentError(
            source.name,
            f"source and target lie {gap[worst]:.1f} m apart after the rigid start, over the limit of {limit:g} m "
            "(alignment.control_points.max_rigid_distance_m); correct or exclude the pair",
            kept[worst].where,
        )


def _check_doubled(source: Source, kept: list[ControlPointLine], xy_m: Floats, side: str) -> None:
    gap = np.hypot(*(xy_m[:, None] - xy_m).transpose(2, 0, 1))
    first, second = np.nonzero(np.triu(gap < SAME_PLACE_M, 1))
    if len(first):
        raise AlignmentError(
            source.name,
            f"has the same {side} as {kept[int(first[0])].where}; remove one of the two",
            kept[int(second[0])].where,
        )


def _check_collinear(source: Source, xy_m: Floats) -> None:
    across = np.linalg.svd(xy_m - xy_m.mean(axis=0), compute_uv=False)
    if across[1] <= COLLINEAR_SHARE * across[0]:
        raise AlignmentError(
            source.name,
            f"all {len(xy_m)} control points lie on one line; add one at least "
            f"{COLLINEAR_SHARE:.1%} of their length beside it",
        )
