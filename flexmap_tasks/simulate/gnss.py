"""What the receiver says: fixes with every error that real ones have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.simulate.chance import stream, walk
from flexmap_tasks.simulate.drive import Drive
from flexmap_tasks.simulate.world import GnssSettings, World

MODES = ("rtk_fix", "rtk_float", "dgps", "single")
MODE_STATUS = np.array([2, 2, 1, 0])
"""sensor_msgs/NavSatStatus: GBAS for both RTK modes, SBAS, plain fix."""
MODE_STRETCH_M = 80.0
NO_FIX = -1


@dataclass(frozen=True, slots=True, eq=False)
class GnssMessages:
    """Messages in the order of the log, and the truth beside them.

    time_s : (n,) true time of the fix; stamp_s : as the message says; log_s : when it was recorded
    antenna_m : (n, 3) true place of the antenna in the town's frame; error_m : (n, 3) east, north, up
    sigma_m : (n, 3) standard deviations the message claims; status : (n,) NavSatStatus
    mode : (n,) str of MODES; multipath, outage, jump, stand : (n,) bool
    """

    time_s: Floats
    stamp_s: Floats
    log_s: Floats
    antenna_m: Floats
    error_m: Floats
    sigma_m: Floats
    status: Ints
    mode: Strings
    multipath: Bools
    outage: Bools
    jump: Bools
    stand: Bools

    def take(self, rows: Ints) -> GnssMessages:
        """The given messages, in the given order."""
        return GnssMessages(*(getattr(self, name)[rows] for name in self.__slots__))


def make_gnss(world: World, drive: Drive) -> GnssMessages:
    """All fixes of the drive."""
    plan, rng = world.gnss, stream(world.seed, "gnss")
    time = np.arange(0.0, drive.duration_s, 1.0 / plan.rate_hz)
    xyz, yaw, pitch, s = drive.at(time)
    body = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, np.zeros(len(yaw))]))
    antenna = xyz + body.apply(np.array(plan.lever_arm_m))
    mode = _modes(world, s)
    white, slow = _spread(plan, mode)
    axes = np.array([1.0, 1.0, 2.0])
    error = rng.normal(0.0, 1.0, (len(time), 3)) * white[:, None] * axes
    error += np.column_stack([walk(rng, time, plan.slow_time_s) for _ in range(3)]) * slow[:, None] * axes
    stand = drive.stands(time)
    error[:, :2] += rng.normal(0.0, plan.standstill_sigma_m, (len(time), 2)) * stand[:, None]
    multipath = _reflected(world, s, error)
    jump = _jumps(world, error)
    error[:, 2] += plan.altitude_bias_m + _altitude_steps(world, s)
    sigma = np.hypot(white, slow)[:, None] * axes
    outage = _in_stretches(stream(world.seed, "outages"), s, plan.outages, plan.outage_length_m) >= 0
    status = np.where(outage, NO_FIX, MODE_STATUS[mode])
    words = np.array(MODES, dtype=object)[mode]
    stamp = time + plan.clock_offset_s
    every = GnssMessages(
        time, stamp, time + plan.latency_s, antenna, error, _claimed(world, sigma), status, words, multipath,
        outage, jump, stand
    )  # fmt: skip
    return every.take(_sent(world, every))


def _modes(world: World, s: Floats) -> Ints:
    """Row of MODES per fix: stretches of worse ones within RTK fix."""
    mode = np.zeros(len(s), dtype=np.int64)
    for k, share in enumerate((world.gnss.float_share, world.gnss.dgps_share, world.gnss.single_share), 1):
        rng = stream(world.seed, MODES[k])
        count = int(np.ceil(share * s[-1] / MODE_STRETCH_M))
        mode[_in_stretches(rng, s, count, MODE_STRETCH_M) >= 0] = k
    return mode


def _spread(plan: GnssSettings, mode: Ints) -> tuple[Floats, Floats]:
    """White and slow standard deviation per fix."""
    white = np.array(
        [plan.white_sigma_m, plan.float_sigma_m * 0.2, plan.dgps_sigma_m * 0.2, plan.single_sigma_m * 0.2]
    )
    slow = np.array([plan.slow_sigma_m, plan.float_sigma_m, plan.dgps_sigma_m, plan.single_sigma_m])
    return white[mode], slow[mode]


def _in_stretches(rng: np.random.Generator, s: Floats, count: int, length_m: float) -> Ints:
    """Number of the stretch each arc length lies in, -1 for none."""
    out = np.full(len(s), -1, dtype=np.int64)
    room = max(float(s[-1]) - length_m, 0.0)
    for k, begin in enumerate(np.sort(rng.uniform(0.05 * room, room, count))):
        out[(s >= begin) & (s <= begin + length_m)] = k
    return out


def _reflected(world: World, s: Floats, error: Floats) -> Bools:
    """Constant offsets over stretches, which no covariance admits."""
    plan, rng = world.gnss, stream(world.seed, "multipath")
    stretch = _in_stretches(rng, s, plan.multipath_stretches, plan.multipath_length_m)
    way = rng.uniform(0, 2 * np.pi, max(1, plan.multipath_stretches))
    offset = plan.multipath_offset_m * np.column_stack([np.cos(way), np.sin(way), np.zeros(len(way))])
    hit = stretch >= 0
    error[hit] += offset[stretch[hit]]
    return np.asarray(hit)


def _jumps(world: World, error: Floats) -> Bools:
    plan, rng = world.gnss, stream(world.seed, "jumps")
    rows = rng.choice(len(error), min(plan.jumps, len(error)), replace=False)
    way = rng.uniform(0, 2 * np.pi, len(rows))
    error[rows, :2] += plan.jump_m * np.column_stack([np.cos(way), np.sin(way)])
    hit = np.zeros(len(error), dtype=bool)
    hit[rows] = True
    return hit


def _altitude_steps(world: World, s: Floats) -> Floats:
    """(n,) what the altitudes of whole stretches are off by."""
    plan, rng = world.gnss, stream(world.seed, "altitude_steps")
    stretch = _in_stretches(rng, s, plan.altitude_steps, plan.altitude_step_length_m)
    way = rng.choice([-1.0, 1.0], max(1, plan.altitude_steps))
    return np.where(stretch >= 0, plan.altitude_step_m * way[stretch], 0.0)


def stated_altitudes(world: World, altitude_m: Floats) -> Floats:
    """(n,) altitudes as the receiver writes them: rounded, or none at all."""
    plan = world.gnss
    if plan.altitude != "measured":
        return np.full(len(altitude_m), 0.0 if plan.altitude == "zero" else np.nan)
    if plan.altitude_resolution_m == 0.0:
        return altitude_m
    return np.asarray(np.round(altitude_m / plan.altitude_resolution_m) * plan.altitude_resolution_m)


def _claimed(world: World, sigma: Floats) -> Floats:
    """Standard deviations as the message states them; NaN where it states none."""
    if world.gnss.covariance == "unknown":
        return np.full_like(sigma, np.nan)
    if world.gnss.covariance == "optimistic":
        return sigma * 0.2
    if world.gnss.covariance == "wrong":
        rng = stream(world.seed, "covariance")
        return np.asarray(sigma.mean() * np.exp(rng.normal(0.0, 1.5, (len(sigma), 1))) * np.ones(3))
    return np.asarray(np.maximum(sigma, 1e-4))


def _sent(world: World, every: GnssMessages) -> Ints:
    """Rows of the messages that reach the log: some dropped, some twice, none in an outage."""
    plan, rng = world.gnss, stream(world.seed, "messages")
    lot = rng.uniform(size=len(every.time_s))
    copies = np.where(lot < plan.dropped_share, 0, np.where(lot > 1.0 - plan.doubled_share, 2, 1))
    if not plan.outage_messages:
        copies = np.where(every.outage, 0, copies)
    return np.repeat(np.arange(len(copies)), copies)
