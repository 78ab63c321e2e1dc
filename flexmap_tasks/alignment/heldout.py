"""Accuracy that can be trusted: GNSS withheld in blocks, everything computed again without it."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.alignment.correspondence import slide
from flexmap_tasks.alignment.gnss_line import GnssLine, driven_line
from flexmap_tasks.alignment.pose_graph import checked_drive, first_stamp, no_control
from flexmap_tasks.alignment.solve import MULTIPATH, Solved, solve
from flexmap_tasks.config import GraphHeldOutParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.geometry.monotone import associate
from flexmap_tasks.geometry.normal_equations import inverse_on_pattern
from flexmap_tasks.geometry.turns import track_heading
from flexmap_tasks.model.arrays import Bools, Floats, Strings
from flexmap_tasks.model.pose_graph import HeldOut
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import GnssTrack, Trajectory

EDGE_M = 1.0
"""Next to a gap of the whole line the distance to it means nothing."""


@stage("heldout")
def heldout(slam: Trajectory, gnss: GnssTrack, projection: Projection, params: GraphHeldOutParams) -> HeldOut:
    """Distance of the antenna from GNSS that the solution was not told of, on the same pass of the road.

    Every `folds`-th block of `block_m` metres is withheld, then the next, until all have been; rigid start,
    association, noise and adjustment are done anew each time. Only what the whole solution keeps is asked of, and
    what it switched off as multipath stays off: the search for that is not repeated. Whether SLAM closes its loops
    is asked of the whole solution too: it is a property of SLAM.
    """
    drive, control = checked_drive(slam, params.graph), no_control()
    log_scale, first = float(np.log(projection.grid_scale_factor)), first_stamp(slam)
    whole = solve(drive, gnss, first, log_scale, control, params.graph)
    off = _switched_off(whole.reason)
    line, _ = driven_line(gnss, off)
    where = _places(line, whole.solution.state.antenna, _on(line, whole))
    fold = (where // params.block_m).astype(np.int64) % params.folds
    of_fix = np.interp(np.arange(len(gnss)), line.fix, line.along_m)
    fix_fold = (of_fix // params.block_m).astype(np.int64) % params.folds
    known, closed = _seen(line, where), len(whole.known.revisit.first) > 0
    gap, sigma = np.full(len(where), np.nan), np.full(len(where), np.nan)
    for k in range(params.folds):
        asked = known & (fold == k)
        if not asked.any():
            continue
        withheld = off | (fix_fold == k)
        part = solve(
            drive, gnss, first, log_scale, control, params.graph, withheld, search=False, closed=closed
        )
        antenna = part.solution.state.antenna
        foot = slide(line, antenna, where)
        gap[asked] = np.hypot(*(antenna - line.at(foot)).T)[asked]
        variance = inverse_on_pattern(part.solution.lu).diagonal()[: antenna.size // 2 * 3].reshape(-1, 3)
        sigma[asked] = np.sqrt(np.maximum(variance[:, :2].mean(axis=1), 0.0))[asked]
    asked = np.isfinite(gap)
    return HeldOut(drive.node[asked].astype(np.int64), where[asked], gap[asked], sigma[asked])


def _on(line: GnssLine, whole: Solved) -> Floats | None:
    """The association of the whole solution on a line with fewer fixes, which is shorter where they are missing."""
    if whole.along_m is None:
        return None
    kept, same = np.isin(whole.line.fix, line.fix), np.isin(line.fix, whole.line.fix)
    along: Floats = np.interp(whole.along_m, whole.line.along_m[kept], line.along_m[same])
    return along


def _switched_off(reason: Strings) -> Bools:
    return np.array([text == MULTIPATH for text in reason], bool)


def _places(line: GnssLine, antenna: Floats, along_m: Floats | None) -> Floats:
    """Arc length on the whole line at every node, from the association or, when timed, from the way driven."""
    if along_m is not None:
        return slide(line, antenna, np.clip(along_m, 0.0, line.along_m[-1]))
    sample = np.arange(0.0, line.along_m[-1], 1.0)
    seen, heading = line.seen_at(sample), line.heading_at(sample)
    place = associate(antenna, track_heading(antenna), line.at(sample), heading, seen)
    return slide(line, antenna, sample[place])


def _seen(line: GnssLine, at: Floats) -> Bools:
    inside = (at > EDGE_M) & (at < line.along_m[-1] - EDGE_M)
    seen: Bools = inside & line.seen_at(at) & line.seen_at(at - EDGE_M) & line.seen_at(at + EDGE_M)
    return seen
