"""A simulated world taken through the whole update, stage by stage."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from flexmap_tasks.alignment.align_track import align_track
from flexmap_tasks.alignment.control_points import control_points
from flexmap_tasks.alignment.judge_points import judge_points
from flexmap_tasks.alignment.project import project_utm
from flexmap_tasks.alignment.rubber_sheet import rubber_sheet
from flexmap_tasks.alignment.umeyama import umeyama
from flexmap_tasks.config import (
    CollapseParams,
    EvaluationParams,
    GeoreferenceParams,
    GnssParams,
    MatchParams,
    OsmRoadsParams,
    PairParams,
    ProjectionParams,
    RubberSheetParams,
    SlamParams,
    TransferParams,
    TruthEvaluationParams,
    UmeyamaParams,
)
from flexmap_tasks.evaluation.evaluate_release import evaluate_release
from flexmap_tasks.evaluation.quality import evaluate
from flexmap_tasks.georeferencing.bundle import georeference
from flexmap_tasks.georeferencing.map import georeference_map
from flexmap_tasks.ingest.gnss import ingest_gnss
from flexmap_tasks.ingest.lanelet_map import ingest_lanelet_map
from flexmap_tasks.ingest.osm_roads import ingest_osm_roads
from flexmap_tasks.ingest.slam import ingest_slam
from flexmap_tasks.ingest.truth import ingest_truth
from flexmap_tasks.matching.collapse import collapse
from flexmap_tasks.matching.match import match
from flexmap_tasks.matching.place_roads import place_roads
from flexmap_tasks.model.conflation import LaneCheck, Matches, Transfers
from flexmap_tasks.model.maps import LaneletMap, RoadNetwork
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.quality import Quality
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import Trajectory
from flexmap_tasks.model.truth import Truth
from flexmap_tasks.simulate.world import World
from flexmap_tasks.simulate.write import write_world
from flexmap_tasks.transfer.transfer import transfer

WORLDS = Path(__file__).resolve().parents[2] / "configs" / "worlds"
TRUTH_TABLES = ("poses", "map_nodes", "matches", "tags", "lanes")


@dataclass(frozen=True)
class Run:
    """All that an evaluation needs."""

    before: LaneletMap
    finished: LaneletMap
    aligned: Trajectory
    projection: Projection
    matches: Matches
    transfers: Transfers
    lane_check: LaneCheck
    roads: RoadNetwork
    quality: Quality
    truth: Truth

    def evaluate(self, **changes: object) -> dict[str, bytes]:
        values = {name: getattr(self, name) for name in self.__dataclass_fields__} | {"baseline": None}
        values |= {"params": TruthEvaluationParams(), **changes}
        return evaluate_release(**values)


def update(world: World, folder: Path) -> Run:
    write_world(world, folder)

    def source(name: str) -> Source:
        return Source(name, folder / name)

    projected = project_utm(ingest_gnss(source("recording.mcap"), GnssParams()), ProjectionParams())
    track, projection = projected.gnss_track, projected.projection
    slam = ingest_slam(source("recording.mcap"), SlamParams())
    before = ingest_lanelet_map(source("lanelet2_map.osm"))
    roads = ingest_osm_roads(source("osm_extract.osm"), OsmRoadsParams())
    motion = umeyama(slam, track, projection, UmeyamaParams())
    points = control_points(source("control_points.csv"), slam, track, motion, projection, PairParams())
    warp = rubber_sheet(points, motion, slam, before, None, RubberSheetParams())
    moved = georeference_map(before, warp)
    placed = place_roads(roads, projection, track, None)
    centerlines = collapse(moved, CollapseParams())
    matched = match(centerlines, moved, placed, MatchParams())
    enriched = transfer(moved, centerlines, matched.matches, placed, TransferParams())
    written = folder / "finished.osm"
    written.write_bytes(georeference(enriched.map, projection, GeoreferenceParams())["lanelet2_map.osm"])
    quality = evaluate(
        slam, track, warp, judge_points(points, motion, warp, None), matched.references, enriched.transfers, enriched.lane_check, before.findings,
        enriched.findings, EvaluationParams(),
    )  # fmt: skip
    return Run(
        before, ingest_lanelet_map(source("finished.osm")), align_track(slam, warp), projection, matched.matches,
        enriched.transfers, enriched.lane_check, roads, quality,
        ingest_truth(*(source(f"truth/{name}.parquet") for name in TRUTH_TABLES)),
    )  # fmt: skip
