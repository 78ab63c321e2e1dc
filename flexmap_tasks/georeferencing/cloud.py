"""The cloud moved by the warp: tile by tile of the SLAM frame into tiles of the map frame.

Each SLAM tile is warped and cut on its own; a map tile then joins the parts it got. So a change of the warp
reaches exactly the SLAM tiles it touches and the map tiles that have a part of them.
"""

from __future__ import annotations

import numpy as np

from flexmap_tasks.config import CloudCheckParams, PcdParams, PointCloudParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import CoverageError
from flexmap_tasks.formats.pcd import pcd_bytes
from flexmap_tasks.formats.pointcloud_metadata import metadata_bytes
from flexmap_tasks.geometry.tiles import group_by_tile
from flexmap_tasks.model.alignment import Extent, Warp
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.clouds import (
    STAMP_FIELD,
    CloudFrame,
    PointCloud,
    TileIndex,
    TileKeys,
    cloud_findings,
    tile_key,
    tile_numbers,
)
from flexmap_tasks.model.maps import Findings
from flexmap_tasks.model.tracks import Trajectory

EDGE_M = 0.001
"""Rounding may leave a point this little outside of its tile's box."""

HALF_MILLIMETRE_M = 16_384.0
"""Up to here float32 is off by less than half a millimetre, from here on by up to a whole one, and so on."""

STRAY_M = 500.0
"""A cloud further from the poses than any lidar sees does not belong to them."""

MAX_COORDINATE_M = 1e8
LATEST_S = 9e9
"""Later stamps do not fit 64 bits of nanoseconds."""
NORMALS = (("normal_x", "normal_y"), ("nx", "ny"))


def tile_extent(key: str, params: PointCloudParams) -> Extent:
    """The box that holds all points of a tile, a millimetre wider than its nominal one."""
    low_x, low_y = (n * params.tile_size_m for n in tile_numbers(key))
    size = params.tile_size_m
    return Extent(low_x - EDGE_M, low_y - EDGE_M, low_x + size + EDGE_M, low_y + size + EDGE_M)


@stage("warped_tile")
def warp_tile(
    tile: PointCloud, warp: Warp | None, frame: CloudFrame | None, params: PointCloudParams
) -> dict[str, PointCloud]:
    """The points of one SLAM tile in the map frame, by map tile; their order is kept within each.

    frame : the projector's frame, where it is not the map frame itself; tiles are then cut in it.

    Normals (normal_x, normal_y or nx, ny) turn with the warp's local yaw. All other fields stay as they are.
    Without a warp the SLAM frame is the map frame.

    Raises CoverageError when the warp moves a point beyond any map frame.
    """
    xyz_m = tile.xyz_m.copy() if warp is None else _moved(tile, warp)
    if not (np.abs(xyz_m) <= MAX_COORDINATE_M).all():
        raise CoverageError(
            "alignment", "the warp moves points of the cloud out of any map frame; check the control points"
        )
    if frame is not None:
        xyz_m += (frame.origin_x_m, frame.origin_y_m, 0.0)
    normals = {} if warp is None else _turned_normals(tile, warp)
    moved = PointCloud(xyz_m, {**tile.fields, **normals})
    order, starts, cells = group_by_tile(xyz_m[:, :2], params.tile_size_m)
    bounds = zip(cells.tolist(), starts[:-1].tolist(), starts[1:].tolist(), strict=True)
    return {tile_key(x, y): moved.take(order[first:last]) for (x, y), first, last in bounds}


@stage("pcd_tile")
def merge_tile(parts: dict[str, PointCloud], params: PcdParams) -> dict[str, bytes]:
    """One map tile as a binary PCD file `tile.pcd`; `parts` by the key of the SLAM tile they come from.

    Parts follow each other in the order of (ix, iy) of their SLAM tiles.
    """
    clouds = [parts[key] for key in sorted(parts, key=tile_numbers)]
    names = list(clouds[0].fields)
    joined = PointCloud(
        np.concatenate([c.xyz_m for c in clouds]),
        {name: np.concatenate([c.fields[name] for c in clouds]) for name in names},
    )
    return {"tile.pcd": pcd_bytes(joined, params.coordinates)}


@stage("pointcloud_metadata")
def pointcloud_metadata(tiles: TileKeys, params: PointCloudParams) -> dict[str, bytes]:
    """`pointcloud_map_metadata.yaml` for map tiles that lie in files `<key>.pcd`."""
    corners = {
        f"{key}.pcd": (x * params.tile_size_m, y * params.tile_size_m)
        for key in sorted(tiles.key.tolist(), key=tile_numbers)
        for x, y in [tile_numbers(key)]
    }
    return {"pointcloud_map_metadata.yaml": metadata_bytes(params.tile_size_m, corners)}


@stage("cloud_findings")
def check_cloud(
    found: Findings, index: TileIndex, slam: Trajectory, tiles: TileKeys, params: CloudCheckParams
) -> Findings:
    """What reading the cloud brought to light, and what is odd about where it lies.

    index : the tiles of the SLAM frame; tiles : those of the map
    """
    rows = list(zip(found.code, found.severity, found.message, strict=True))
    apart_m = _apart_m(index, slam)
    if apart_m > STRAY_M:
        rule = f"the cloud lies {apart_m:.0f} m from the nearest pose's box; is it in the SLAM frame of these poses?"
        rows.append(("cloud-far-from-drive", "warning", rule))
    if params.coordinates == "float32":
        rows += _coarse(tiles, params.tile_size_m)
    return cloud_findings(rows)


def _apart_m(index: TileIndex, slam: Trajectory) -> float:
    """Between the boxes of cloud and poses, metres in the plane."""
    low, high = slam.xyz_m[:, :2].min(axis=0), slam.xyz_m[:, :2].max(axis=0)
    cloud_low = np.array([index.x_min_m.min(initial=np.inf), index.y_min_m.min(initial=np.inf)])
    cloud_high = np.array([index.x_max_m.max(initial=-np.inf), index.y_max_m.max(initial=-np.inf)])
    gap = np.maximum(np.maximum(cloud_low - high, low - cloud_high), 0.0)
    return float(np.hypot(*gap))


def _coarse(tiles: TileKeys, size_m: int) -> list[tuple[str, str, str]]:
    """A finding where float32 moves points by half a millimetre or more."""
    cells = np.array([tile_numbers(k) for k in tiles.key.tolist()], dtype=np.int64).reshape(-1, 2)
    reach_m = np.maximum(np.abs(cells), np.abs(cells + 1)).max(axis=1, initial=0) * size_m
    far = int((reach_m > HALF_MILLIMETRE_M).sum())
    if not far:
        return []
    most_m = float(reach_m.max())
    error_mm = 1000 * float(np.spacing(np.float32(np.nextafter(np.float32(most_m), 0)))) / 2
    message = (
        f"{far} of {len(cells)} tiles lie over 16 km from the frame's origin; float32 coordinates up to "
        f"{most_m / 1000:.1f} km are off by up to {error_mm:.1f} mm; choose a nearer projection.origin, another "
        "projector than MGRS, or point_cloud.coordinates float64"
    )
    return [("cloud-far-from-origin", "warning", message)]


def _moved(tile: PointCloud, warp: Warp) -> Floats:
    """The points moved by the corrections of the time each was seen at; by place where a time is not known."""
    stamp_s = tile.fields.get(STAMP_FIELD)
    if stamp_s is None or stamp_s.dtype != np.float64 or stamp_s.ndim != 1:
        return np.asarray(warp.apply(tile.xyz_m), dtype=np.float64)
    known = (stamp_s >= 0) & (stamp_s < LATEST_S)
    stamp_ns = np.rint(np.where(known, stamp_s, 0.0) * 1e9).astype(np.int64)
    return warp.apply_at(tile.xyz_m, np.where(known, stamp_ns, -1))


def _turned_normals(tile: PointCloud, warp: Warp) -> dict[str, Floats]:
    pairs = [p for p in NORMALS if all(n in tile.fields and tile.fields[n].dtype.kind == "f" for n in p)]
    if not pairs:
        return {}
    bend = warp.jacobian(tile.xyz_m)
    yaw = np.arctan2(bend[:, 1, 0] - bend[:, 0, 1], bend[:, 0, 0] + bend[:, 1, 1])  # of the nearest rotation
    cos, sin = np.cos(yaw), np.sin(yaw)
    out: dict[str, Floats] = {}
    for name_x, name_y in pairs:
        x, y = (tile.fields[n].astype(np.float64) for n in (name_x, name_y))
        out[name_x] = (cos * x - sin * y).astype(tile.fields[name_x].dtype)
        out[name_y] = (sin * x + cos * y).astype(tile.fields[name_y].dtype)
    return out
