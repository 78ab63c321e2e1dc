"""The DAG: one recording becomes one map release. Reads like the paper; runners give it meaning."""

from __future__ import annotations

from collections.abc import Mapping

from flexmap_tasks.alignment.align_track import align_track
from flexmap_tasks.alignment.automatic_points import automatic_control_points
from flexmap_tasks.alignment.cloud_extent import cloud_extent
from flexmap_tasks.alignment.control_points import control_points
from flexmap_tasks.alignment.heldout import heldout
from flexmap_tasks.alignment.heldout_height import heldout_heights
from flexmap_tasks.alignment.judge_points import judge_points
from flexmap_tasks.alignment.pose_graph import antenna_track, pose_graph, pose_graph_warp
from flexmap_tasks.alignment.project import project_utm
from flexmap_tasks.alignment.rubber_sheet import rigid_warp, rubber_sheet
from flexmap_tasks.alignment.umeyama import umeyama
from flexmap_tasks.config import (
    AutomaticControlPointsParams,
    FlexMapConfig,
    GnssParams,
    GraphHeldOutParams,
    PairParams,
    ReportParams,
    SlamParams,
)
from flexmap_tasks.engine.graph import Graph, Ref, SourceRef
from flexmap_tasks.evaluation.quality import evaluate
from flexmap_tasks.evaluation.sigma_findings import sigma_findings
from flexmap_tasks.georeferencing.bundle import georeference
from flexmap_tasks.georeferencing.map import georeference_map
from flexmap_tasks.ingest.gnss import ingest_gnss
from flexmap_tasks.ingest.lanelet_map import ingest_lanelet_map
from flexmap_tasks.ingest.slam import ingest_slam
from flexmap_tasks.pipeline_cloud import georeference_cloud, ingest_cloud
from flexmap_tasks.pipeline_conflation import Maps, conflate, with_edits
from flexmap_tasks.pipeline_drives import fuse
from flexmap_tasks.pipeline_inputs import ingest_ground, ingest_roads
from flexmap_tasks.pipeline_parts import Adjusted, Aligned, Cloud, Conflated, Drawn, Drive, only
from flexmap_tasks.report.bundle_check import check_bundle
from flexmap_tasks.report.exports import export_layers
from flexmap_tasks.report.report import report


def map_update(config: FlexMapConfig) -> Graph:
    """Everything one map update does, and what its release holds."""
    graph = Graph()
    fixes = graph.run(ingest_gnss, only(GnssParams, config.gnss), source=SourceRef(config.gnss.file))
    slam = graph.run(ingest_slam, only(SlamParams, config.slam), source=SourceRef(config.slam.file))
    lanelets = recorded = moved = None
    if config.lanelet_map is not None:
        lanelets = recorded = graph.run(ingest_lanelet_map, source=SourceRef(config.lanelet_map.file))
    tiles = ingest_cloud(graph, config, slam)
    roads = ingest_roads(graph, config.osm, fixes)

    aligned = _align(graph, config, fixes, slam, lanelets, tiles)
    moves_map = config.alignment.master == "gnss"
    if lanelets is not None and moves_map:
        lanelets = moved = graph.run(georeference_map, lanelet_map=lanelets, warp=aligned.warp)
    last_release = None
    if lanelets is not None:
        lanelets, last_release = with_edits(
            graph, config, lanelets, aligned.projection if moves_map else None
        )
    conflated = (
        conflate(graph, config, Maps(lanelets, roads, last_release), aligned) if lanelets and roads else None
    )
    bundle = cloud = None
    if lanelets is not None:
        finished = conflated.enriched.field("map") if conflated else lanelets
        bundle = graph.run(
            georeference,
            config.georeference,
            lanelet_map=finished,
            projection=aligned.projection if moves_map else None,
        )
        graph.publish(".", bundle)
        graph.publish("map_findings.parquet", lanelets.field("findings"))
    if tiles is not None:
        cloud = georeference_cloud(graph, config, tiles, aligned, bundle)
    quality = _evaluate(
        graph, config, aligned, lanelets, conflated, {"recorded_map": recorded, "moved_map": moved}
    )
    checked = _check_bundle(graph, bundle, cloud) if bundle else None
    noticed = cloud.findings if cloud else None
    _report(graph, config, Drawn(recorded, lanelets, roads, aligned, conflated, quality, checked, noticed))
    return graph


def _align(
    graph: Graph, config: FlexMapConfig, fixes: Ref, slam: Ref, lanelets: Ref | None, tiles: Ref | None
) -> Aligned:
    alignment = config.alignment
    projected = graph.run(project_utm, config.projection, fixes=fixes)
    projection, gnss = projected.field("projection"), projected.field("gnss_track")
    motion = points = adjusted = None
    if alignment.method != "pose_graph" or alignment.control_points_file is not None:
        motion = graph.run(umeyama, alignment.umeyama, slam=slam, gnss=gnss, projection=projection)
        graph.publish("alignment.json", motion)
    if alignment.method != "rigid":
        points = _control_points(graph, config, Drive(projection, gnss, slam), motion)
    if alignment.method == "pose_graph":
        drive = Drive(projection, gnss, slam, ingest_ground(graph, config, gnss, projection))
        adjusted = _adjust(graph, config, drive, points, motion)
        fused = fuse(graph, config, drive, adjusted.graph) if config.drives else None
        warp = graph.run(
            pose_graph_warp,
            alignment.pose_graph,
            graph=fused or adjusted.graph,
            slam=None if fused else slam,  # nodes of several drives have no common time
        )
    elif alignment.method == "rubber_sheet":
        extent = graph.run(cloud_extent, index=tiles.field("index")) if tiles else None
        warp = graph.run(
            rubber_sheet,
            alignment.rubber_sheet,
            points=points,
            motion=motion,
            slam=slam,
            lanelet_map=lanelets,
            cloud_extent=extent,
        )
    else:
        warp = graph.run(rigid_warp, motion=motion)
    if points is not None:
        nodes = adjusted.graph.field("nodes") if adjusted else None
        points = graph.run(judge_points, points=points, motion=motion, warp=warp, nodes=nodes)
        graph.publish("control_points.parquet", points)
    graph.publish("projection.json", projection)
    graph.publish("gnss_track.parquet", gnss)
    graph.publish("slam_track_before.parquet", slam)
    aligned_track = graph.run(align_track, slam=slam, warp=warp)
    graph.publish("slam_track_after.parquet", aligned_track)
    return Aligned(projection, gnss, slam, points, warp, aligned_track, adjusted)


def _control_points(graph: Graph, config: FlexMapConfig, drive: Drive, motion: Ref | None) -> Ref | None:
    """The user's control points over those the rubber sheet chooses by itself; None where there are neither."""
    alignment, file = config.alignment, config.alignment.control_points_file
    chosen = alignment.control_points.automatic
    automatic = None
    if alignment.method == "rubber_sheet" and (chosen or file is None):
        automatic = graph.run(
            automatic_control_points,
            chosen or AutomaticControlPointsParams(),
            slam=drive.slam,
            gnss=drive.gnss_track,
            motion=motion,
        )
    if file is None:
        return automatic
    return graph.run(
        control_points,
        PairParams(**alignment.control_points.model_dump(), sheet=alignment.method == "rubber_sheet"),
        source=SourceRef(file),
        slam=drive.slam,
        gnss=drive.gnss_track,
        motion=motion,
        projection=drive.projection,
        automatic=automatic,
    )


def _adjust(
    graph: Graph, config: FlexMapConfig, drive: Drive, points: Ref | None, motion: Ref | None
) -> Adjusted:
    """The pose graph, where it puts the antenna, and how it does on GNSS that it was not told of."""
    params, evaluation = config.alignment.pose_graph, config.evaluation
    adjusted = graph.run(
        pose_graph,
        params,
        slam=drive.slam,
        gnss=drive.gnss_track,
        projection=drive.projection,
        points=points,
        points_motion=motion if points else None,
        height_model=drive.height_model,
    )
    graph.publish("pose_graph.json", adjusted.field("figures"))
    graph.publish("pose_graph_nodes.parquet", adjusted.field("nodes"))
    graph.publish("gnss_use.parquet", adjusted.field("gnss_use"))
    antenna = graph.run(antenna_track, graph=adjusted)
    withheld = withheld_heights = None
    if evaluation.held_out_block_m > 0:
        blocks = GraphHeldOutParams(
            block_m=evaluation.held_out_block_m, folds=evaluation.held_out_folds, graph=params
        )
        tracks = {"slam": drive.slam, "gnss": drive.gnss_track, "projection": drive.projection}
        withheld = graph.run(heldout, blocks, **tracks)
        graph.publish("held_out.parquet", withheld)
        if params.height == "altitude":
            withheld_heights = graph.run(heldout_heights, blocks, **tracks)
            graph.publish("held_out_heights.parquet", withheld_heights)
    noticed = graph.run(
        sigma_findings,
        evaluation,
        graph_nodes=adjusted.field("nodes"),
        gnss_use=adjusted.field("gnss_use"),
        graph_figures=adjusted.field("figures"),
    )
    graph.publish("drive_findings.parquet", noticed)
    return Adjusted(adjusted, antenna, withheld, withheld_heights, noticed)


def _check_bundle(graph: Graph, bundle: Ref, cloud: Cloud | None) -> Ref:
    found = graph.run(
        check_bundle,
        bundle=bundle,
        cloud_metadata=cloud.metadata if cloud else None,
        tiles=cloud.keys if cloud else None,
    )
    graph.publish("bundle_findings.parquet", found)
    return found


def _evaluate(
    graph: Graph,
    config: FlexMapConfig,
    aligned: Aligned,
    lanelets: Ref | None,
    conflated: Conflated | None,
    maps: Mapping[str, Ref | None],
) -> Ref:
    enriched, adjusted = conflated.enriched if conflated else None, aligned.adjusted
    quality = graph.run(
        evaluate,
        config.evaluation,
        slam=aligned.slam,
        gnss=aligned.gnss_track,
        warp=aligned.warp,
        antenna=adjusted.antenna if adjusted else None,
        graph_figures=adjusted.graph.field("figures") if adjusted else None,
        graph_nodes=adjusted.graph.field("nodes") if adjusted else None,
        gnss_use=adjusted.graph.field("gnss_use") if adjusted else None,
        held_out=adjusted.held_out if adjusted else None,
        held_out_heights=adjusted.held_out_heights if adjusted else None,
        drive_findings=adjusted.findings if adjusted else None,
        control_points=aligned.control_points,
        **maps,
        references=conflated.references if conflated else None,
        transfers=enriched.field("transfers") if enriched else None,
        lane_check=enriched.field("lane_check") if enriched else None,
        map_findings=lanelets.field("findings") if lanelets else None,
        transfer_findings=enriched.field("findings") if enriched else None,
    )
    graph.publish("quality.json", quality)
    return quality


def _report(graph: Graph, config: FlexMapConfig, drawn: Drawn) -> None:
    """What a person looks at, and what other tools open."""
    lanelets, conflated, aligned = drawn.lanelets, drawn.conflated, drawn.aligned
    enriched = conflated.enriched if conflated else None
    shown = {
        "projection": aligned.projection,
        "gnss": aligned.gnss_track,
        "slam": aligned.slam,
        "warp": aligned.warp,
        "control_points": aligned.control_points,
        "source_map": drawn.recorded,
        "final_map": enriched.field("map") if enriched else lanelets,
        "map_warp": aligned.warp if lanelets and config.alignment.master == "slam" else None,
        "roads": drawn.roads,
        "matches": conflated.matches if conflated else None,
        "transfers": enriched.field("transfers") if enriched else None,
        "lane_check": enriched.field("lane_check") if enriched else None,
        "changes": conflated.changes if conflated else None,
        "drive_findings": aligned.adjusted.findings if aligned.adjusted else None,
        "map_findings": lanelets.field("findings") if lanelets else None,
        "transfer_findings": enriched.field("findings") if enriched else None,
        "bundle_findings": drawn.bundle_findings,
        "cloud_findings": drawn.cloud_findings,
    }
    params = only(ReportParams, config)
    adjusted = aligned.adjusted
    page = graph.run(
        report,
        params,
        quality=drawn.quality,
        gnss_use=adjusted.graph.field("gnss_use") if adjusted else None,
        held_out=adjusted.held_out if adjusted else None,
        graph_nodes=adjusted.graph.field("nodes") if adjusted else None,
        antenna=adjusted.antenna if adjusted else None,
        decided=conflated.decided if conflated else None,
        **shown,
    )
    graph.publish(".", page)
    graph.publish("layers/", graph.run(export_layers, params, aligned=aligned.track, **shown))
