"""Carry OpenStreetMap's values over to the lanelets: decide first, then cut, then write.

Only what is certain is written. What is not stands in the table with action "review" and changes nothing; a tag
that OSM lacks never empties one of the map.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from flexmap_tasks.config import TransferParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.model.arrays import Bools, Ints, Strings, strings
from flexmap_tasks.model.conflation import Centerlines, Enriched, LaneCheck, Matches, Transfers
from flexmap_tasks.model.maps import Findings, LaneletMap, PlacedRoads
from flexmap_tasks.model.review import ReviewDecisions
from flexmap_tasks.transfer.cuts.cut import Pieces, cut_map, whole
from flexmap_tasks.transfer.cuts.places import CutPlan, plan_cuts
from flexmap_tasks.transfer.cuts.wanted import Wanted, wanted_cuts
from flexmap_tasks.transfer.doubt import doubt_speed_jumps, far_lane_counts
from flexmap_tasks.transfer.facts import LaneletFacts, facts_of
from flexmap_tasks.transfer.fragments import Fragment, fragments, judged, unconnected, without
from flexmap_tasks.transfer.lane_check import NO_LANES, NOT_COUNTED, LaneCounts, check_lanes, lane_counts
from flexmap_tasks.transfer.side_check import check_sides
from flexmap_tasks.transfer.table import (
    Contexts,
    Offers,
    Rows,
    contexts_of,
    decisions,
    offers_of,
    usable_rows,
    wrong_way,
)
from flexmap_tasks.transfer.votes import Judged, joined, main_road, ordered, shares_of, transfers
from flexmap_tasks.transfer.write import written


@stage("enriched")
def transfer(
    lanelet_map: LaneletMap,
    centerlines: Centerlines,
    matches: Matches,
    roads: PlacedRoads,
    params: TransferParams,
    last_release: LaneletMap | None = None,
    decisions_on_fragments: ReviewDecisions | None = None,
) -> Enriched:
    """The map with OSM's values on the lanelets, what was done and why, and the lane check.

    With the map of the last release, values that a person has changed in `lanelet_map` since then stay. Ids of
    lanelets, ways and nodes stay; a lanelet that is cut keeps its id for the first piece. Fragments are put up for
    review, unless `remove_fragments` or a person says that they go.
    """
    facts = facts_of(lanelet_map)
    found = _fragments(lanelet_map, facts, centerlines, matches, roads, params)
    fragments_told = judged(found, decisions_on_fragments, params.remove_fragments)
    gone = np.array([f.lanelet_id for f, action, _ in fragments_told if action == "remove"], dtype=np.int64)
    if len(gone):
        lanelet_map = without(lanelet_map, gone)
        facts = facts_of(lanelet_map)
    rows = usable_rows(matches, facts, roads, params)
    against = wrong_way(rows, facts, roads)
    offers, contexts = offers_of(rows, facts, roads, params), contexts_of(facts, params, last_release)
    sure = rows.sure & ~against
    wanted = _wanted(rows, sure, offers, contexts, facts, params) if params.split else []
    plan = plan_cuts(lanelet_map, facts, wanted, params)
    cut, pieces = cut_map(lanelet_map, facts, plan)
    told = Judged(rows, sure, _why_not(rows, against), offers, contexts, facts, pieces, roads)
    values = doubt_speed_jumps(transfers(told, params), cut, pieces, params)
    on, counts = (
        _carriageways(rows.take(sure), facts, pieces, roads, params),
        lane_counts(centerlines, facts.lanelets),
    )
    check = _lane_check(on, pieces, counts, roads)
    sides = check_sides(facts, pieces, on.road, on.sense, on.counted & ~on.in_junction, counts, roads)
    far = far_lane_counts(check, pieces, facts.lanelets.id[pieces.source], roads, params.lanes_far)
    cuts, odd = _cuts(rows, plan, facts, pieces, roads), _fragment_rows(fragments_told, roads)
    table = joined([values, far, sides, cuts, odd])
    return Enriched(
        map=written(cut, pieces, values, check, params),
        transfers=ordered(table, np.unique(table.key.astype(str), return_inverse=True)[1]),
        lane_check=check,
        findings=_findings(told, against, check, params),
    )


def _wanted(
    rows: Rows, sure: Bools, offers: Offers, contexts: Contexts, facts: LaneletFacts, params: TransferParams
) -> list[Wanted]:
    """Where the values that would be written change."""
    at = np.flatnonzero(sure)
    landing = np.zeros((len(at), len(params.rules)), dtype=np.int64)
    texts = []
    for i, rule in enumerate(params.rules):
        which, cases = decisions(rows.lanelet[at], offers.code[at, i], offers, contexts, rule)
        values = sorted({c.value for c in cases if c.action == "set"} | {""})
        code = np.array([values.index(c.value) if c.action == "set" else 0 for c in cases], dtype=np.int64)
        landing[:, i] = code[which]
        texts.append([rule.target, *values])
    return wanted_cuts(rows.take(at), landing, texts, facts, params)


def _why_not(rows: Rows, against: Bools) -> Strings:
    """(n,) why a row is not certain; "" where it is."""
    unsure = np.where(rows.sure, "", "the match is not certain")
    return strings(np.where(against, "the lanelet runs against the one-way road", unsure).tolist())


def _cuts(rows: Rows, plan: CutPlan, facts: LaneletFacts, pieces: Pieces, roads: PlacedRoads) -> Transfers:
    """A row per lanelet made by a cut, and one per cut that was refused."""
    first = np.searchsorted(pieces.source, np.arange(len(facts.lanelets)))
    made = [
        (int(pieces.lanelet_id[first[k] + 1 + j]), k, cut.cause.row, "split", cut.cause.reason)
        for k, cuts in plan.lanelets.items()
        for j, cut in enumerate(cuts)
    ]
    made += [
        (int(facts.lanelets.id[w.lanelet]), w.lanelet, w.row, "review", f"not cut at {w.reason}: {why}")
        for w, why in plan.refused
    ]
    source = np.array([m[1] for m in made], dtype=np.int64)
    road = rows.road[np.array([m[2] for m in made], dtype=np.int64)]
    return _plain(
        np.array([m[0] for m in made], dtype=np.int64),
        facts.lanelets.id[source],
        roads,
        road,
        strings(m[3] for m in made),
        strings(m[4] for m in made),
    )


def _fragment_rows(told: list[tuple[Fragment, str, str]], roads: PlacedRoads) -> Transfers:
    ids = np.array([f.lanelet_id for f, _, _ in told], dtype=np.int64)
    way_row = {int(w): i for i, w in enumerate(roads.network.way_id.tolist())}
    road = np.array([way_row[f.way_id] for f, _, _ in told], dtype=np.int64)
    plain = _plain(ids, ids, roads, road, strings(t[1] for t in told), strings(t[2] for t in told))
    return replace(
        plain,
        key=np.full(len(ids), "fragment", dtype=object),
        old=strings(str(f.lanes_map) for f, _, _ in told),
        new=strings(str(f.lanes_osm) for f, _, _ in told),
    )


def _plain(
    ids: Ints, source: Ints, roads: PlacedRoads, road: Ints, action: Strings, reason: Strings
) -> Transfers:
    """Rows that concern no single attribute."""
    empty: Strings = np.full(len(ids), "", dtype=object)
    network = roads.network
    columns = (network.way_id[road], network.version[road], network.timestamp[road], np.ones(len(ids)))
    return Transfers(ids, source, empty, empty, empty, *columns, action, reason)


@dataclass(frozen=True, slots=True, eq=False)
class _Carriageways:
    """Per piece the way it follows most (row, -1 for none), the direction, and whether lanes are to be counted."""

    road: Ints
    sense: Ints
    counted: Bools
    in_junction: Bools


def _carriageways(
    rows: Rows, facts: LaneletFacts, pieces: Pieces, roads: PlacedRoads, params: TransferParams
) -> _Carriageways:
    road, sense = main_road(shares_of(rows, pieces), rows, len(pieces), roads)
    counted = facts.open_to_cars | (facts.lanelets.subtype == "bus_lane")
    in_junction = facts.forks & (facts.length_m <= params.junction_max_m)
    return _Carriageways(road, sense, counted[pieces.source], in_junction[pieces.source])


def _lane_check(on: _Carriageways, pieces: Pieces, counts: LaneCounts, roads: PlacedRoads) -> LaneCheck:
    return check_lanes(
        pieces.lanelet_id, pieces.source, on.road, on.sense, on.counted, on.in_junction, counts, roads
    )


def _fragments(
    lanelet_map: LaneletMap,
    facts: LaneletFacts,
    centerlines: Centerlines,
    matches: Matches,
    roads: PlacedRoads,
    params: TransferParams,
) -> list[Fragment]:
    free = unconnected(lanelet_map, facts)
    if not free.any():
        return []
    rows = usable_rows(matches, facts, roads, params)
    sure = rows.take(rows.sure & ~wrong_way(rows, facts, roads))
    pieces, counts = whole(facts), lane_counts(centerlines, facts.lanelets)
    check = _lane_check(_carriageways(sure, facts, pieces, roads, params), pieces, counts, roads)
    return fragments(lanelet_map, facts, counts, check, free)


def _findings(j: Judged, against: Bools, check: LaneCheck, params: TransferParams) -> Findings:
    """Lanelets against one-way roads, and OSM values nobody could read."""
    found: set[tuple[str, str, str, int, str]] = set()
    network = j.roads.network
    turned = np.bincount(
        j.rows.lanelet[against], (j.rows.s_to_m - j.rows.s_from_m)[against], len(j.facts.lanelets)
    )
    named = against & (turned >= params.coverage_min * j.facts.length_m)[j.rows.lanelet]
    for k, road in {(int(j.rows.lanelet[i]), int(j.rows.road[i])) for i in np.flatnonzero(named)}:
        text = f"runs against the one-way road {network.way_id[road]}; nothing was taken from it"
        found.add(("wrong-way-lanelet", "warning", "lanelet", int(j.facts.lanelets.id[k]), text))
    for i, rule in enumerate(params.rules):
        bad = np.array([bool(o.problem) for o in j.offers.values], dtype=bool)
        for row in np.flatnonzero(bad[j.offers.code[:, i]]).tolist():
            value = j.offers.values[j.offers.code[row, i]]
            text = f"{rule.key}={value.value}: {value.problem}"
            found.add(("osm-value-not-used", "info", "road", int(network.way_id[j.rows.road[row]]), text))
    for row in np.flatnonzero(check.verdict == "unknown").tolist():
        if check.reason[row] not in (NO_LANES, NOT_COUNTED):
            found.add(("osm-value-not-used", "info", "road", int(check.way_id[row]), str(check.reason[row])))
    return _table(sorted(found))


def _table(found: Iterable[tuple[str, str, str, int, str]]) -> Findings:
    rows = list(found)
    return Findings(
        strings(r[0] for r in rows),
        strings(r[1] for r in rows),
        strings(r[2] for r in rows),
        np.array([r[3] for r in rows], dtype=np.int64),
        strings(r[4] for r in rows),
    )
