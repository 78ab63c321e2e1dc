"""The global matching, from centrelines to rows: samples, inference, runs, lanelets."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.config import PathParams
from flexmap_tasks.matching.collapse import member_lengths_m
from flexmap_tasks.matching.paths.decisions import RunParts, Runs, parts_of, runs_of
from flexmap_tasks.matching.paths.inference import infer
from flexmap_tasks.matching.paths.road_graph import RoadGraph, road_graph
from flexmap_tasks.matching.paths.samples import Samples, samples_of
from flexmap_tasks.matching.pieces import Homes, LaneletPieces, LinePieces, lanelet_pieces
from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.model.conflation import Centerlines, Matched, Matches, References
from flexmap_tasks.model.maps import LaneletMap, PlacedRoads

ANGLE_LIMIT_DEG, DISTANCE_LIMIT_M = 20.0, 10.0
"""Where a score reaches 0: the exclusion limits of the paper for angle and area."""
BELIEF = (0.0, 0.36, 0.52, 0.65, 0.77, 0.88, 0.95, 1.0)
RIGHT = (0.2, 0.45, 0.76, 0.87, 0.93, 0.955, 0.99, 0.998)
"""How often a road believed in this much is the right one, by metre over simulated towns with 2 to 5 m of noise:
beliefs count neighbouring samples as if they were one, and so are too modest."""


def match_by_paths(
    centerlines: Centerlines, lanelet_map: LaneletMap, roads: PlacedRoads, params: PathParams
) -> Matched:
    """Every path of lanelets as a path on the road graph, all at once."""
    samples = samples_of(centerlines, lanelet_map, params.spacing_m)
    graph = road_graph(roads)
    posterior = infer(samples, graph, roads.network, params)
    runs = runs_of(samples, graph, posterior)
    parts = parts_of(samples, graph, posterior, runs)
    homes = Homes(
        centerlines.members.lanelet_id,
        samples.home,
        np.zeros(len(samples.home), dtype=bool),
        samples.length_m,
    )
    laid = LinePieces(
        runs.bundle[parts.run], parts.from_m, parts.to_m, np.arange(len(parts.run)),
        np.zeros(len(parts.run)), np.ones(len(parts.run)),
    )  # fmt: skip
    pieces = lanelet_pieces(homes, laid, member_lengths_m(centerlines, lanelet_map))
    matches = _rows(centerlines, roads, samples, graph, runs, parts, pieces, params)
    return Matched(matches, _table(samples, runs))


def _rows(
    centerlines: Centerlines, roads: PlacedRoads, samples: Samples, graph: RoadGraph, runs: Runs,
    parts: RunParts, pieces: LaneletPieces, params: PathParams,
) -> Matches:  # fmt: skip
    at = pieces.interval
    bare = at < 0
    run = np.where(bare, -1, np.append(parts.run, -1)[at])
    way = np.where(bare, -1, np.append(parts.way, -1)[at])
    hit = way >= 0
    way_from = np.where(hit, _pick(parts.way_from_m, at), np.nan)
    way_to = np.where(hit, _pick(parts.way_to_m, at), np.nan)
    angle, distance = _pick(runs.angle_deg, run), _pick(runs.distance_m, run)
    fit = (
        1.0 - np.minimum(angle / ANGLE_LIMIT_DEG, 1.0) / 2 - np.minimum(distance / DISTANCE_LIMIT_M, 1.0) / 2
    )
    certain = _pick(runs.probability, run)
    confidence = np.where(bare, 1.0, np.where(hit, np.interp(certain, BELIEF, RIGHT), certain))
    against = _against(graph, runs)
    decision, reason = _decided(hit, bare, confidence, np.append(against, False)[run], params)
    length = _pick(parts.to_m - parts.from_m, at)
    return Matches(
        lanelet_id=centerlines.members.lanelet_id[pieces.member],
        s_from_m=pieces.s_from_m,
        s_to_m=pieces.s_to_m,
        way_id=np.where(hit, np.append(roads.network.way_id, 0)[way], 0),
        way_s_from_m=way_from,
        way_s_to_m=way_to,
        direction=np.where(hit, np.where(way_to >= way_from, 1, -1), 0),
        score=np.where(hit, fit, 0.0),
        confidence=confidence,
        decision=decision,
        reason=reason,
        reference=np.where(bare, -1, samples.centerline[np.append(runs.bundle, 0)[run]]),
        d_angle_deg=np.where(hit, angle, np.nan),
        d_length_m=np.where(hit, np.abs(np.abs(way_to - way_from) - length), np.nan),
        d_chord_m=np.full(len(at), np.nan),
        d_area_m=np.where(hit, distance, np.nan),
    )


def _pick(column: Floats, row: Ints) -> Floats:
    picked: Floats = np.append(column, np.nan)[row]
    return picked


def _against(graph: RoadGraph, runs: Runs) -> Bools:
    """Runs against a one-way road."""
    one_way = np.append(graph.one_way, 0)[runs.link]
    return np.asarray(one_way * runs.direction < 0)


def _decided(
    hit: Bools, bare: Bools, confidence: Floats, against: Bools, params: PathParams
) -> tuple[Strings, Strings]:
    """Decision and reason of every row."""
    decision = np.where(hit, "match", "none").astype(object)
    reason = np.where(hit, "the likeliest path on the roads", "no road fits the path").astype(object)
    unsure = hit & (confidence < params.review_confidence)
    decision[unsure], reason[unsure] = "review", "another road is nearly as likely"
    decision[against & hit], reason[against & hit] = "review", "the lanelet runs against a one-way road"
    reason[bare] = "the lanelet has no length"
    return decision, reason


def _table(samples: Samples, runs: Runs) -> References:
    """Centrelines as references: matched where most of their length is."""
    n = int(samples.centerline.max(initial=-1)) + 1
    line = samples.centerline[runs.bundle]
    length = runs.to_m - runs.from_m
    hit = runs.link >= 0
    total = np.bincount(line, weights=length, minlength=n)
    found = np.bincount(line, weights=length * hit, minlength=n)
    lanes = np.bincount(samples.centerline, minlength=n)
    certain = np.bincount(line, weights=length * hit * runs.probability, minlength=n)
    matched = found > total / 2
    score = np.divide(certain, found, out=np.full(n, np.nan), where=matched)
    return References(
        np.arange(n, dtype=np.int64), total / np.maximum(lanes, 1), matched, score, np.full(n, np.nan),
        np.ones(n, dtype=np.int64),
    )  # fmt: skip
