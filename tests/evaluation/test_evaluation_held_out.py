"""GNSS that was withheld judges an alignment: on the right pass, on the withheld blocks, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flexmap_tasks.alignment.align_track import align_track
from flexmap_tasks.alignment.project import project_utm
from flexmap_tasks.alignment.rubber_sheet import rigid_warp
from flexmap_tasks.alignment.umeyama import umeyama
from flexmap_tasks.config import GnssParams, HeldOutParams, ProjectionParams, SlamParams, UmeyamaParams
from flexmap_tasks.errors import InputError
from flexmap_tasks.evaluation.deviation import deviation
from flexmap_tasks.evaluation.held_out import held_out_error, withheld_distance_m, withhold
from flexmap_tasks.ingest.gnss import ingest_gnss
from flexmap_tasks.ingest.slam import ingest_slam
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import GnssTrack, Trajectory

PARAMS = HeldOutParams(block_m=50, every=4, fold=1)


def there_and_back(step: float) -> Floats:
    """400 m east, a turn, and 400 m back, 3 m beside."""
    out = np.column_stack([np.arange(0, 400, step), np.zeros(round(400 / step))])
    return np.concatenate([out, [[402, 1], [402, 2]], out[::-1] + np.array([0, 3])])


def gnss(xy: Floats, stamps: bool = False) -> GnssTrack:
    n = len(xy)
    return GnssTrack(
        np.column_stack([xy, np.zeros(n)]), np.full((n, 3), np.nan), np.zeros(n, np.int64), np.arange(n),
        np.ones(n, dtype=bool), np.arange(n) * 10**8 if stamps else None,
    )  # fmt: skip


def poses(xy: Floats, stamp_ns: np.ndarray | None = None) -> Trajectory:
    n = len(xy)
    return Trajectory(np.column_stack([xy, np.zeros(n)]), np.tile([0.0, 0, 0, 1], (n, 1)), stamp_ns)


def test_blocks_are_withheld() -> None:
    track = gnss(there_and_back(1.0))
    parts = withhold(track, PARAMS)
    blocks = [withhold(track, replace_fold(k)) for k in range(4)]
    hidden = np.array([~np.isin(track.row, b.kept.row) for b in blocks])
    assert (hidden.sum(axis=0) == 1).all()
    assert len(parts.kept) + hidden[1].sum() == len(track)
    gaps = np.flatnonzero(~parts.kept.observed)
    assert len(gaps) == 4
    assert (np.diff(parts.kept.row)[gaps - 1] == 51).all()
    assert not (parts.judge.observed & ~hidden[1]).any()


def replace_fold(fold: int) -> HeldOutParams:
    return HeldOutParams(block_m=50, every=4, fold=fold)


@pytest.mark.parametrize("stamps", [False, True])
def test_distance_is_to_the_same_pass(stamps: bool) -> None:
    line = there_and_back(1.0)
    parts = withhold(gnss(line, stamps), PARAMS)
    at = np.arange(0, len(line), 3)
    stamp = at * 10**8 if stamps else None
    exact = withheld_distance_m(poses(line[at], stamp), parts.judge)
    assert len(exact) > 50
    assert exact.max() < 1e-6
    other_lane = line[at] + np.array([0, 2.0])  # nearer to the way back on the way there
    distance = withheld_distance_m(poses(other_lane, stamp), parts.judge)
    assert np.median(distance) == pytest.approx(2.0, abs=1e-6)


def test_only_withheld_blocks_count() -> None:
    line = there_and_back(1.0)
    parts = withhold(gnss(line), PARAMS)
    bad = line.copy()
    kept = np.isin(np.arange(len(line)), parts.kept.row)
    inner = kept & np.roll(kept, 3) & np.roll(kept, -3)
    bad[inner] += (0, 0.9)
    assert np.median(withheld_distance_m(poses(bad), parts.judge)) < 1e-6
    bad = line.copy()
    bad[~kept] += (0, -0.9)
    assert np.median(withheld_distance_m(poses(bad), parts.judge)) == pytest.approx(0.9)


def test_poses_out_of_reach_are_not_forgotten() -> None:
    line = there_and_back(1.0)
    parts = withhold(gnss(line), PARAMS)
    assert (withheld_distance_m(poses(line + np.array([0, 500.0])), parts.judge) == 30.0).sum() > 100


def test_too_short_a_track() -> None:
    with pytest.raises(InputError, match="shorter blocks"):
        withhold(gnss(there_and_back(1.0)[:20]), PARAMS)
    with pytest.raises(ValueError, match="fold"):
        HeldOutParams(every=5, fold=5)


def test_garching_rigid_start(shared_data: Path) -> None:
    def source(name: str) -> Source:
        return Source(name, shared_data / "garching" / name)

    projected = project_utm(ingest_gnss(source("route_1_GPS.txt"), GnssParams()), ProjectionParams())
    slam = ingest_slam(source("route1_pose_kitti.txt"), SlamParams())
    params = HeldOutParams(block_m=100, every=5, fold=2)
    parts = withhold(projected.gnss_track, params)
    motion = umeyama(slam, parts.kept, projected.projection, UmeyamaParams())
    aligned = align_track(slam, rigid_warp(motion))
    quality = held_out_error(aligned, parts, params)
    count, mean = quality.value("held_out_100m_poses"), quality.value("held_out_100m_mean")
    assert count is not None
    assert mean is not None
    assert 150 < count < 320
    usual = deviation(aligned.xyz_m, projected.gnss_track)
    assert mean == pytest.approx(float(usual.distance_m[usual.valid].mean()), rel=0.3)
    observed = replace(projected.gnss_track, observed=np.ones(len(projected.gnss_track), dtype=bool))
    assert len(withhold(observed, params).kept) == len(parts.kept)
