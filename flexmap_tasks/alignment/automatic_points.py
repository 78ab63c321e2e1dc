"""Control points that nobody has to click: where the two tracks differ most, one after the other."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from flexmap_tasks.alignment.correspondence import covered, gnss_seconds, timed_start
from flexmap_tasks.alignment.drive import Drive, drive_of
from flexmap_tasks.alignment.gnss_line import GnssLine, driven_line
from flexmap_tasks.alignment.overlap import refuse_other_shape
from flexmap_tasks.alignment.rigid_start import rigid_start
from flexmap_tasks.alignment.rubber_sheet import sheet_through, stretches
from flexmap_tasks.config import AutomaticControlPointsParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.geometry.polyline import arc_length_m
from flexmap_tasks.geometry.rigid import PlanarFit
from flexmap_tasks.geometry.se2 import rotated, wrapped
from flexmap_tasks.geometry.turns import track_heading
from flexmap_tasks.model.alignment import ControlPoints, RigidMotion, Warp
from flexmap_tasks.model.arrays import Floats, Ints, strings
from flexmap_tasks.model.tracks import GnssTrack, Trajectory

EDGE_M = 5.0
"""So near to an outage nothing is chosen."""

TURN_REACH_M, FULL_TURN_RAD = 15.0, np.radians(45)
"""A turn counts over this way to either side, and fully from this angle on."""

STRAIGHT = {True: 0.7, False: 0.2}
"""What a place on a straight is worth beside one on a turn. Without time its place along the track is a guess."""

NEIGHBOURS = 9
"""A pair that leaves the median of so many by far is a bad one."""

OUTLYING = 3.0
"""Times the usual distance from that median, or from the target, that matter."""

FEWEST, NOTHING_M = 3, 1e-6
"""A sheet needs so many points; where there is no gap, any place is as good."""

LAPSE_S, _ROUNDS = 5.0, 8

_STILL = RigidMotion(np.eye(2), np.zeros(2), 1.0, 1.0, 0.0)


class Candidates(NamedTuple):
    """Places of the drive whose GNSS position is known.

    row : (n,) row of the SLAM pose; source_xy_m, target_xy_m : (n, 2) map frame, the source after the rigid start
    sigma_m : (n,) of the pair; turn_rad : (n,) how far the drive turns there; worth : (n,) from 0 to 1
    """

    row: Ints
    source_xy_m: Floats
    target_xy_m: Floats
    sigma_m: Floats
    turn_rad: Floats
    worth: Floats


@stage("automatic_points")
def automatic_control_points(
    slam: Trajectory, gnss: GnssTrack, motion: RigidMotion, params: AutomaticControlPointsParams
) -> ControlPoints:
    """Pairs chosen greedily: each where the sheet through those before leaves the tracks furthest apart.

    Turns and good fixes come first; a place next to a chosen one, or that would stretch the sheet too much, is left
    out. A point is named after the row of its SLAM pose, so a name says the same place in every run.
    Raises AlignmentError when fewer than three can be found.
    """
    found = candidates(slam, gnss, motion, params)
    everything = motion.apply_xy(slam.xyz_m[:, :2])
    chosen, left_out, gap = _choose(found, everything, params)
    if len(chosen) < FEWEST:
        raise AlignmentError(
            "tracks",
            f"only {len(chosen)} control points can be chosen by themselves; give some by hand "
            "(alignment.control_points_file) or choose alignment.method rigid",
        )
    rows = np.array(chosen + left_out)
    used = np.arange(len(rows)) < len(chosen)
    return ControlPoints(
        label=strings(f"auto-{r}" for r in found.row[rows].tolist()),
        source_xy_m=found.source_xy_m[rows],
        target_xy_m=found.target_xy_m[rows],
        sigma_m=found.sigma_m[rows],
        used=used,
        reason=strings(
            _reason(found, k, gap[k], u) for k, u in zip(rows.tolist(), used.tolist(), strict=True)
        ),
    )


def with_automatic(
    given: ControlPoints,
    automatic: ControlPoints,
    everything: Floats,
    params: AutomaticControlPointsParams | None,
) -> ControlPoints:
    """The user's points, and the automatic ones that no line of theirs names and that get on with them.

    everything : (n, 2) all that moves, after the rigid start
    """
    params = params or AutomaticControlPointsParams()
    rest = automatic.take(~np.isin(automatic.label, given.label))
    kept = given.take(given.used)
    used, reason = rest.used.copy(), rest.reason.copy()
    limit = params.max_stretch
    if len(kept):
        limit = max(limit, _worst_stretch(kept.source_xy_m, kept.target_xy_m, everything))
    for k in np.flatnonzero(rest.used).tolist():
        one = rest.take(np.array([k]))
        apart = np.hypot(*(given.source_xy_m[given.used] - one.source_xy_m).T)
        source, target = (
            np.concatenate([getattr(points, side) for points in (kept, one)])
            for side in ("source_xy_m", "target_xy_m")
        )
        if (apart < params.spacing_m).any():
            near = given.label[given.used][apart.argmin()]
            used[k], reason[k] = False, f"left out: {near} of the user is near ({rest.reason[k]})"
        elif _worst_stretch(source, target, everything) > limit:
            used[k], reason[k] = False, f"left out: would stretch the sheet too much ({rest.reason[k]})"
        else:
            kept = joined(kept, one)
    return joined(given, replace(rest, used=used, reason=reason))


def _worst_stretch(source_xy_m: Floats, target_xy_m: Floats, everything: Floats) -> float:
    return float(np.abs(stretches(sheet_through(source_xy_m, target_xy_m, everything)) - 1.0).max())


def joined(first: ControlPoints, second: ControlPoints) -> ControlPoints:
    """Both, one after the other."""
    columns = (f.name for f in fields(ControlPoints))
    return ControlPoints(*(np.concatenate([getattr(first, c), getattr(second, c)]) for c in columns))


def candidates(
    slam: Trajectory, gnss: GnssTrack, motion: RigidMotion, params: AutomaticControlPointsParams
) -> Candidates:
    """All pairs of the drive that their neighbours agree with."""
    line, _ = driven_line(gnss)
    if len(line.fix) < 3:
        raise AlignmentError("GNSS track", f"{len(line.fix)} usable fixes; control points need at least 3")
    drive = drive_of(slam, 1.0)
    pairs = _by_time(drive, slam, gnss, line, params)
    timed = pairs is not None
    row, place, along = pairs or _by_shape(drive, line)
    sure = line.seen_at(along) & line.seen_at(along - EDGE_M) & line.seen_at(along + EDGE_M)
    row, place, along = row[sure], place[sure], along[sure]
    source, target = motion.apply_xy(place), line.at(along)
    sigma = _stated_sigma(gnss, line, along)
    shift = target - source
    usual = np.column_stack([median_filter(c, NEIGHBOURS, mode="nearest") for c in shift.T])
    off = np.hypot(*(shift - usual).T)
    scatter = 1.4826 * median_filter(off, NEIGHBOURS, mode="nearest")
    agreed = off <= OUTLYING * np.maximum(scatter, sigma)
    turn = _turn(drive.pose[:, :2])[row]
    worth = STRAIGHT[timed] + (1 - STRAIGHT[timed]) * np.minimum(turn / FULL_TURN_RAD, 1.0)
    sigma = np.hypot(sigma, scatter)
    found = Candidates(
        row, source, source + usual, sigma, turn, worth / np.hypot(1.0, sigma / params.sigma_m)
    )
    return Candidates(*(column[agreed] for column in found))


def _by_time(
    drive: Drive, slam: Trajectory, gnss: GnssTrack, line: GnssLine, params: AutomaticControlPointsParams
) -> tuple[Ints, Floats, Floats] | None:
    """Pose row, place in the SLAM frame and arc length on the line of every fix; None without common time."""
    if slam.stamp_ns is None or drive.stamp_s is None:
        return None
    seconds = gnss_seconds(gnss, line, int(slam.stamp_ns[0]))
    start = None if seconds is None else timed_start(drive, line, seconds, params.clock_offset_max_s)
    if seconds is None or start is None:
        return None
    offset = start[1] if params.clock_offset_max_s == 0 else _offset(drive, line, seconds, *start)
    kept = np.flatnonzero(covered(drive, seconds + offset))
    pose = drive.at(seconds[kept] + offset)
    row = np.searchsorted((drive.stamp_s[1:] + drive.stamp_s[:-1]) / 2, seconds[kept] + offset)
    return row.astype(np.int64), pose[:, :2], line.along_m[kept]


def _offset(drive: Drive, line: GnssLine, seconds: Floats, fit: PlanarFit, offset: float) -> float:
    """Clock offset from how far the drive goes in a few seconds: SLAM's drift, which is slow, does not enter."""
    for _ in range(_ROUNDS):
        kept = np.flatnonzero(covered(drive, seconds + offset) & covered(drive, seconds + offset + LAPSE_S))
        ahead = np.clip(np.searchsorted(seconds, seconds[kept] + LAPSE_S), 0, len(seconds) - 1)
        lapse = seconds[ahead] - seconds[kept]
        whole = (np.abs(lapse - LAPSE_S) < 0.5) & covered(drive, seconds[ahead] + offset)
        kept, ahead = kept[whole], ahead[whole]
        if not len(kept):
            break
        behind, before = (drive.at(seconds[k] + offset) for k in (kept, ahead))
        slow, fast = (
            rotated(drive.velocity_at(seconds[k] + offset), pose[:, 2])
            for k, pose in ((kept, behind), (ahead, before))
        )
        gap = line.xy_m[ahead] - line.xy_m[kept] - (before - behind)[:, :2] @ fit.rotation.T
        change = (fast - slow) @ fit.rotation.T
        weight = (1.0 / (1.0 + (gap**2).sum(axis=1)))[:, None]
        told = float((weight * change**2).sum())
        if told <= 0:
            break
        offset += float((weight * gap * change).sum()) / told
    return offset


def _by_shape(drive: Drive, line: GnssLine) -> tuple[Ints, Floats, Floats]:
    """The same for every node of a drive without time."""
    start = rigid_start(drive.pose[drive.node], line)
    refuse_other_shape(start, drive.pose[drive.node, :2], line)
    along = np.clip(start.along_m, 0.0, line.along_m[-1])
    return drive.node.astype(np.int64), drive.pose[drive.node, :2], along


def _stated_sigma(gnss: GnssTrack, line: GnssLine, along_m: Floats) -> Floats:
    fix = line.fix[np.clip(np.searchsorted(line.along_m, along_m), 0, len(line.fix) - 1)]
    sigma = np.hypot(*gnss.sigma_m[fix, :2].T) / np.sqrt(2)
    return np.where(np.isfinite(sigma) & (sigma > 0), sigma, 0.03)


def _turn(xy_m: Floats) -> Floats:
    """(n,) angle between the directions of travel a little before and after every pose."""
    along, heading = arc_length_m(xy_m), np.unwrap(track_heading(xy_m))
    ahead, behind = (np.interp(along + s * TURN_REACH_M, along, heading) for s in (1, -1))
    turn: Floats = np.abs(wrapped(ahead - behind))
    return turn


def _choose(
    found: Candidates, everything: Floats, params: AutomaticControlPointsParams
) -> tuple[list[int], list[int], Floats]:
    """Rows chosen and rows left out for the stretch they would bring, and the gap each had when its turn came."""
    chosen: list[int] = []
    left_out: list[int] = []
    free, seen = np.ones(len(found.row), bool), np.zeros(len(found.row))
    start = np.column_stack([found.source_xy_m, np.zeros(len(found.row))])
    warp = Warp(_STILL, None)
    while len(chosen) < params.count and free.any():
        gap = np.hypot(*(warp.apply(start)[:, :2] - found.target_xy_m).T)
        # three are needed even where the tracks agree
        matters = free & ((gap > OUTLYING * found.sigma_m) | (len(chosen) < FEWEST))
        best = int(np.where(matters, (gap + NOTHING_M) * found.worth, 0.0).argmax())
        if not matters[best]:
            break
        seen[best] = gap[best]
        rows = [*chosen, best]
        sheet = sheet_through(found.source_xy_m[rows], found.target_xy_m[rows], everything)
        apart = np.hypot(*(found.source_xy_m - found.source_xy_m[best]).T)
        if np.abs(stretches(sheet) - 1.0).max() > params.max_stretch:
            left_out.append(best)
            free &= apart >= params.spacing_m / 2
            continue
        chosen.append(best)
        free &= apart >= params.spacing_m
        warp = Warp(_STILL, sheet)
    return chosen, left_out, seen


def _reason(found: Candidates, k: int, gap_m: float, used: bool) -> str:
    turn = (
        f"on a turn of {np.degrees(found.turn_rad[k]):.0f} deg"
        if found.turn_rad[k] > 0.2
        else "on a straight"
    )
    why = f"automatic: {gap_m:.2f} m off when chosen, {turn}"
    return why if used else f"left out: would stretch the sheet too much ({why})"
