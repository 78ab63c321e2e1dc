"""The drive and the map as a recording for Foxglove and Lichtblick."""

from __future__ import annotations

import numpy as np
import shapely

from flexmap_tasks.formats.geojson import geojson
from flexmap_tasks.formats.mcap_foxglove_write import (
    Messages,
    alone,
    foxglove_mcap,
    location_fixes,
    poses_in_frame,
    scene_lines,
)
from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.conflation import LaneCheck
from flexmap_tasks.model.layers import VectorLayer
from flexmap_tasks.model.osm import rows_of
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import GnssTrack, Trajectory
from flexmap_tasks.report.layers import Lanes

STEP_NS = 100_000_000
"""Between rows of a recording that has no time of its own."""

FRAME = "map"
COLOURS = {
    "agree": (0.0, 0.62, 0.45, 1.0),
    "differ": (0.84, 0.37, 0.0, 1.0),
    "unknown": (0.34, 0.71, 0.91, 1.0),
    "unmatched": (0.8, 0.8, 0.8, 1.0),
}
"""Of lanelets by the verdict of the lane check; the same as in the report."""


def foxglove_recording(
    gnss: GnssTrack,
    start: Floats,
    slam: Trajectory,
    aligned: Trajectory,
    lanelets: tuple[Lanes, LaneCheck | None, VectorLayer] | None,
    projection: Projection,
) -> bytes:
    """The file: fixes, poses after the rigid start and after the warp, and the lanelets at its beginning.

    start : (n, 3) the poses after the rigid start, map frame
    """
    fix_ns, pose_ns = _times(gnss.stamp_ns, len(gnss)), _times(slam.stamp_ns, len(slam))
    fixes = location_fixes(
        fix_ns, projection.to_lonlat_deg(gnss.xyz_m[:, :2]), gnss.xyz_m[:, 2], gnss.sigma_m, FRAME
    )
    topics: dict[str, tuple[str, Messages]] = {
        "/gnss": ("foxglove.LocationFix", fixes),
        "/slam/rigid_start": (
            "foxglove.PoseInFrame",
            poses_in_frame(pose_ns, start, slam.quaternion, FRAME),
        ),
        "/slam/aligned": (
            "foxglove.PoseInFrame",
            poses_in_frame(pose_ns, aligned.xyz_m, aligned.quaternion, FRAME),
        ),
    }
    if lanelets is not None:
        first_ns = int(min([*fix_ns[:1].tolist(), *pose_ns[:1].tolist()], default=0))
        lanes, check, layer = lanelets
        topics["/map/lanelets"] = ("foxglove.SceneUpdate", _scene(first_ns, lanes, check))
        topics["/map/geojson"] = ("foxglove.GeoJSON", alone(first_ns, {"geojson": geojson(layer).decode()}))
    return foxglove_mcap(topics)


def _times(stamp_ns: Ints | None, count: int) -> Ints:
    return np.arange(1, count + 1, dtype=np.int64) * STEP_NS if stamp_ns is None else stamp_ns


def _scene(log_ns: int, lanes: Lanes, check: LaneCheck | None) -> Messages:
    verdict = np.full(len(lanes.id), "unknown", dtype=object)
    if check is not None:
        row = rows_of(check.lanelet_id, lanes.id)
        verdict[row >= 0] = check.verdict[row[row >= 0]]
    entities = {}
    for name, colour in COLOURS.items():
        rings = lanes.ring[verdict == name]
        flat, owner = shapely.get_coordinates(rings, return_index=True)
        flat = np.column_stack([flat, np.zeros(len(flat))])
        same = owner[1:] == owner[:-1]
        entities[f"lanelets {name}"] = (np.stack([flat[:-1][same], flat[1:][same]], axis=1), colour)
    return scene_lines(log_ns, FRAME, entities)
