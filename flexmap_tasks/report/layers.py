"""The layers of a release for other tools, in longitude and latitude."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from flexmap_tasks.geometry.lanelets import gather
from flexmap_tasks.geometry.polyline import arc_length_m
from flexmap_tasks.model import lanelets as lanes
from flexmap_tasks.model.alignment import JudgedPoints, Warp
from flexmap_tasks.model.arrays import Floats, Ints, Strings, strings
from flexmap_tasks.model.conflation import LaneCheck, Transfers
from flexmap_tasks.model.layers import VectorLayer
from flexmap_tasks.model.maps import LaneletMap, RoadNetwork
from flexmap_tasks.model.osm import Tags, rows_of
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import GnssTrack, Trajectory
from flexmap_tasks.report.drive import deviation

ToLonLat = Callable[[Floats], Floats]


@dataclass(frozen=True, slots=True, eq=False)
class Lanes:
    """Lanelets of the finished map as rings in the map frame, and where their middle lies.

    id : (k,) int64; ring : (k,) shapely polygons, metres; middle_m : (k, 2) float64
    """

    id: Ints
    ring: NDArray[np.object_]
    middle_m: Floats

    def places_m(self, ids: Ints) -> Floats:
        """(n, 2) the middles of the given lanelets; NaN where there is no such lanelet."""
        row = rows_of(self.id, ids)
        return np.where((row >= 0)[:, None], np.vstack([self.middle_m, [[np.nan, np.nan]]])[row], np.nan)


def lanes_of(final: LaneletMap) -> Lanes:
    """The lanelets of a map in the map frame."""
    found = lanes.lanelets_of(final)
    left, right = lanes.bound_polylines(final, found, "left"), lanes.bound_polylines(final, found, "right")
    rings = strings(
        shapely.Polygon(np.concatenate([left.xyz_m[a:b, :2], right.xyz_m[c:d, :2][::-1]]))
        for a, b, c, d in zip(left.offset, left.offset[1:], right.offset, right.offset[1:], strict=False)
    )
    middle = lanes.centrelines(final, found)
    half = (middle.offset[:-1] + middle.offset[1:]) // 2
    return Lanes(found.id, rings, middle.xyz_m[np.minimum(half, len(middle.xyz_m) - 1), :2])


def track_layers(gnss: GnssTrack, slam: Trajectory, warp: Warp, projection: Projection) -> list[VectorLayer]:
    """The tracks as lines, the fixes and the aligned poses as points."""
    before, after = warp.motion.apply_xy(slam.xyz_m[:, :2]), warp.apply(slam.xyz_m)[:, :2]
    tracks = {"gnss": gnss.xyz_m[:, :2], "slam_rigid_start": before, "slam_aligned": after}
    drawn = {name: xy_m for name, xy_m in tracks.items() if len(xy_m) > 1}
    lines = strings(shapely.LineString(projection.to_lonlat_deg(xy_m)) for xy_m in drawn.values())
    length = np.array([arc_length_m(xy_m)[-1] for xy_m in drawn.values()])
    (was, _), (now, valid) = deviation(before, gnss), deviation(after, gnss)
    sigma = np.hypot(gnss.sigma_m[:, 0], gnss.sigma_m[:, 1])
    fixes = {"row": gnss.row, "status": gnss.status, "sigma_m": sigma, "observed": gnss.observed}
    driven = arc_length_m(after) if len(after) else np.zeros(0)
    poses = {"driven_m": driven, "deviation_before_m": was, "deviation_after_m": now, "valid_gnss": valid}
    return [
        VectorLayer("tracks", "LineString", lines, {"name": strings(drawn), "length_m": length}),
        VectorLayer(
            "gnss_fixes", "Point", _points(gnss.xyz_m[:, :2], projection), _timed(fixes, gnss.stamp_ns)
        ),
        VectorLayer("slam_poses", "Point", _points(after, projection), _timed(poses, slam.stamp_ns)),
    ]


def point_layer(points: JudgedPoints, projection: Projection) -> VectorLayer:
    """Control points as lines from where the rigid start leaves them to where they belong."""
    ends = np.stack([points.source_xy_m, points.target_xy_m], axis=1)
    columns: dict[str, NDArray[Any]] = {
        "label": points.label,
        "used": points.used,
        "shift_m": np.hypot(*(points.target_xy_m - points.source_xy_m).T),
        "sigma_m": points.sigma_m,
        "residual_m": points.residual_m,
        "leave_one_out_m": points.leave_one_out_m,
        "reason": points.reason,
    }
    lonlat = projection.to_lonlat_deg(ends.reshape(-1, 2)).reshape(-1, 2, 2)
    return VectorLayer("control_points", "LineString", _geometries(shapely.linestrings(lonlat)), columns)


def map_layers(
    final: LaneletMap,
    lanelets: Lanes,
    transfers: Transfers | None,
    check: LaneCheck | None,
    projection: Projection,
) -> list[VectorLayer]:
    """Lanelets with their tags and what became of them; all lines of the map."""
    document = final.document
    rows = rows_of(document.relations.id, lanelets.id)
    tags = document.relations.tags.take(rows)
    columns: dict[str, NDArray[Any]] = {
        "id": lanelets.id,
        **{key: tags.column(key) for key in ("subtype", "location", "road_name", "speed_limit", "one_way")},
        "tags": _as_json(tags),
    }
    if check is not None:
        row = rows_of(check.lanelet_id, lanelets.id)
        columns["lane_verdict"] = strings([*check.verdict, None])[row]
        columns["lanes_map"], columns["lanes_osm"] = (
            np.where(row >= 0, np.append(c, -1)[row], -1) for c in (check.lanes_map, check.lanes_osm)
        )
    if transfers is not None:
        for action in ("set", "keep", "review"):
            of = rows_of(lanelets.id, transfers.lanelet_id[transfers.action == action])
            columns[f"values_{action}"] = np.bincount(of[of >= 0], minlength=len(lanelets.id)).astype(
                np.int64
            )
    usable = np.flatnonzero(lanes.usable_ways(document))
    lines = lanes.way_polylines(final, usable, np.zeros(len(usable), dtype=bool))
    ways = document.ways.tags.take(usable)
    named = {"id": document.ways.id[usable], "type": ways.column("type"), "subtype": ways.column("subtype")}
    return [
        VectorLayer("lanelets", "Polygon", _to_lonlat(lanelets.ring, projection), columns),
        VectorLayer("map_lines", "LineString", _lines(lines.offset, lines.xyz_m, projection), named),
    ]


def road_layer(roads: RoadNetwork) -> VectorLayer:
    """OSM's roads as they were read."""
    rows = np.flatnonzero(np.diff(roads.offset) > 1)
    offset, flat = gather(roads.offset, rows, np.zeros(len(rows), dtype=bool))
    owner = np.repeat(np.arange(len(rows)), np.diff(offset))
    tags = roads.tags.take(rows)
    columns: dict[str, NDArray[Any]] = {
        "id": roads.way_id[rows],
        "version": roads.version[rows],
        "timestamp": roads.timestamp[rows],
        **{key: tags.column(key) for key in ("highway", "name", "maxspeed", "lanes", "oneway", "surface")},
        "tags": _as_json(tags),
    }
    lines = (
        shapely.linestrings(roads.lonlat_deg[flat], indices=owner) if len(rows) else np.empty(0, dtype=object)
    )
    return VectorLayer("osm_roads", "LineString", _geometries(lines), columns)


def place_layer(
    name: str, xy_m: Floats, columns: dict[str, NDArray[Any]], projection: Projection
) -> VectorLayer:
    """Points with a place; rows whose place is not known are left out."""
    known = np.isfinite(xy_m).all(axis=1)
    return VectorLayer(
        name, "Point", _points(xy_m[known], projection), {k: c[known] for k, c in columns.items()}
    )


def link_layer(
    start_m: Floats, stop_m: Floats, columns: dict[str, NDArray[Any]], projection: Projection
) -> VectorLayer:
    """Short lines between two places each."""
    ends = np.stack([start_m, stop_m], axis=1).reshape(-1, 2)
    lines = shapely.linestrings(projection.to_lonlat_deg(ends).reshape(-1, 2, 2))
    return VectorLayer("match_links", "LineString", _geometries(lines), columns)


def _timed(columns: dict[str, NDArray[Any]], stamp_ns: Ints | None) -> dict[str, NDArray[Any]]:
    return columns if stamp_ns is None else {**columns, "stamp_ns": stamp_ns}


def _points(xy_m: Floats, projection: Projection) -> NDArray[np.object_]:
    return _geometries(shapely.points(projection.to_lonlat_deg(xy_m)))


def _lines(offset: Ints, xyz_m: Floats, projection: Projection) -> NDArray[np.object_]:
    if len(offset) < 2:
        return np.empty(0, dtype=object)
    owner = np.repeat(np.arange(len(offset) - 1), np.diff(offset))
    return _geometries(shapely.linestrings(projection.to_lonlat_deg(xyz_m[:, :2]), indices=owner))


def _to_lonlat(geometry: NDArray[np.object_], projection: Projection) -> NDArray[np.object_]:
    return _geometries(shapely.transform(geometry, projection.to_lonlat_deg)) if len(geometry) else geometry


def _geometries(values: Any) -> NDArray[np.object_]:
    return np.asarray(values, dtype=object).reshape(-1)


def _as_json(tags: Tags) -> Strings:
    return strings(
        json.dumps(tags.of_element(i), ensure_ascii=False, sort_keys=True) for i in range(len(tags))
    )
