"""The part of the DAG that reads what others have made: roads and the ground."""

from __future__ import annotations

from flexmap_tasks.config import FlexMapConfig, HeightModelParams, OsmInput, OsmRoadsParams
from flexmap_tasks.engine.graph import Graph, Ref, SourceRef
from flexmap_tasks.ingest.height_model import ingest_height_model
from flexmap_tasks.ingest.osm_fetch import fetch_osm, track_box
from flexmap_tasks.ingest.osm_roads import ingest_osm_roads
from flexmap_tasks.pipeline_parts import only


def ingest_roads(graph: Graph, osm: OsmInput | None, fixes: Ref) -> Ref | None:
    """OpenStreetMap's roads, from a file or fetched around the fixes; None where the configuration has none."""
    if osm is None:
        return None
    source: Ref | SourceRef
    if osm.fetch is not None:
        box = graph.run(track_box, osm.fetch, fixes=fixes)
        source = graph.run(fetch_osm, osm.fetch, box=box)
        graph.publish("sources/", source)
    else:
        assert osm.file is not None  # noqa: S101 - OsmInput gives one of the two
        source = SourceRef(osm.file)
    return graph.run(ingest_osm_roads, only(OsmRoadsParams, osm), source=source)


def ingest_ground(graph: Graph, config: FlexMapConfig, gnss: Ref, projection: Ref) -> Ref | None:
    """The height model around the GNSS track; None where the drive is not laid onto one."""
    model = config.alignment.height_model
    if model is None:
        return None
    return graph.run(
        ingest_height_model,
        only(HeightModelParams, model),
        source=SourceRef(model.file),
        gnss=gnss,
        projection=projection,
    )
