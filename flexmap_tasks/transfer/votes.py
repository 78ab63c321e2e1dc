"""From matched pieces to one decision per lanelet and attribute: the majority of matched metres decides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.config import TransferParams
from flexmap_tasks.geometry.lanelets import join
from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings, strings
from flexmap_tasks.model.conflation import Transfers
from flexmap_tasks.model.maps import PlacedRoads
from flexmap_tasks.transfer.cuts.cut import Pieces
from flexmap_tasks.transfer.facts import LaneletFacts
from flexmap_tasks.transfer.table import Contexts, Decision, Offers, Rows, decisions

WHOLE_PERCENT = 90
"""A value that holds for this share of a lanelet holds for the lanelet; below, the reason tells the share."""


@dataclass(frozen=True, slots=True, eq=False)
class Shares:
    """Parts of matched rows on lanelets after cutting: (m,) row of `Rows`, row of `Pieces`, metres."""

    row: Ints
    piece: Ints
    length_m: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Votes:
    """Metres per lanelet and choice, ordered by lanelet, the largest first.

    piece, choice : (v,) int64; length_m : (v,) float64; confidence : (v,) float64, mean over the metres
    row : (v,) int64, the longest matched row behind it; first : (v,) bool, the winner of its lanelet
    """

    piece: Ints
    choice: Ints
    length_m: Floats
    confidence: Floats
    row: Ints
    first: Bools


def shares_of(rows: Rows, pieces: Pieces) -> Shares:
    """Which metres of which row lie on which piece of its lanelet."""
    row, piece = join(rows.lanelet, pieces.source)
    start = np.maximum(rows.s_from_m[row], pieces.s_from_m[piece])
    length = np.minimum(rows.s_to_m[row], pieces.s_to_m[piece]) - start
    keep = length > 0
    return Shares(row[keep], piece[keep], length[keep])


def vote(shares: Shares, choice: Ints, confidence: Floats, tie: Ints) -> Votes:
    """Sum the metres behind each choice; `choice` per share, `confidence` and `tie` (a stable rank) per row."""
    order = np.lexsort((tie[shares.row], -shares.length_m, choice, shares.piece))
    piece, what, length = shares.piece[order], choice[order], shares.length_m[order]
    row = shares.row[order]
    new = np.append(True, (piece[1:] != piece[:-1]) | (what[1:] != what[:-1]))[: len(piece)]
    start = np.flatnonzero(new)
    total = np.add.reduceat(length, start) if len(start) else np.zeros(0)
    mean = np.add.reduceat(length * confidence[row], start) / total if len(start) else np.zeros(0)
    rank = np.lexsort((what[start], -total, piece[start]))
    at = start[rank]
    first = np.append(True, piece[at][1:] != piece[at][:-1])[: len(at)]
    return Votes(piece[at], what[at], total[rank], mean[rank], row[at], first)


def main_road(shares: Shares, rows: Rows, pieces: int, roads: PlacedRoads) -> tuple[Ints, Ints]:
    """(p,) way row (-1 for none) and direction that most metres of a lanelet follow."""
    choice = (_rank_by_id(roads)[rows.road] * 2 + (rows.sense > 0))[shares.row]
    votes = vote(shares, choice, rows.confidence, np.zeros(len(rows), dtype=np.int64))
    road, sense = np.full(pieces, -1, dtype=np.int64), np.zeros(pieces, dtype=np.int64)
    best = votes.row[votes.first]
    road[votes.piece[votes.first]], sense[votes.piece[votes.first]] = rows.road[best], rows.sense[best]
    return road, sense


def _rank_by_id(roads: PlacedRoads) -> Ints:
    rank = np.empty(len(roads.network), dtype=np.int64)
    rank[np.argsort(roads.network.way_id, kind="stable")] = np.arange(len(rank))
    return rank


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """What `judge` looks at; see the types."""

    rows: Rows
    sure: Bools
    why_not: Strings
    offers: Offers
    contexts: Contexts
    facts: LaneletFacts
    pieces: Pieces
    roads: PlacedRoads


def transfers(j: Judged, params: TransferParams) -> Transfers:
    """One row per value offered; rules in their order, lanelets by id."""
    shares = shares_of(j.rows, j.pieces)
    parts = [_of_rule(j, shares, i, params) for i in range(len(params.rules))]
    merged = joined([t for pair in parts for t in pair])
    rank = {rule.target: i for i, rule in reversed(list(enumerate(params.rules)))}
    by_key = np.array([rank[k] for k in merged.key], dtype=np.int64)
    return ordered(merged, by_key)


def _of_rule(
    j: Judged, shares: Shares, i: int, params: TransferParams
) -> tuple[Transfers, Transfers, Transfers]:
    """Decided rows, rows of uncertain matches, and notes under rule i."""
    tie = _rank_by_id(j.roads)[j.rows.road]
    sure = j.sure[shares.row]
    clear = Shares(shares.row[sure], shares.piece[sure], shares.length_m[sure])
    votes = vote(clear, j.offers.code[clear.row, i], j.rows.confidence, tie)
    won = _take(votes, np.flatnonzero(votes.first))
    which, cases = decisions(j.pieces.source[won.piece], won.choice, j.offers, j.contexts, params.rules[i])
    action, value, reason = _columns(which, cases)
    length = (j.pieces.s_to_m - j.pieces.s_from_m)[won.piece]
    sure_m = np.bincount(clear.piece, clear.length_m, len(j.pieces))[won.piece]
    known = sure_m + _agreeing_m(shares, ~j.rows.sure[shares.row], j.offers.code[:, i], won, len(j.pieces))
    thin = (action == "set") & (known < params.coverage_min * length)
    action[thin] = "review"
    matched, share = (
        np.rint(100 * x / np.maximum(length, 1e-9)).astype(np.int64) for x in (known, won.length_m)
    )
    reason[thin] = strings(f"only {s} % of the lanelet are matched" for s in matched[thin].tolist())
    plain = (action == "set") & (reason == "")
    key = params.rules[i].key
    reason[plain] = strings(
        f"from {key}" if s >= WHOLE_PERCENT else f"from {key}, holds for {s} %" for s in share[plain].tolist()
    )
    said = np.flatnonzero(action != "")
    settled: Strings = np.full(len(j.pieces), None, dtype=object)
    done = np.isin(action.astype(str), ("set", "keep"))
    settled[won.piece[done]] = value[done]
    first = _rows_of(j, _take(won, said), i, params, value[said], action[said], reason[said])
    return first, _uncertain(j, shares, i, params, settled), _notes(j, clear, i, params)


def _agreeing_m(shares: Shares, unsure: Bools, code: Ints, won: Votes, pieces: int) -> Floats:
    """(w,) metres of uncertain matches that say what won: they decide nothing, but they do not contradict."""
    winner = np.full(pieces, -1, dtype=np.int64)
    winner[won.piece] = won.choice
    at = np.flatnonzero(unsure & (code[shares.row] == winner[shares.piece]))
    metres: Floats = np.bincount(shares.piece[at], shares.length_m[at], pieces)[won.piece].astype(np.float64)
    return metres


def _uncertain(j: Judged, shares: Shares, i: int, params: TransferParams, settled: Strings) -> Transfers:
    """Values of uncertain matches that would change the map."""
    tie = _rank_by_id(j.roads)[j.rows.road]
    unsure = ~j.sure[shares.row]
    open_ = Shares(shares.row[unsure], shares.piece[unsure], shares.length_m[unsure])
    votes = vote(open_, j.offers.code[open_.row, i], j.rows.confidence, tie)
    which, cases = decisions(
        j.pieces.source[votes.piece], votes.choice, j.offers, j.contexts, params.rules[i]
    )
    action, value, reason = _columns(which, cases)
    news = np.isin(action.astype(str), ("set", "review")) & (settled[votes.piece] != value)
    at = np.flatnonzero(news)
    why = np.where(action[at] == "set", j.why_not[votes.row[at]], reason[at])
    act: Strings = np.full(len(at), "review", dtype=object)
    return _rows_of(j, _take(votes, at), i, params, value[at], act, why)


def _notes(j: Judged, shares: Shares, i: int, params: TransferParams) -> Transfers:
    """Values that hold only at times."""
    tie = _rank_by_id(j.roads)[j.rows.road]
    votes = vote(shares, j.offers.note[shares.row, i], j.rows.confidence, tie)
    usable = j.facts.open_to_cars[j.pieces.source[votes.piece]]
    at = np.flatnonzero((votes.choice > 0) & usable)
    value = strings(j.offers.notes)[votes.choice[at]]
    act: Strings = np.full(len(at), "review", dtype=object)
    why: Strings = np.full(len(at), "holds only at times", dtype=object)
    return _rows_of(j, _take(votes, at), i, params, value, act, why)


def _columns(which: Ints, cases: list[Decision]) -> tuple[Strings, Strings, Strings]:
    columns = ([getattr(c, name) for c in cases] for name in ("action", "value", "reason"))
    action, value, reason = (strings(c)[which] for c in columns)
    return action, value, reason


def _take(votes: Votes, at: Ints) -> Votes:
    return Votes(
        votes.piece[at],
        votes.choice[at],
        votes.length_m[at],
        votes.confidence[at],
        votes.row[at],
        votes.first[at],
    )


def _rows_of(
    j: Judged, votes: Votes, i: int, params: TransferParams, value: Strings, action: Strings, reason: Strings
) -> Transfers:
    source, network = j.pieces.source[votes.piece], j.roads.network
    road = j.rows.road[votes.row]
    old = j.facts.tags.column(params.rules[i].target)[source]
    return Transfers(
        lanelet_id=j.pieces.lanelet_id[votes.piece],
        source_lanelet_id=j.facts.lanelets.id[source],
        key=np.full(len(source), params.rules[i].target, dtype=object),
        old=np.where(old == None, "", old),  # noqa: E711  element-wise
        new=value,
        way_id=network.way_id[road],
        way_version=network.version[road],
        way_timestamp=network.timestamp[road],
        confidence=votes.confidence,
        action=action,
        reason=reason,
    )


def joined(parts: list[Transfers]) -> Transfers:
    """All rows, one table after the other."""
    return Transfers(*(np.concatenate([getattr(p, name) for p in parts]) for name in Transfers.__slots__))


def ordered(table: Transfers, rank: Ints) -> Transfers:
    """Rows by lanelet, `rank`, action, new value and way."""
    text = [np.unique(column.astype(str), return_inverse=True)[1] for column in (table.new, table.action)]
    at = np.lexsort((table.way_id, text[0], text[1], rank, table.lanelet_id))
    return Transfers(*(getattr(table, name)[at] for name in Transfers.__slots__))
