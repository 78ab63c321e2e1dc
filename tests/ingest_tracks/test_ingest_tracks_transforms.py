"""Transforms: chains of frames, at their own times, against scipy and a real recording."""

from __future__ import annotations

import ingest_track_recordings as rec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from flexmap_tasks.config import SlamParams
from flexmap_tasks.errors import InputError
from flexmap_tasks.ingest.slam import ingest_slam
from flexmap_tasks.model.source import Source

T0 = 1_700_000_000_123_456_789
STEP = 100_000_000


def values(i):
    turn = np.array([0.1 * i, 0.2, -0.3, 1.0])
    return [float(i), i * 0.5, -i * 0.25, *(turn / np.linalg.norm(turn)).tolist()]


def slam(path, **params):
    return ingest_slam(Source(path.name, path), SlamParams(**params))


def test_a_chain_of_transforms_is_followed_at_the_times_of_its_busiest_link(tmp_path):
    """map -> odom (slow), odom -> base (fast), base -> roof (never changes): tf2's way, composed by scipy."""
    slow, fast = np.arange(0, 11) * 10 * STEP, np.arange(0, 100) * STEP + 5 * STEP
    records = [
        rec.ros_record(
            "/tf", T0 + t, rec.transforms([rec.transform(T0 + t, values(t / STEP), "map", "odom")])
        )
        for t in slow.tolist()
    ]
    records += [
        rec.ros_record(
            "/tf", T0 + t, rec.transforms([rec.transform(T0 + t, values(t / STEP + 3), "odom", "base")])
        )
        for t in fast.tolist()
    ]
    fixed = rec.transform(0, values(7), "base", "roof")
    records.append(rec.ros_record("/tf_static", T0, rec.transforms([fixed])))
    poses = slam(rec.write(tmp_path / "a.mcap", records), parent_frame="map", child_frame="roof")
    known = fast[fast <= slow[-1]]
    np.testing.assert_array_equal(poses.stamp_ns, T0 + known)

    def matrices(rows):
        rows = np.atleast_2d(rows)
        out = np.tile(np.eye(4), (len(rows), 1, 1))
        out[:, :3, :3], out[:, :3, 3] = Rotation.from_quat(rows[:, 3:]).as_matrix(), rows[:, :3]
        return out

    at = np.array([values(t / STEP) for t in slow.tolist()])
    slerp = Slerp(slow, Rotation.from_quat(at[:, 3:]))(known).as_quat()
    odom = np.column_stack([np.interp(known, slow, at[:, i]) for i in range(3)] + [slerp])
    base = np.array([values(t / STEP + 3) for t in known.tolist()])
    expected = matrices(odom) @ matrices(base) @ matrices(np.array(values(7)))
    np.testing.assert_allclose(poses.xyz_m, expected[:, :3, 3], atol=1e-9)
    turn = Rotation.from_matrix(expected[:, :3, :3]).inv() * Rotation.from_quat(poses.quaternion)
    assert turn.magnitude().max() < 1e-9


def test_a_chain_against_its_direction_and_one_without_common_time(tmp_path):
    early = rec.transforms([rec.transform(T0 + k, values(k), "map", "odom") for k in range(3)])
    late = rec.transforms([rec.transform(T0 + 9000 + k, values(k), "base", "odom") for k in range(3)])
    both = [rec.ros_record("/tf", T0, early), rec.ros_record("/tf", T0 + 1, late)]
    file = rec.write(tmp_path / "a.mcap", both)
    with pytest.raises(InputError, match="map to base have no time in common"):
        slam(file, parent_frame="map", child_frame="base")
    up = slam(file, parent_frame="odom", child_frame="map")
    down = slam(file, parent_frame="map", child_frame="odom")
    turned = Rotation.from_quat(down.quaternion).inv()
    np.testing.assert_allclose(up.xyz_m, -turned.apply(down.xyz_m), atol=1e-12)


def test_map_to_base_link_of_the_real_recording(shared_data):
    file = shared_data / "mcap" / "nav2_turtlebot.mcap"
    chain = slam(file, parent_frame="map", child_frame="base_link")
    odom = slam(file, parent_frame="odom", child_frame="base_link")
    amcl = slam(file, topic="/amcl_pose")
    assert len(chain) > 0.95 * len(odom)
    assert set(chain.stamp_ns) <= set(odom.stamp_ns)
    near = np.searchsorted(chain.stamp_ns, amcl.stamp_ns).clip(0, len(chain) - 1)
    close = np.abs(chain.stamp_ns[near] - amcl.stamp_ns) < 5e7
    assert close.sum() > 50
    apart = np.hypot(*(chain.xyz_m[near] - amcl.xyz_m)[close, :2].T)
    assert np.median(apart) < 0.05, "AMCL publishes both: its pose, and the transform that makes it come out"
