"""The paper's matching, from centrelines to rows: references, buffers, intervals, lanelets."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.config import MatchParams
from flexmap_tasks.geometry.lanelets import lengths_m
from flexmap_tasks.matching.buffers.growing import EXCLUDED, Grown, grow
from flexmap_tasks.matching.buffers.intervals import WayIntervals, uncovered, way_intervals
from flexmap_tasks.matching.buffers.references import ReferenceLines, reference_lines
from flexmap_tasks.matching.collapse import member_lengths_m
from flexmap_tasks.matching.pieces import Homes, LaneletPieces, lanelet_pieces, line_pieces
from flexmap_tasks.matching.road_segments import road_segments
from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.model.conflation import Centerlines, Matched, Matches, References
from flexmap_tasks.model.maps import LaneletMap, PlacedRoads

NO_LENGTH = "the lanelet has no length"
NO_ROAD = "no road lies inside the buffers"
ALL_EXCLUDED = "every road inside the buffers breaks an exclusion limit"
BEYOND = "the matched road does not reach this far"


def match_by_buffers(
    centerlines: Centerlines, lanelet_map: LaneletMap, roads: PlacedRoads, params: MatchParams
) -> Matched:
    """Buffer growing (Zhang and Meng 2005; Leitenstern et al. 2024): one decision per reference polyline."""
    references = reference_lines(centerlines, params.segment_length_m, params.reference_angle_max_deg)
    targets = road_segments(roads, params.segment_length_m)
    grown = grow(references, targets, params)
    intervals = way_intervals(references, targets, grown, params.segment_length_m)
    decisions = _with_gaps(references, intervals)
    pieces = _pieces(centerlines, lanelet_map, references, decisions)
    return Matched(_rows(centerlines, roads, references, grown, decisions, pieces), _table(references, grown))


def _with_gaps(references: ReferenceLines, found: WayIntervals) -> WayIntervals:
    """The intervals and, with way -1, what lies between them; in the order of the references."""
    reference, from_m, to_m = uncovered(references, found)
    nowhere, unknown = np.full(len(reference), -1), np.full(len(reference), np.nan)
    every = [
        np.concatenate(pair)
        for pair in (
            (found.reference, reference), (found.from_m, from_m), (found.to_m, to_m),
            (found.way, nowhere), (found.way_from_m, unknown), (found.way_to_m, unknown),
        )
    ]  # fmt: skip
    order = np.lexsort((every[1], every[0]))
    return WayIntervals(*(column[order] for column in every))


def _pieces(
    centerlines: Centerlines, lanelet_map: LaneletMap, references: ReferenceLines, decisions: WayIntervals
) -> LaneletPieces:
    segments, owner = references.segments, references.owner
    n = len(segments)
    goes_on = (owner[1:] == owner[:-1]) & (segments.line[1:] == segments.line[:-1])
    goes_on &= segments.s_from_m[1:] == segments.s_to_m[:-1]
    begins = np.append(True, ~goes_on)[:n]
    first = np.flatnonzero(begins)
    last = np.append(first[1:], n)[: len(first)] - 1
    base = np.append(0.0, np.cumsum(references.length_m))
    walk = np.append((base[owner] + references.start_m)[first], base[-1])
    cuts = (base[decisions.reference] + decisions.from_m, base[decisions.reference] + decisions.to_m)
    stretch = (segments.s_from_m[first], segments.s_to_m[last])
    laid = line_pieces(cuts, np.arange(len(decisions.way)), walk, segments.line[first], stretch)
    members = centerlines.members
    total = lengths_m(centerlines.offset, centerlines.xy_m)
    homes = Homes(members.lanelet_id, members.centerline, members.direction < 0, total)
    return lanelet_pieces(homes, laid, member_lengths_m(centerlines, lanelet_map))


def _rows(
    centerlines: Centerlines,
    roads: PlacedRoads,
    references: ReferenceLines,
    grown: Grown,
    decisions: WayIntervals,
    pieces: LaneletPieces,
) -> Matches:
    at = pieces.interval
    bare = at < 0
    way = np.where(bare, -1, np.append(decisions.way, -1)[at])
    hit = way >= 0
    reference = np.where(bare, -1, np.append(decisions.reference, -1)[at])
    best = np.full(len(references) + 1, -1)
    best[grown.best.reference] = np.arange(len(grown.best.reference))
    row = best[reference]
    score = _where(hit, grown.best.score, row)
    way_from = _on_way(decisions, at, pieces.share_from, hit)
    way_to = _on_way(decisions, at, pieces.share_to, hit)
    return Matches(
        lanelet_id=centerlines.members.lanelet_id[pieces.member],
        s_from_m=pieces.s_from_m,
        s_to_m=pieces.s_to_m,
        way_id=np.where(hit, np.append(roads.network.way_id, 0)[way], 0),
        way_s_from_m=way_from,
        way_s_to_m=way_to,
        direction=np.where(hit, np.where(way_to >= way_from, 1, -1), 0),
        score=np.nan_to_num(score),
        confidence=np.nan_to_num(score),
        decision=_choose(hit, "match", "none"),
        reason=_reasons(grown, reference, hit, bare),
        reference=reference,
        d_angle_deg=_where(hit, grown.best.angle_deg, row),
        d_length_m=_where(hit, grown.best.length_m, row),
        d_chord_m=_where(hit, grown.best.chord_m, row),
        d_area_m=_where(hit, grown.best.area_m, row),
    )


def _where(hit: Bools, column: Floats, row: Ints) -> Floats:
    return np.where(hit, np.append(column, np.nan)[row], np.nan)


def _on_way(decisions: WayIntervals, at: Ints, share: Floats, hit: Bools) -> Floats:
    start, stop = np.append(decisions.way_from_m, np.nan)[at], np.append(decisions.way_to_m, np.nan)[at]
    return np.where(hit, start + share * (stop - start), np.nan)


def _choose(condition: Bools, yes: str, no: str) -> Strings:
    return np.where(condition, yes, no).astype(object)


def _reasons(grown: Grown, reference: Ints, hit: Bools, bare: Bools) -> Strings:
    """Why each row is what it is."""
    state = np.append(grown.state, -1)[reference]
    width = np.append(grown.half_width_m, np.nan)[reference]
    reason = _choose(state == EXCLUDED, ALL_EXCLUDED, NO_ROAD)
    reason[np.isfinite(width)] = BEYOND
    for value in np.unique(width[hit]):
        reason[hit & (width == value)] = f"best score inside a buffer of {value:g} m half width"
    reason[bare] = NO_LENGTH
    return reason


def _table(references: ReferenceLines, grown: Grown) -> References:
    n = len(references)
    score = np.full(n, np.nan)
    score[grown.best.reference] = grown.best.score
    return References(
        np.arange(n, dtype=np.int64), references.length_m, np.isfinite(score), score, grown.half_width_m,
        grown.candidates,
    )  # fmt: skip
