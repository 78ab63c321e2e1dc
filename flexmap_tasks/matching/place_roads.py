"""OpenStreetMap's roads brought into the frame the lanelet map lies in."""

from __future__ import annotations

import numpy as np
import shapely

from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import CoverageError
from flexmap_tasks.model.alignment import Warp
from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.maps import GeoBox, PlacedRoads, RoadNetwork
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import GnssTrack

NEAR_M = 100.0
"""A vehicle so far from every road of the extract drives where the extract does not reach."""
CELL_M = 10.0
"""The track counts once per cell of this size, however long the vehicle stood there."""
COVERED_SHARE = 0.5


@stage("placed_roads")
def place_roads(
    roads: RoadNetwork, projection: Projection, gnss: GnssTrack, warp: Warp | None
) -> PlacedRoads:
    """The roads in the map frame; with a warp, moved back by it into the frame of the SLAM (`master: slam`).

    Raises CoverageError when most of the track is far from every road.
    """
    xy_m = projection.to_xy_m(roads.lonlat_deg)
    _check_cover(roads, xy_m, gnss, projection)
    if warp is not None:
        xyz_m = np.column_stack([xy_m, np.full(len(xy_m), np.nan)])
        xy_m = np.ascontiguousarray(warp.inverse().apply(xyz_m)[:, :2])
    return PlacedRoads(roads, xy_m)


def _check_cover(roads: RoadNetwork, xy_m: Floats, gnss: GnssTrack, projection: Projection) -> None:
    """Refuse roads of another place, and an extract that covers less than half of the track."""
    track = gnss.xyz_m[:, :2]
    _, first = np.unique(np.floor(track / CELL_M), axis=0, return_index=True)
    places = track[np.sort(first)]
    if len(roads) == 0:
        rule = "it holds no road vehicles drive on; give an extract that covers the track, or leave OSM out"
        raise CoverageError("OpenStreetMap", rule)
    if not np.isfinite(xy_m).all():
        rule = (
            f"its roads reach too far from the track to be placed in zone {projection.zone}; cut the extract"
        )
        raise CoverageError("OpenStreetMap", f"{rule}. Roads: {_box(roads.lonlat_deg)}")
    near = shapely.STRtree(road_lines(xy_m, roads.offset)).query(
        shapely.points(places), predicate="dwithin", distance=NEAR_M
    )[0]
    share = len(np.unique(near)) / max(len(places), 1)
    if share < COVERED_SHARE:
        rule = (
            f"the extract does not cover the track: {share:.0%} of it has a road within {NEAR_M:.0f} m. "
            f"Roads: {_box(roads.lonlat_deg)}. Track: {_box(projection.to_lonlat_deg(track))}"
        )
        raise CoverageError("OpenStreetMap", rule)


def road_lines(xy_m: Floats, offset: Ints) -> shapely.Geometry:
    """(w,) one line per road of at least two vertices."""
    return shapely.linestrings(xy_m, indices=np.repeat(np.arange(len(offset) - 1), np.diff(offset)))


def _box(lonlat_deg: Floats) -> GeoBox:
    (west, south), (east, north) = np.nanmin(lonlat_deg, axis=0), np.nanmax(lonlat_deg, axis=0)
    return GeoBox(float(west), float(south), float(east), float(north))
