"""The SLAM trajectory of a recording."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.config import SlamParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.mcap_tracks import read_poses
from flexmap_tasks.formats.track_rows import Rows
from flexmap_tasks.formats.track_text import KITTI, TUM, is_mcap, read_poses_text
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import Trajectory, rows_in_time_order

QUATERNION_TOLERANCE = 0.02
"""Quaternions with few digits miss unit length by less; Euler angles in their columns by more."""


@stage("slam_poses")
def ingest_slam(source: Source, params: SlamParams) -> Trajectory:
    """Poses of an MCAP topic or frame pair, or of a KITTI or TUM file; by stamp where there are stamps.

    Of poses with one stamp the first is kept. Quaternions come out with unit length.
    Raises InputError for a file or value that breaks a rule, and for fewer than 3 distinct poses.
    """
    rows = _read(source, params)
    bad = np.flatnonzero(~np.isfinite(rows.values).all(axis=1))
    if len(bad):
        rule = f"every number of a pose must be finite; {rows.form}"
        raise InputError(source.name, rule, rows.where(int(bad[0])))
    quaternion = _unit(source.name, rows)
    order = np.arange(len(rows)) if rows.stamp_ns is None else rows_in_time_order(rows.stamp_ns)
    xyz = rows.values[order, 0:3]
    if not _three_distinct(xyz):
        times = "" if len(order) == len(rows) else f" and {len(order):,} distinct stamps"
        rule = f"expected at least 3 distinct positions, got {len(rows):,} poses{times} at fewer places"
        raise InputError(source.name, f"{rule}: choose another topic or drive")
    return Trajectory(xyz, quaternion[order], None if rows.stamp_ns is None else rows.stamp_ns[order])


def _read(source: Source, params: SlamParams) -> Rows:
    mcap = is_mcap(source.name, source.path)
    if params.format == "mcap" and not mcap:
        raise InputError(source.name, "slam.format is mcap, but the file does not start like MCAP")
    if params.format == "mcap" or (params.format == "auto" and mcap):
        return read_poses(source.name, source.path, params.topic, params.parent_frame, params.child_frame)
    if mcap:
        raise InputError(source.name, f"slam.format is {params.format}, but the file is MCAP: use auto")
    form = {"kitti": KITTI, "tum": TUM}.get(params.format)
    return read_poses_text(source.name, source.path, form)


def _unit(name: str, rows: Rows) -> Floats:
    quaternion = rows.values[:, 3:7]
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(quaternion, axis=1)
    bad = np.flatnonzero(np.abs(norm - 1.0) > QUATERNION_TOLERANCE)
    if len(bad):
        row = int(bad[0])
        rule = f"the quaternion x y z w must have length 1, this one has {norm[row]:.3g}; {rows.form}"
        raise InputError(name, rule, rows.where(row))
    unit: Floats = quaternion / norm[:, None]
    return unit


def _three_distinct(xyz_m: Floats) -> bool:
    if len(xyz_m) < 3:
        return False
    others = xyz_m[(xyz_m != xyz_m[0]).any(axis=1)]
    return len(others) > 0 and bool((others != others[0]).any())
