"""Scans of a moving sensor put together to one cloud in the SLAM frame.

Every point is placed by the pose of the body at the point's own time, so that the motion during a sweep is undone;
where the points carry no time, by the pose at the scan's.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain, islice
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from flexmap_tasks.config import ScanParams, ScanTilesParams, SensorPose
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import AlignmentError, InputError
from flexmap_tasks.formats.mcap_scans import ScanSource, body_frame
from flexmap_tasks.formats.pcd import BLOCK_BYTES, Records, positions
from flexmap_tasks.formats.pcd_header import AXES, usable_names
from flexmap_tasks.formats.scan_message import Scan
from flexmap_tasks.formats.track_rows import printable
from flexmap_tasks.geometry.scan_time import NS_PER_S, PointClock, point_clock
from flexmap_tasks.geometry.se3 import (
    OUT_OF_RANGE,
    WITHOUT_POSE,
    WITHOUT_POSITION,
    Poses,
    compose,
    place_points,
)
from flexmap_tasks.ingest.tiling import tile_cloud
from flexmap_tasks.model.arrays import Bools, Floats, Ints
from flexmap_tasks.model.clouds import STAMP_FIELD, Tiles
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import Trajectory

TIME_FIELDS = ("t", "time", "timestamp", "offset_time", "time_stamp", "time_offset", "point_time")
"""Names that lidar drivers give to the time of a point (Ouster, Velodyne, Hesai, Livox, Nebula)."""

FIRST_SCANS = 5
STILL_M, STILL_RAD = 0.2, np.radians(1.0)
"""Poses this near to each other may lie any time apart: a SLAM with keyframes is silent where nothing moves."""


@stage("tiles")
def ingest_scans(source: Source, slam: Trajectory, poses: Source, params: ScanTilesParams) -> Tiles:
    """Read the scans of a recording into tiles of the SLAM frame, all their fields and the time kept.

    source : the recording with the scans; slam : the poses; poses : the file they come from, which may say of
    which frame they are. Raises InputError where the place of the sensor is not known or no scan can be placed.
    """
    topics = params.scans.topic if isinstance(params.scans.topic, tuple) else (params.scans.topic,)
    readers = [PlacedScans(source, topic, slam, poses, params) for topic in topics]
    return tile_cloud(AllScans(readers), source.name, params.tiles)


class AllScans:
    """The scans of several sensors one after the other, with the fields that all of them have."""

    def __init__(self, readers: Sequence[PlacedScans]) -> None:
        self._readers = readers
        common = [kind for kind in readers[0].fields if all(kind in r.fields for r in readers)]
        self._only_some = sorted({n for r in readers for n, _ in r.fields} - {n for n, _ in common})
        for reader in readers:
            reader.fields = common

    @property
    def points(self) -> int:
        """Points read so far."""
        return sum(reader.points for reader in self._readers)

    @property
    def record_type(self) -> np.dtype[Any]:
        """See PlacedScans."""
        return self._readers[0].record_type

    def blocks(self) -> Iterator[Records]:
        """The placed points of all sensors."""
        return chain.from_iterable(reader.blocks() for reader in self._readers)

    def findings(self) -> list[tuple[str, str, str]]:
        """(code, severity, message); complete once all blocks are read."""
        found = [row for reader in self._readers for row in reader.findings()]
        if self._only_some:
            names = printable(", ".join(self._only_some), 200)
            rule = f"the fields {names} are not the same on all topics of scans and were left out"
            found.append(("cloud-field-left-out", "warning", rule))
        return found


class PlacedScans:
    """A reader of clouds that makes the points from the scans of one topic and the poses.

    fields : (name, type) of what is kept of a point beside its place and time
    """

    def __init__(
        self, source: Source, topic: str | None, slam: Trajectory, poses: Source, params: ScanTilesParams
    ) -> None:
        if slam.stamp_ns is None:
            rule = "scans are placed by time, but these poses carry none; give TUM poses or an MCAP topic"
            raise AlignmentError(poses.name, rule)
        self._source, self._scans = source, ScanSource(source, topic)
        self._params: ScanParams = params.scans
        self._range_m = (self._params.min_range_m, self._params.max_range_m or np.inf)
        self._stamp_ns = slam.stamp_ns
        self._poses = Poses(slam.xyz_m, slam.quaternion)
        self._usable = _usable(slam, params.scans.pose_gap_s)
        first = list(islice(self._scans.scans(), FIRST_SCANS))
        self._frame = first[0][1].frame
        self._kind = first[0][1].records.dtype
        names = [n for n in self._kind.names or () if n not in AXES]
        self.fields = [(n, self._kind[n].newbyteorder("<")) for n in names]
        self._sensor = self._sensor_pose(poses, params)
        self._time_field, self._clock = self._find_time(first)
        self.points = self._unplaced = self._out_of_range = 0

    @property
    def record_type(self) -> np.dtype[Any]:
        """Coordinates as float64, the scan's own fields, the time."""
        return np.dtype([*((axis, "<f8") for axis in AXES), *self.fields, (self._stamp_name, "<f8")])

    @property
    def _stamp_name(self) -> str:
        return usable_names([STAMP_FIELD], [name for name, _ in self.fields])[0]

    def findings(self) -> list[tuple[str, str, str]]:
        """(code, severity, message); complete once all blocks are read."""
        how = (
            f"by the field {self._time_field}"
            if self._clock
            else "at the scan's time, all points of it at once"
        )
        label = self._scans.topic.label
        rows = [("cloud-of-scans", "info", f"{self._scans.topic.count:,} scans of {label} were placed {how}")]
        if self._unplaced:
            rule = f"{self._unplaced:,} points of {self.points:,} on {label} were seen where no pose is near in time"
            rows.append(("cloud-point-without-pose", "warning", f"{rule}; they were left out"))
        if self._out_of_range:
            rule = f"{self._out_of_range:,} points on {label} nearer or further than the range that was asked for"
            rows.append(("cloud-point-out-of-range", "info", f"{rule} were left out"))
        return rows

    def blocks(self) -> Iterator[Records]:
        """The placed points of many scans at a time."""
        waiting: list[Records] = []
        size = 0
        for number, (stamp_ns, scan) in enumerate(self._scans.scans(), start=1):
            self._check(scan, number)
            waiting.append(self._placed(stamp_ns, scan))
            size += waiting[-1].nbytes
            if size >= BLOCK_BYTES:
                yield np.concatenate(waiting)
                waiting, size = [], 0
        if waiting:
            yield np.concatenate(waiting)
        if self._unplaced and self._unplaced + self._out_of_range == self.points:
            raise self._no_common_time()

    def _placed(self, stamp_ns: int, scan: Scan) -> Records:
        """The points of a scan that have a pose, in the SLAM frame."""
        records = scan.records
        self.points += len(records)
        at_ns = self._times(records, stamp_ns)
        mount = self._sensor if scan.origin is None else compose(self._sensor, scan.origin)
        placed_m, state = place_points(
            positions(records), at_ns, self._stamp_ns, self._poses, self._usable, mount, self._range_m
        )
        lost = np.bincount(state, minlength=WITHOUT_POSE + 1)
        self._out_of_range += int(lost[OUT_OF_RANGE])
        self._unplaced += int(lost[WITHOUT_POSE])
        keep = state <= WITHOUT_POSITION  # the latter are counted with those of any cloud
        if keep.all():
            return self._record(records, placed_m, at_ns)
        return self._record(records[keep], placed_m[keep], at_ns[keep])

    def _record(self, records: Records, placed_m: Floats, at_ns: Ints) -> Records:
        out = np.empty(len(records), self.record_type)
        for k, axis in enumerate(AXES):
            out[axis] = placed_m[:, k]
        for name, _ in self.fields:
            out[name] = records[name]
        out[self._stamp_name] = at_ns // NS_PER_S + (at_ns % NS_PER_S) * 1e-9
        return out

    def _times(self, records: Records, stamp_ns: int) -> Ints:
        if self._clock is None:
            return np.full(len(records), stamp_ns, np.int64)
        return self._clock.at_ns(records[self._time_field], stamp_ns)

    def _check(self, scan: Scan, number: int) -> None:
        where = f"topic {self._scans.topic.label} message {number}"
        kinds = [(n, scan.records.dtype[n].newbyteorder("<")) for n in scan.records.dtype.names or ()]
        if kinds != [(n, self._kind[n].newbyteorder("<")) for n in self._kind.names or ()]:
            raise InputError(self._source.name, "its fields are not those of the first scan", where)
        if scan.frame != self._frame:
            shown = printable(f"{scan.frame!r} and not {self._frame!r} as the first", 120)
            raise InputError(self._source.name, f"the scan is in the frame {shown}", where)

    def _find_time(self, first: list[tuple[int, Scan]]) -> tuple[str, PointClock | None]:
        wanted, names = self._params.point_time, self._kind.names or ()
        candidates = [n for n in TIME_FIELDS if n in names] if wanted == "auto" else [wanted]
        if wanted == "none":
            candidates = []
        if wanted not in ("auto", "none") and wanted not in names:
            rule = f"there is no field {wanted} for point_cloud.point_time; fields are {', '.join(names)}"
            raise InputError(self._source.name, printable(rule, 400))
        for name in candidates:
            if self._kind[name].shape:
                continue
            values = [scan.records[name].astype(np.float64) for _, scan in first]
            clock = point_clock([v[np.isfinite(v)] for v in values], [stamp for stamp, _ in first])
            if clock is not None:
                return name, clock
            if any(_varies(v) for v in values):
                rule = f"the field {name} does not read as the time of points within a scan"
                raise InputError(
                    self._source.name,
                    f"{rule}; name another as point_cloud.point_time, or none of them: none",
                )
        return "", None

    def _sensor_pose(self, poses: Source, params: ScanTilesParams) -> Poses:
        """Where the frame of the scans lies in the body whose poses SLAM gives."""
        if params.scans.sensor_pose is not None:
            return _pose_of(params.scans.sensor_pose)
        body = params.scans.body_frame or body_frame(poses, params.poses)
        if body is None:
            rule = (
                "nothing says which frame the SLAM poses are of; set point_cloud.body_frame, or give the sensor's "
                "place in it as point_cloud.sensor_pose"
            )
            raise InputError(self._source.name, rule)
        if body == self._frame:
            return _pose_of(SensorPose())
        return self._scans.sensor_in(body, self._frame)

    def _no_common_time(self) -> InputError:
        first, last = self._stamp_ns[0] / NS_PER_S, self._stamp_ns[-1] / NS_PER_S
        stamp = next(self._scans.scans())[0] / NS_PER_S
        rule = (
            f"no scan falls between the poses: they reach from {first:.3f} to {last:.3f} s, the first scan is of "
            f"{stamp:.3f} s; both must use one clock"
        )
        return InputError(self._source.name, rule)


def _varies(values: Floats) -> bool:
    finite = values[np.isfinite(values)]
    return len(finite) > 0 and bool(np.ptp(finite) > 0)


def _pose_of(sensor: SensorPose) -> Poses:
    angles = [sensor.yaw_deg, sensor.pitch_deg, sensor.roll_deg]
    turn = Rotation.from_euler("ZYX", angles, degrees=True).as_quat()
    return Poses(np.array([[sensor.x_m, sensor.y_m, sensor.z_m]]), turn[None])


def _usable(slam: Trajectory, gap_s: float) -> Bools:
    """(n,) whether points may be placed between a pose and the next."""
    assert slam.stamp_ns is not None  # noqa: S101 - checked by the caller
    long = np.diff(slam.stamp_ns) > gap_s * NS_PER_S
    step_m = np.linalg.norm(np.diff(slam.xyz_m, axis=0), axis=1)
    cos = np.abs((slam.quaternion[:-1] * slam.quaternion[1:]).sum(axis=1)).clip(0, 1)
    still = (step_m <= STILL_M) & (2 * np.arccos(cos) <= STILL_RAD)
    return np.append(~long | still, True)
