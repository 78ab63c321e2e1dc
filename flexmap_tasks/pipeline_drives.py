"""The part of the DAG that several recordings of one area add."""

from __future__ import annotations

from flexmap_tasks.alignment.align_drive import align_drive, gather_drives
from flexmap_tasks.alignment.fuse_drives import fuse_drives
from flexmap_tasks.config import DriveName, FlexMapConfig, GnssParams, SlamParams
from flexmap_tasks.engine.graph import Graph, Ref, SourceRef
from flexmap_tasks.ingest.gnss import ingest_gnss
from flexmap_tasks.ingest.slam import ingest_slam
from flexmap_tasks.pipeline_parts import Drive, only


def fuse(graph: Graph, config: FlexMapConfig, main: Drive, adjusted: Ref) -> Ref:
    """The pose graph of all drives; each is aligned by itself, so a new one leaves the others as they are."""
    gathered: Ref | None = None
    for drive in config.drives:
        aligned = graph.run_as(
            f"align_drive.{drive.name}",
            align_drive,
            config.alignment.pose_graph,
            slam=graph.run_as(
                f"ingest_slam.{drive.name}",
                ingest_slam,
                only(SlamParams, drive.slam),
                source=SourceRef(drive.slam.file),
            ),
            fixes=graph.run_as(
                f"ingest_gnss.{drive.name}",
                ingest_gnss,
                only(GnssParams, drive.gnss),
                source=SourceRef(drive.gnss.file),
            ),
            projection=main.projection,
            height_model=main.height_model,
        )
        gathered = graph.run_as(
            f"gather_drives.{drive.name}",
            gather_drives,
            only(DriveName, drive),
            drive=aligned,
            others=gathered,
        )
    fused = graph.run(fuse_drives, graph=adjusted, drives=gathered)
    graph.publish("drives.parquet", fused.field("drives"))
    return fused.field("graph")
