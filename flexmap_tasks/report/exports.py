"""Everything of a release in the formats of the tools that people already use."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from scipy.spatial.transform import Rotation

from flexmap_tasks.config import ReportParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.formats.geojson import geojson
from flexmap_tasks.formats.geopackage import geopackage
from flexmap_tasks.formats.geoparquet import geoparquet
from flexmap_tasks.formats.kml import kml
from flexmap_tasks.formats.qgis import Look, qgis_project
from flexmap_tasks.formats.track_text_write import kitti_text, tum_text
from flexmap_tasks.model.conflation import Matches
from flexmap_tasks.model.layers import VectorLayer
from flexmap_tasks.model.maps import OSM_ATTRIBUTION, Findings, LaneletMap
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.shown import Shown
from flexmap_tasks.model.tracks import Trajectory
from flexmap_tasks.report import layers as make
from flexmap_tasks.report.bundle_check import CODES
from flexmap_tasks.report.decisions import Links, finding_places, links_between
from flexmap_tasks.report.foxglove import foxglove_recording
from flexmap_tasks.report.issues import issues_json
from flexmap_tasks.report.josm import josm_layer
from flexmap_tasks.report.maps import moved
from flexmap_tasks.report.report import final_map_of
from flexmap_tasks.report.review_items import ReviewItems, review_items

PACKAGE = "flexmap.gpkg"
IN_KML = ("tracks", "control_points", "lanelets", "review")
NAMES = {"tracks": "name", "control_points": "label", "lanelets": "id", "review": "subject"}

LOOKS = {
    "review": Look("240,160,0,255", "255,255,255,255", 3.0),
    "findings": Look("138,63,156,255", "255,255,255,255", 2.6),
    "control_points": Look("192,59,0,255", "0,0,0,255", 0.7),
    "match_links": Look("0,79,134,255", "0,0,0,255", 0.3, shown=False),
    "tracks": Look(
        "0,114,178,255",
        "0,0,0,255",
        0.6,
        column="name",
        classes={
            "gnss": "60,70,83,255",
            "slam_rigid_start": "196,92,150,255",
            "slam_aligned": "0,114,178,255",
        },
    ),
    "slam_poses": Look("0,114,178,255", "255,255,255,0", 1.0, shown=False),
    "gnss_fixes": Look("60,70,83,255", "255,255,255,0", 0.9, shown=False),
    "lanelets": Look(
        "86,180,233,90",
        "90,100,112,255",
        0.15,
        column="lane_verdict",
        classes={
            "agree": "0,158,115,130",
            "differ": "213,94,0,190",
            "unknown": "86,180,233,110",
            "unmatched": "255,255,255,200",
        },
    ),
    "map_lines": Look("102,114,127,255", "0,0,0,255", 0.2),
    "osm_roads": Look("194,180,143,255", "0,0,0,255", 0.9),
}
"""Layers from top to bottom, and how QGIS draws them; colours as in the report."""


@stage("layers")
def export_layers(shown: Shown, aligned: Trajectory, params: ReportParams) -> dict[str, bytes]:
    """Files by name: flexmap.gpkg and flexmap.qgs, a GeoJSON and a GeoParquet per layer, flexmap.kml, flexmap.mcap,
    the aligned trajectory for evo, review.osm for JOSM, issues.json; ATTRIBUTION.txt where roads were used.

    aligned : the poses in the map frame
    """
    final = final_map_of(shown)
    lanelets = make.lanes_of(final) if final is not None else None
    items = review_items(shown.matches, shown.transfers, shown.lane_check, shown.changes)
    layers = _layers(shown, final, lanelets, items)
    files = _vector_files(params.map, layers)
    drawn = next((layer for layer in layers if layer.name == "lanelets" and lanelets), None)
    on_map = (lanelets, shown.lane_check, drawn) if lanelets is not None and drawn is not None else None
    slam, projection = shown.slam, shown.projection
    start = np.column_stack([shown.warp.motion.apply_xy(slam.xyz_m[:, :2]), slam.xyz_m[:, 2]])
    files["flexmap.mcap"] = foxglove_recording(shown.gnss, start, slam, aligned, on_map, projection)
    files |= _trajectory(aligned)
    if lanelets is not None:
        files["review.osm"] = josm_layer(items, lanelets, projection)
    told = {
        "flexmap-drive": (shown.drive_findings, ()),
        "flexmap-map": (shown.map_findings, ()),
        "flexmap-conflation": (shown.transfer_findings, ()),
        "flexmap-bundle": (shown.bundle_findings, CODES),
        "flexmap-cloud": (shown.cloud_findings, ()),
    }
    files["issues.json"] = issues_json({k: (f, codes) for k, (f, codes) in told.items() if f is not None})
    if shown.roads is not None:
        files["ATTRIBUTION.txt"] = f"{OSM_ATTRIBUTION}\n".encode()
    return files


def _layers(
    shown: Shown, final: LaneletMap | None, lanelets: make.Lanes | None, items: ReviewItems
) -> list[VectorLayer]:
    """All layers of features, from top to bottom."""
    projection, roads, matches = shown.projection, shown.roads, shown.matches
    layers = make.track_layers(shown.gnss, shown.slam, shown.warp, projection)
    if shown.control_points is not None:
        layers.append(make.point_layer(shown.control_points, projection))
    if final is not None and lanelets is not None:
        layers += make.map_layers(final, lanelets, shown.transfers, shown.lane_check, projection)
        layers.append(_review(items, lanelets, projection))
        noticed = [f for f in (shown.map_findings, shown.transfer_findings) if f is not None]
        layers += [_findings(noticed, final, lanelets, projection)] if noticed else []
    if roads is not None:
        layers.append(make.road_layer(roads))
    if roads is not None and matches is not None and shown.source_map is not None:
        xy_m = projection.to_xy_m(roads.lonlat_deg)
        ends = links_between(matches, moved(shown.source_map, shown.warp), roads, xy_m)
        layers.append(_links(ends, matches, projection))
    order = list(LOOKS)
    return sorted(layers, key=lambda layer: order.index(layer.name))


def _vector_files(title: str, layers: Sequence[VectorLayer]) -> dict[str, bytes]:
    bounds = np.array(
        [shapely.total_bounds(layer.geometry) for layer in layers if len(layer) and layer.name != "osm_roads"]
    )
    known = bounds[np.isfinite(bounds).all(axis=1)].reshape(-1, 4)
    extent = (
        [*known[:, :2].min(axis=0), *known[:, 2:].max(axis=0)] if len(known) else [-180.0, -90.0, 180.0, 90.0]
    )
    return {
        PACKAGE: geopackage(layers),
        "flexmap.qgs": qgis_project(title, PACKAGE, layers, LOOKS, extent),
        "flexmap.kml": kml(title, [_without_tags(layer) for layer in layers if layer.name in IN_KML], NAMES),
        **{f"{layer.name}.geojson": geojson(layer) for layer in layers},
        **{f"{layer.name}.parquet": geoparquet(layer) for layer in layers},
    }


def _without_tags(layer: VectorLayer) -> VectorLayer:
    """KML is for looking; the tags as one long text are not."""
    columns = {name: column for name, column in layer.columns.items() if name != "tags"}
    return VectorLayer(layer.name, layer.kind, layer.geometry, columns)


def _trajectory(aligned: Trajectory) -> dict[str, bytes]:
    """TUM where the recording has time, KITTI where it has none; evo reads both."""
    if aligned.stamp_ns is not None:
        return {
            "slam_aligned_tum.txt": tum_text(aligned.stamp_ns, aligned.xyz_m, aligned.quaternion).encode()
        }
    rotation = Rotation.from_quat(aligned.quaternion).as_matrix() if len(aligned) else np.empty((0, 3, 3))
    return {"slam_aligned_kitti.txt": kitti_text(aligned.xyz_m, rotation).encode()}


def _review(items: ReviewItems, lanelets: make.Lanes, projection: Projection) -> VectorLayer:
    columns = {
        "lanelet_id": items.lanelet_id, "kind": items.kind, "subject": items.subject, "map_has": items.have,
        "osm_says": items.offer, "reason": items.reason,
    }  # fmt: skip
    return make.place_layer("review", lanelets.places_m(items.lanelet_id), columns, projection)


def _findings(
    found: list[Findings], final: LaneletMap, lanelets: make.Lanes, projection: Projection
) -> VectorLayer:
    words = ("code", "severity", "primitive", "message")
    columns = {name: np.concatenate([getattr(f, name) for f in found]) for name in words}
    ids = np.concatenate([f.id for f in found])
    xy_m = finding_places(columns["primitive"], ids, final)
    at_lanelet = columns["primitive"] == "lanelet"
    xy_m[at_lanelet] = lanelets.places_m(ids[at_lanelet])
    return make.place_layer("findings", xy_m, {"id": ids, **columns}, projection)


def _links(links: Links, matches: Matches, projection: Projection) -> VectorLayer:
    columns = {
        "lanelet_id": matches.lanelet_id, "way_id": matches.way_id, "confidence": matches.confidence,
        "decision": matches.decision, "reason": matches.reason,
    }  # fmt: skip
    taken = {name: column[links.row] for name, column in columns.items()}
    return make.link_layer(links.lane_m, links.way_m, taken, projection)
