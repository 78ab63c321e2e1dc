"""Worlds with known truth taken through the whole pipeline, and releases scored against them."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydantic import Field

from flexmap_tasks.config import (
    CollapseParams,
    FlexMapConfig,
    MatchParams,
    OsmRoadsParams,
    Params,
    TruthEvaluationParams,
)
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.engine.release import publish_release
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.evaluation.evaluate_release import evaluate_release
from flexmap_tasks.formats.release_files import Released, read_released
from flexmap_tasks.ingest.lanelet_map import ingest_lanelet_map
from flexmap_tasks.ingest.osm_roads import ingest_osm_roads
from flexmap_tasks.ingest.truth import ingest_truth
from flexmap_tasks.matching.collapse import collapse
from flexmap_tasks.matching.match import match
from flexmap_tasks.model.conflation import Matches
from flexmap_tasks.model.maps import LaneletMap, PlacedRoads, RoadNetwork
from flexmap_tasks.model.osm import rows_of
from flexmap_tasks.model.source import Source
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.report.exports import export_layers
from flexmap_tasks.report.report import report
from flexmap_tasks.simulate.world import World
from flexmap_tasks.simulate.write import write_world
from flexmap_tasks.store.store import Store

TRUTH_TABLES = ("poses", "map_nodes", "matches", "tags", "lanes")
WORLD_FILES = {
    "gnss": "recording.mcap",
    "slam": "recording.mcap",
    "lanelet_map": "lanelet2_map.osm",
    "osm": "osm_extract.osm",
}


class ScoreParams(Params):
    """A world, and what to try in it.

    world : the simulated world; settings : overrides of the map update as a nested mapping
    """

    world: World
    settings: dict[str, object] = Field(default_factory=dict)


@stage("score")
def score_world(params: ScoreParams) -> dict[str, bytes]:
    """Simulate the world, make its map with the pipeline, and score the release: `evaluation.json` and the rest."""
    with tempfile.TemporaryDirectory(prefix="flexmap-") as folder:
        town = Path(folder) / "world"
        write_world(params.world, town)
        config = world_config(params.world, town, params.settings)
        store, graph = Store.open(Path(folder) / "store"), map_update(config)
        graph.leave_out(report, export_layers)  # for people; scores need neither
        outcomes = run_local(store, graph)
        artifacts = {name: o.artifact for name, o in outcomes.items()}
        actions = {name: o.key for name, o in outcomes.items()}
        release = publish_release(store, graph, artifacts, actions, store.releases, config.map)
        return score_release(release.folder, town)


def world_config(world: World, town: Path, settings: dict[str, object] | None = None) -> FlexMapConfig:
    """The map update of a world's files below `town`, the point cloud left out."""
    data: dict[str, object] = {"map": world.name}
    data |= {part: {"file": str(town / name)} for part, name in WORLD_FILES.items()}
    data["evaluation"] = {"held_out_block_m": 0}  # the truth is known: nothing needs to be withheld
    data["conflation"] = {"collapse": {"driving_side": world.driving_side}}
    return FlexMapConfig.model_validate(_merged(data, settings or {}))


def score_release(release: Path, world: Path) -> dict[str, bytes]:
    """Everything that can be said of a release against the truth of the world it was made from.

    Raises InputError where one of the two folders is not what it should be.
    """
    released = read_released(release)
    before = ingest_lanelet_map(_source(world, "lanelet2_map.osm"))
    finished = ingest_lanelet_map(_source(release, "lanelet2_map.osm"))
    roads = ingest_osm_roads(_source(world, "osm_extract.osm"), OsmRoadsParams())
    truth = ingest_truth(*(_source(world / "truth", f"{name}.parquet") for name in TRUTH_TABLES))
    return evaluate_release(
        before=before,
        finished=finished,
        aligned=released.aligned,
        projection=released.projection,
        matches=released.matches,
        baseline=_buffer_growing(before, finished, roads, released),
        transfers=released.transfers,
        lane_check=released.lane_check,
        roads=roads,
        quality=released.quality,
        truth=truth,
        params=TruthEvaluationParams(),
    )


def _buffer_growing(
    before: LaneletMap, finished: LaneletMap, roads: RoadNetwork, released: Released
) -> Matches | None:
    """The paper's method on the same map, as a baseline: the map as it was, where the release has put its nodes."""
    if released.matches is None:
        return None
    moved = replace(before, xyz_m=_moved(before, finished))
    placed = PlacedRoads(roads, released.projection.to_xy_m(roads.lonlat_deg))
    lines = collapse(moved, CollapseParams())
    return match(lines, moved, placed, MatchParams(method="buffer_growing")).matches


def _moved(before: LaneletMap, finished: LaneletMap) -> np.ndarray:
    rows = rows_of(finished.document.nodes.id, before.document.nodes.id)
    return np.where((rows >= 0)[:, None], finished.xyz_m[rows], before.xyz_m)


def _merged(base: dict[str, object], more: dict[str, object]) -> dict[str, object]:
    out = dict(base)
    for key, value in more.items():
        inner = out.get(key)
        out[key] = _merged(inner, value) if isinstance(inner, dict) and isinstance(value, dict) else value
    return out


def _source(folder: Path, name: str) -> Source:
    return Source(name, folder / name)
