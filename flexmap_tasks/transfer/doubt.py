"""Values that were matched well and are still hard to believe go to a person, with both values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from flexmap_tasks.config import TransferParams
from flexmap_tasks.model.arrays import Floats, Ints, Strings, strings
from flexmap_tasks.model.conflation import LaneCheck, Transfers
from flexmap_tasks.model.lanelets import follow_pairs, lanelets_of
from flexmap_tasks.model.maps import LaneletMap, PlacedRoads
from flexmap_tasks.model.osm import rows_of
from flexmap_tasks.transfer.cuts.cut import Pieces
from flexmap_tasks.transfer.values import speed_kmh


def doubt_speed_jumps(
    values: Transfers, cut: LaneletMap, pieces: Pieces, params: TransferParams
) -> Transfers:
    """Turn speed limits of short stretches that stand out from what comes before and after into reviews.

    A stretch is a chain of lanelets with one speed by OSM. It stands out when all lanelets before and after it,
    of each at least one, are slower (or all faster) by at least `speed_jump_kmh`.
    """
    speeds = {rule.target for rule in params.rules if rule.parser == "speed"}
    out = values
    for target in sorted(speeds):
        at = np.flatnonzero((values.key == target) & np.isin(values.action.astype(str), ("set", "keep")))
        piece = rows_of(pieces.lanelet_id, values.lanelet_id[at])
        speed = np.full(len(pieces), np.nan)
        speed[piece] = [speed_kmh(v, {}) or np.nan for v in values.new[at]]
        low, high = _neighbours_kmh(_pairs(cut, pieces), speed, pieces, params.speed_jump_max_m)
        jump = (speed - high >= params.speed_jump_kmh) | (low - speed >= params.speed_jump_kmh)
        hit = at[jump[piece] & (values.action[at] == "set")]
        row = rows_of(pieces.lanelet_id, values.lanelet_id[hit])
        why = [
            f"a short stretch of {v} km/h between {a:g} and {b:g}"
            for v, a, b in zip(values.new[hit], low[row].tolist(), high[row].tolist(), strict=True)
        ]
        out = _reviewed(out, hit, why)
    return out


def _pairs(cut: LaneletMap, pieces: Pieces) -> Ints:
    """(p, 2) rows of pieces: the second follows the first."""
    lanelets = lanelets_of(cut)
    pairs = rows_of(pieces.lanelet_id, lanelets.id)[follow_pairs(cut, lanelets)]
    return np.asarray(pairs[(pairs >= 0).all(axis=1)])


def _neighbours_kmh(pairs: Ints, speed: Floats, pieces: Pieces, longest_m: float) -> tuple[Floats, Floats]:
    """(p,) least and greatest speed right before and right after the short stretch a lanelet belongs to; else NaN.

    NaN too where nothing is known on one of the sides.
    """
    n = len(pieces)
    known = pairs[~np.isnan(speed[pairs]).any(axis=1)]
    same = speed[known[:, 0]] == speed[known[:, 1]]
    inner = known[same]
    graph = coo_array((np.ones(len(inner), dtype=np.int8), (inner[:, 0], inner[:, 1])), shape=(n, n))
    stretch = connected_components(graph, directed=False)[1]
    count = int(stretch.max(initial=-1)) + 1
    short = np.bincount(stretch, pieces.s_to_m - pieces.s_from_m, count) <= longest_m
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    border = known[~same]
    sides = []
    for mine, other in ((0, 1), (1, 0)):
        np.minimum.at(low, stretch[border[:, mine]], speed[border[:, other]])
        np.maximum.at(high, stretch[border[:, mine]], speed[border[:, other]])
        sides.append(np.bincount(stretch[border[:, mine]], minlength=count) > 0)
    usable = short & sides[0] & sides[1]
    return np.where(usable, low, np.nan)[stretch], np.where(usable, high, np.nan)[stretch]


def _reviewed(table: Transfers, at: Ints, reasons: list[str]) -> Transfers:
    action, reason = table.action.copy(), table.reason.copy()
    action[at], reason[at] = "review", strings(reasons)
    return replace(table, action=action, reason=reason)


def far_lane_counts(
    check: LaneCheck, pieces: Pieces, source_ids: Ints, roads: PlacedRoads, far: int
) -> Transfers:
    """A row for every lanelet whose carriageway has `far` lanes more or fewer than OSM says.

    source_ids : (p,) id of the lanelet each piece was cut from
    """
    at = np.flatnonzero((check.verdict == "differ") & (np.abs(check.lanes_map - check.lanes_osm) >= far))
    road = rows_of(roads.network.way_id, check.way_id[at])
    action: Strings = np.full(len(at), "review", dtype=object)
    key: Strings = np.full(len(at), "lanes", dtype=object)
    return Transfers(
        lanelet_id=check.lanelet_id[at],
        source_lanelet_id=source_ids[rows_of(pieces.lanelet_id, check.lanelet_id[at])],
        key=key,
        old=strings(str(n) for n in check.lanes_map[at].tolist()),
        new=strings(str(n) for n in check.lanes_osm[at].tolist()),
        way_id=check.way_id[at],
        way_version=roads.network.version[road],
        way_timestamp=roads.network.timestamp[road],
        confidence=np.ones(len(at)),
        action=action,
        reason=check.reason[at],
    )
