"""What SLAM makes of the drive: a track that wanders off, and a map that wanders with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.sparse import csr_array
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.simulate.chance import stream, walk
from flexmap_tasks.simulate.drive import Drive
from flexmap_tasks.simulate.world import SlamSettings, World

STEP_M = 1.0
REVISIT_M, REVISIT_APART_M, CLOSURE_SIGMA_M, CLOSURE_SIGMA_RAD = 14.0, 60.0, 0.02, 1e-3
LIDAR_REACH_M = 60.0
"""Beyond this a heading error turns nothing: no lidar maps there, the drift just goes on."""
BLEND_M, BLEND_POSES, BLEND_ROWS, CELL_M = 12.0, 40, 20_000, 5.0


@dataclass(frozen=True, slots=True, eq=False)
class DriftField:
    """How far the map made by SLAM lies off at every place of the town.

    The correction of a place is the Gaussian blend of the corrections of the poses nearest to it, each turned
    by its heading error about its pose. It is kept on a grid and read bilinearly, so map, cloud and truth see
    the very same drift. offset_m : (ny, nx, 3); low_m : (2,) the first grid point; None offset: no drift.
    """

    low_m: Floats
    cell_m: float
    offset_m: Floats | None

    def __call__(self, xyz_m: Floats) -> Floats:
        """(n, 3) displacement in the town's frame of places (n, 3)."""
        if self.offset_m is None:
            return np.zeros((len(xyz_m), 3))
        at = ((xyz_m[:, :2] - self.low_m) / self.cell_m).T[::-1]
        return np.column_stack(
            [map_coordinates(self.offset_m[:, :, k], at, order=1, mode="nearest") for k in range(3)]
        )


@dataclass(frozen=True, slots=True, eq=False)
class SlamTrack:
    """The odometry, and what leads from the town to the SLAM frame.

    time_s : (n,) since the start; true_xyz_m, true_yaw_rad, true_pitch_rad, s_m : the truth of every pose
    xyz_m, quaternion : (n, 3), (n, 4) x y z w, as SLAM says, in the SLAM frame
    rotation, origin_m, start_m : x_slam = rotation @ (x_town + drift - origin_m) + start_m
    """

    time_s: Floats
    s_m: Floats
    true_xyz_m: Floats
    true_yaw_rad: Floats
    true_pitch_rad: Floats
    xyz_m: Floats
    quaternion: Floats
    rotation: Floats
    origin_m: Floats
    start_m: Floats
    field: DriftField

    def to_slam(self, xyz_m: Floats) -> Floats:
        """Where SLAM's map shows places of the town."""
        return np.asarray((xyz_m + self.field(xyz_m) - self.origin_m) @ self.rotation.T + self.start_m)

    def to_town(self, slam_m: Floats) -> Floats:
        """Inverse of `to_slam`, by fixed-point iteration to under a micrometre."""
        bare = (slam_m - self.start_m) @ self.rotation + self.origin_m
        out = bare
        for _ in range(30):
            before, out = out, bare - self.field(out)
            if len(out) == 0 or float(np.abs(out - before).max()) < 1e-7:
                break
        return np.asarray(out)


def make_slam(world: World, drive: Drive, low_m: Floats, high_m: Floats) -> SlamTrack:
    """The track, and the drift over the town's box low_m..high_m (2,)."""
    plan = world.slam
    s, shift, turn, dip = _drift(world, drive)
    time = np.arange(0.0, drive.duration_s, 1.0 / plan.rate_hz)
    time = _keyframes(time, drive.at(time)[3], plan.keyframe_m)
    xyz, yaw, pitch, at = drive.at(time)
    rng = stream(world.seed, "slam_noise")
    noise = rng.normal(0.0, 1.0, (len(time), 3)) * plan.position_noise_m * np.array([1.0, 1.0, 0.5])
    wobble = rng.normal(0.0, 1e-3 * plan.angle_noise_mrad, (len(time), 3))
    noise[0] = wobble[0] = 0.0
    moved = xyz + np.column_stack([np.interp(at, s, shift[:, k]) for k in range(3)]) + noise
    angles = np.column_stack([yaw + np.interp(at, s, turn), pitch + np.interp(at, s, dip), np.zeros(len(at))])
    rotation = _frame_rotation(plan, float(yaw[0]))
    start = np.array(plan.start_offset_m)
    body = Rotation.from_matrix(rotation) * Rotation.from_euler("ZYX", angles + wobble)
    field = _field(drive, s, shift, turn, low_m, high_m)
    return SlamTrack(
        time,
        at,
        xyz,
        yaw,
        pitch,
        (moved - xyz[0]) @ rotation.T + start,
        body.as_quat(),
        rotation,
        xyz[0],
        start,
        field,
    )


def _frame_rotation(plan: SlamSettings, yaw_rad: float) -> Floats:
    """Town to SLAM frame: the first pose has the given heading, and the frame may be tilted."""
    level = Rotation.from_euler("z", np.radians(plan.start_yaw_deg) - yaw_rad)
    tilt = Rotation.from_euler("xy", np.radians([plan.tilt_roll_deg, plan.tilt_pitch_deg]))
    return np.asarray((tilt * level).as_matrix())


def _keyframes(time: Floats, s: Floats, least_m: float) -> Floats:
    if least_m <= 0:
        return time
    step = np.floor(s / least_m)
    return np.asarray(time[np.flatnonzero(np.diff(step, prepend=-1.0) > 0)])


def _drift(world: World, drive: Drive) -> tuple[Floats, Floats, Floats, Floats]:
    """Arc lengths (k,), shift (k, 3), heading error and pitch error along the drive."""
    plan, rng = world.slam, stream(world.seed, "slam_drift")
    s = np.arange(0.0, float(drive.s_m[-1]) + STEP_M, STEP_M)
    keep = np.concatenate([[True], np.diff(drive.s_m) > 0])
    xyz = np.column_stack([np.interp(s, drive.s_m[keep], drive.xyz_m[keep, k]) for k in range(3)])
    root = np.sqrt(STEP_M)
    turn_steps = rng.normal(0.0, 1e-3 * plan.yaw_walk_mrad_per_sqrt_m * root, len(s))
    dip_steps = rng.normal(0.0, 1e-3 * plan.pitch_walk_mrad_per_sqrt_m * root, len(s))
    scale = plan.scale_sigma * walk(rng, s, plan.scale_length_m)
    jitter = rng.normal(0.0, plan.position_walk_m_per_sqrt_m * root, (len(s), 3)) * np.array([1.0, 1.0, 0.5])
    turn_steps[0] = dip_steps[0] = 0.0
    pairs = _revisits(xyz) if plan.loop_closure != "none" else np.empty((0, 2), dtype=np.int64)
    angles = np.column_stack([turn_steps, dip_steps])
    turn, dip = _accumulated(angles, pairs, np.zeros((len(pairs), 2)), CLOSURE_SIGMA_RAD, plan.loop_closure).T
    step = np.diff(xyz, axis=0, prepend=xyz[:1])
    cosine, sine = np.cos(turn), np.sin(turn)
    grown = (1.0 + scale)[:, None] * np.column_stack(
        [cosine * step[:, 0] - sine * step[:, 1], sine * step[:, 0] + cosine * step[:, 1], step[:, 2]]
    )
    grown[:, 2] -= STEP_M * np.tan(dip)
    jitter[0] = 0.0
    now, then = pairs.T
    beside = _turned(xyz[now] - xyz[then], turn[then])
    shift = _accumulated(grown - step + jitter, pairs, beside, CLOSURE_SIGMA_M, plan.loop_closure)
    return s, shift, turn, dip


def _turned(arm: Floats, turn: Floats) -> Floats:
    """How far the end of each arm (n, 3) moves when it is turned about z."""
    c, sn = np.cos(turn) - 1.0, np.sin(turn)
    return np.column_stack(
        [c * arm[:, 0] - sn * arm[:, 1], sn * arm[:, 0] + c * arm[:, 1], np.zeros(len(arm))]
    )


def _revisits(xyz: Floats) -> Ints:
    """(m, 2) rows (now, then) of places passed before, about every 5 m."""
    tree = cKDTree(xyz[:, :2])
    found = []
    for i in range(0, len(xyz), 5):
        near = np.array(tree.query_ball_point(xyz[i, :2], REVISIT_M), dtype=np.int64)
        near = near[(near < i - REVISIT_APART_M / STEP_M) & (np.abs(xyz[near, 2] - xyz[i, 2]) < 3.0)]
        if len(near):
            found.append((i, int(near[np.argmin(np.hypot(*(xyz[near, :2] - xyz[i, :2]).T))])))
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def _accumulated(steps: Floats, pairs: Ints, beside: Floats, sigma: float, closure: str) -> Floats:
    """Sum of errors (n, k) along the way; `pairs` (m, 2) pull (smoothed) or throw (jumps) it back.

    beside : (m, k) by how much the error now should differ from the one then, since the places differ
    """
    total = np.cumsum(steps, axis=0)
    if len(pairs) == 0 or not steps.any():
        return total
    if closure == "jumps":
        return _with_jumps(steps, pairs, beside)
    n = len(steps)
    spread = np.maximum(np.std(steps, axis=0).mean(), 1e-9)
    steps_of = csr_array(
        (np.repeat([1.0, -1.0], [n, n - 1]), (np.r_[0:n, 1:n], np.r_[0:n, 0 : n - 1])), shape=(n, n)
    )
    smooth = steps_of / spread
    rows = np.arange(len(pairs))
    tie = csr_array(
        (np.repeat([1.0, -1.0], len(pairs)) / sigma, (np.tile(rows, 2), pairs.T.ravel())),
        shape=(len(pairs), n),
    ).tocsr()
    normal = (smooth.T @ smooth + tie.T @ tie).tocsc()
    right = smooth.T @ (steps / spread) + tie.T @ (beside / sigma)
    return np.column_stack([spsolve(normal, right[:, k]) for k in range(steps.shape[1])])


def _with_jumps(steps: Floats, pairs: Ints, beside: Floats) -> Floats:
    """Errors of a tracker that snaps back to its old map when it comes to a known place."""
    out = np.cumsum(steps, axis=0)
    last = -(10**9)
    for (now, then), gap in zip(pairs.tolist(), beside, strict=True):
        if now - last > 40:
            out[now:] += out[then] + gap - out[now]
            last = now
    return out


def _field(drive: Drive, s: Floats, shift: Floats, turn: Floats, low_m: Floats, high_m: Floats) -> DriftField:
    if not shift.any():
        return DriftField(low_m, CELL_M, None)
    keep = np.concatenate([[True], np.diff(drive.s_m) > 0])
    xy = np.column_stack([np.interp(s, drive.s_m[keep], drive.xyz_m[keep, k]) for k in range(2)])[::2]
    shift, turn = shift[::2], turn[::2]
    cell = max(CELL_M, float((high_m - low_m).max()) / 1500.0)
    nx, ny = (np.ceil((high_m - low_m) / cell).astype(int) + 1).tolist()
    grid = np.stack(np.meshgrid(np.arange(nx), np.arange(ny)), axis=-1).reshape(-1, 2) * cell + low_m
    tree = cKDTree(xy)
    parts = [
        _blended(part, tree, xy, shift, turn) for part in np.array_split(grid, len(grid) // BLEND_ROWS + 1)
    ]
    return DriftField(low_m, cell, np.vstack(parts).reshape(ny, nx, 3))


def _blended(places: Floats, tree: cKDTree, xy: Floats, shift: Floats, turn: Floats) -> Floats:
    """(n, 3) blend of the corrections of the poses nearest to each place (n, 2)."""
    near_m, near = tree.query(places, k=min(BLEND_POSES, len(xy)))
    near_m, near = np.reshape(near_m, (len(places), -1)), np.reshape(near, (len(places), -1))
    width = np.hypot(BLEND_M, 0.4 * near_m[:, :1])
    weight = np.exp((near_m[:, :1] ** 2 - near_m**2) / (2 * width**2))
    weight /= weight.sum(axis=1, keepdims=True)
    arm = places[:, None] - xy[near]
    arm *= np.minimum(1.0, LIDAR_REACH_M / np.maximum(near_m, 1.0))[..., None]
    c, sn = np.cos(turn[near]) - 1.0, np.sin(turn[near])
    east = shift[near, 0] + c * arm[..., 0] - sn * arm[..., 1]
    north = shift[near, 1] + sn * arm[..., 0] + c * arm[..., 1]
    return np.column_stack([(weight * v).sum(axis=1) for v in (east, north, shift[near, 2])])
