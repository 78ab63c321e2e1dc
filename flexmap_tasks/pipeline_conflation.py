"""The part of the DAG in which the lanelet map and OpenStreetMap meet."""

from __future__ import annotations

from dataclasses import dataclass

from flexmap_tasks.config import FlexMapConfig, OsmRoadsParams
from flexmap_tasks.engine.graph import Graph, Ref, SourceRef
from flexmap_tasks.georeferencing.edits import carry_edits
from flexmap_tasks.ingest.lanelet_map import ingest_lanelet_map
from flexmap_tasks.ingest.osm_roads import ingest_osm_roads
from flexmap_tasks.ingest.review_decisions import ingest_review_decisions
from flexmap_tasks.matching.collapse import collapse
from flexmap_tasks.matching.gaps import find_gaps
from flexmap_tasks.matching.match import match
from flexmap_tasks.matching.place_roads import place_roads
from flexmap_tasks.matching.review import review_matches
from flexmap_tasks.matching.road_changes import road_changes
from flexmap_tasks.pipeline_parts import Aligned, Conflated, only
from flexmap_tasks.transfer.review import apply_review
from flexmap_tasks.transfer.transfer import transfer


@dataclass(frozen=True, slots=True)
class Maps:
    """The two maps that meet, and the release that a person has edited since, if one has."""

    lanelets: Ref
    roads: Ref
    last_release: Ref | None


def with_edits(
    graph: Graph, config: FlexMapConfig, lanelets: Ref, projection: Ref | None
) -> tuple[Ref, Ref | None]:
    """The map with what a person has edited since a release, and that release."""
    edits = config.lanelet_map.edits if config.lanelet_map else None
    if edits is None:
        return lanelets, None
    released = graph.run_as("ingest_released_map", ingest_lanelet_map, source=SourceRef(edits.released))
    edited = graph.run_as("ingest_edited_map", ingest_lanelet_map, source=SourceRef(edits.edited))
    carried = graph.run(
        carry_edits, lanelet_map=lanelets, released=released, edited=edited, projection=projection
    )
    return carried, released


def conflate(graph: Graph, config: FlexMapConfig, maps: Maps, aligned: Aligned) -> Conflated:
    """Match, carry over, and say what differs; published are the decisions."""
    conflation = config.conflation
    placed = _placed(graph, config, "place_roads", maps.roads, aligned)
    centerlines = graph.run(collapse, conflation.collapse, lanelet_map=maps.lanelets)
    matched = graph.run(
        match, conflation.match, centerlines=centerlines, lanelet_map=maps.lanelets, roads=placed
    )
    matches, decided, settled = matched.field("matches"), None, None
    if conflation.review_file is not None:
        decided = graph.run(ingest_review_decisions, source=SourceRef(conflation.review_file))
        on_matches = decided.field("matches")
        settled = graph.run(
            review_matches, matches=matches, decisions=on_matches, lanelet_map=maps.lanelets, roads=placed
        )
        matches = settled.field("matches")
    enriched = graph.run(
        transfer,
        conflation.transfer,
        lanelet_map=maps.lanelets,
        centerlines=centerlines,
        matches=matches,
        roads=placed,
        last_release=maps.last_release,
        decisions_on_fragments=decided.field("fragments") if decided else None,
    )
    if decided is not None and settled is not None:
        enriched = graph.run(
            apply_review,
            enriched=enriched,
            values=decided.field("values"),
            lanes=decided.field("lanes"),
            fragments=decided.field("fragments"),
            unused_matches=settled.field("unused"),
        )
    missing = graph.run(find_gaps, conflation.gaps, centerlines=centerlines, roads=placed, matches=matches)
    graph.publish("gaps.parquet", missing)
    graph.publish("matches.parquet", matches)
    graph.publish("transfer.parquet", enriched.field("transfers"))
    graph.publish("lane_check.parquet", enriched.field("lane_check"))
    graph.publish("findings.parquet", enriched.field("findings"))
    changes = _compare_with_previous(graph, config, maps.lanelets, centerlines, placed, matches, aligned)
    return Conflated(matches, matched.field("references"), enriched, decided, changes)


def _placed(graph: Graph, config: FlexMapConfig, name: str, roads: Ref, aligned: Aligned) -> Ref:
    return graph.run_as(
        name,
        place_roads,
        roads=roads,
        projection=aligned.projection,
        gnss=aligned.gnss_track,
        warp=aligned.warp if config.alignment.master == "slam" else None,
    )


def _compare_with_previous(
    graph: Graph, config: FlexMapConfig, lanelets: Ref, centerlines: Ref, placed: Ref, matches: Ref,
    aligned: Aligned,
) -> Ref | None:  # fmt: skip
    """What has become of the matched roads since another date of OpenStreetMap."""
    if config.osm is None or config.osm.previous is None:
        return None
    then = graph.run_as(
        "ingest_previous_roads",
        ingest_osm_roads,
        only(OsmRoadsParams, config.osm),
        source=SourceRef(config.osm.previous),
    )
    placed_then = _placed(graph, config, "place_previous_roads", then, aligned)
    matched_then = graph.run_as(
        "match_previous_roads",
        match,
        config.conflation.match,
        centerlines=centerlines,
        lanelet_map=lanelets,
        roads=placed_then,
    )
    changes = graph.run(
        road_changes,
        before=placed_then,
        after=placed,
        matches_before=matched_then.field("matches"),
        matches_after=matches,
    )
    graph.publish("road_changes.parquet", changes)
    return changes
