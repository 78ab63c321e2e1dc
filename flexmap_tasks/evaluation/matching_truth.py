"""Matches judged by the truth: metre by metre, lanelet by lanelet, class by class."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.geometry.overlay import overlay
from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.model.conflation import Matches
from flexmap_tasks.model.osm import rows_of
from flexmap_tasks.model.truth import TrueMatches

KINDS = ("link", "junction", "stub", "none")


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """What a matcher says, piece by piece; pieces of a lanelet do not overlap.

    lanelet_id : (n,) int64; start, stop : (n,) shares of the lanelet's length
    way_id : (n,) int64, 0 for no counterpart; direction : (n,) int64, +1 or -1, 0 for none
    decision : (n,) str, "match", "none" or "review"; confidence : (n,) float64
    """

    lanelet_id: Ints
    start: Floats
    stop: Floats
    way_id: Ints
    direction: Ints
    decision: Strings
    confidence: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Stretches of lanelets in which neither truth nor prediction changes.

    lanelet : (n,) int64, position among the true lanelets; length_m : (n,) of the true lanelet
    kind : (n,) str; has_way : (n,) bool, by the truth; said : (n,) str, the decision ("none" where nobody spoke)
    named : (n,) bool, the prediction names a way; right : (n,) bool, and it is right
    turned : (n,) bool, right but the other direction; confidence : (n,)
    """

    lanelet: Ints
    length_m: Floats
    kind: Strings
    has_way: Bools
    said: Strings
    named: Bools
    right: Bools
    turned: Bools
    confidence: Floats

    @property
    def matched(self) -> Bools:
        """(n,) the prediction names a way and is sure of it."""
        sure: Bools = self.named & (self.said == "match")
        return sure


@dataclass(frozen=True, slots=True)
class Score:
    """Precision, recall and F1 of sure matches; None where there is nothing to share.

    length_m : all that was judged; wrong_m : another way than the true one; phantom_m : a way where there is none
    missed_m : a way exists and none was named for sure; turned_m : the right way in the wrong direction
    recall_with_review : recall once a person has confirmed every right way that is up for review
    """

    length_m: float
    precision: float | None
    recall: float | None
    f1: float | None
    recall_with_review: float | None
    wrong_m: float
    phantom_m: float
    missed_m: float
    turned_m: float
    lanelets: int
    lanelet_precision: float | None
    lanelet_recall: float | None
    lanelet_f1: float | None


def prediction_of(matches: Matches) -> Prediction:
    """The rows of a matcher, in shares of the lanelets' own lengths."""
    ids, row = np.unique(matches.lanelet_id, return_inverse=True)
    length = np.zeros(len(ids))
    np.maximum.at(length, row, matches.s_to_m)
    whole = np.where(length > 0, length, 1.0)[row]
    return Prediction(
        matches.lanelet_id, matches.s_from_m / whole, matches.s_to_m / whole, matches.way_id,
        matches.direction, matches.decision, matches.confidence,
    )  # fmt: skip


def judge_matches(prediction: Prediction, truth: TrueMatches) -> Judged:
    """Lay a prediction over the truth; lanelets the truth does not know are left out."""
    ids = np.unique(truth.lanelet_id)
    line = rows_of(ids, truth.lanelet_id)
    said_line = rows_of(ids, prediction.lanelet_id)
    known = np.flatnonzero(said_line >= 0)
    pieces = (line, truth.s_from_m / truth.lanelet_length_m, truth.s_to_m / truth.lanelet_length_m)
    laid = overlay(len(ids), pieces, (said_line[known], prediction.start[known], prediction.stop[known]))
    inside = laid.first >= 0
    t, covered = laid.first[inside], laid.second[inside] >= 0
    p = known[laid.second[inside]] if len(known) else np.zeros(len(t), dtype=np.int64)
    way = _where(covered, prediction.way_id, p, 0)
    direction = _where(covered, prediction.direction, p, 0)
    has_way = truth.way_id[t] != 0
    main = (way != 0) & (way == truth.way_id[t])
    right = main | ((way != 0) & has_way & (way == truth.also_way_id[t]))
    return Judged(
        lanelet=laid.line[inside],
        length_m=(laid.stop - laid.start)[inside] * truth.lanelet_length_m[t],
        kind=truth.kind[t],
        has_way=has_way,
        said=_where(covered, prediction.decision, p, "none"),
        named=way != 0,
        right=right,
        turned=main & (direction != truth.direction[t]),
        confidence=_where(covered, prediction.confidence, p, 0.0),
    )


def score(judged: Judged, rows: Bools | None = None) -> Score:
    """The figures over the given stretches, all when None."""
    use = np.ones(len(judged.lanelet), dtype=bool) if rows is None else rows
    metres = np.where(use, judged.length_m, 0.0)
    hit = judged.matched & judged.right
    phantom, wrong = judged.matched & ~judged.has_way, judged.matched & judged.has_way & ~judged.right
    missed = judged.has_way & ~judged.matched
    confirmed, there = float(metres[judged.right].sum()), float(metres[judged.has_way].sum())
    precision, recall, f1 = _figures(*(float(metres[r].sum()) for r in (hit, judged.matched, judged.has_way)))
    *counts, lanelets = _by_lanelet(judged, metres)
    lanelet_precision, lanelet_recall, lanelet_f1 = _figures(*counts)
    return Score(
        length_m=float(metres.sum()),
        precision=precision,
        recall=recall,
        f1=f1,
        recall_with_review=confirmed / there if there else None,
        wrong_m=float(metres[wrong].sum()),
        phantom_m=float(metres[phantom].sum()),
        missed_m=float(metres[missed].sum()),
        turned_m=float(metres[judged.turned & judged.matched].sum()),
        lanelets=lanelets,
        lanelet_precision=lanelet_precision,
        lanelet_recall=lanelet_recall,
        lanelet_f1=lanelet_f1,
    )


def score_by_kind(judged: Judged) -> dict[str, Score]:
    """Scores of everything ("all") and of each class that occurs."""
    kinds = [kind for kind in KINDS if (judged.kind == kind).any()]
    return {"all": score(judged)} | {kind: score(judged, judged.kind == kind) for kind in kinds}


def review_confusion(judged: Judged) -> dict[str, dict[str, float]]:
    """Metres by decision and by what the truth says of them.

    right : the named way is the true one, or none was named and there is none; wrong : another way is true
    phantom : there is none; missed : there is one, and none was named
    """
    metres = judged.length_m
    outcome = {
        "right": judged.right | (~judged.named & ~judged.has_way),
        "wrong": judged.named & judged.has_way & ~judged.right,
        "phantom": judged.named & ~judged.has_way,
        "missed": ~judged.named & judged.has_way,
    }
    return {
        said: {name: float(metres[rows & (judged.said == said)].sum()) for name, rows in outcome.items()}
        for said in ("match", "review", "none")
    }


def _by_lanelet(judged: Judged, metres: Floats) -> tuple[int, int, int, int]:
    """Lanelets that are, over more than half of their length: rightly matched, matched, on a way; and all."""
    n = int(judged.lanelet.max(initial=-1)) + 1

    def total(rows: Bools) -> Floats:
        return np.bincount(judged.lanelet[rows], weights=metres[rows], minlength=n).astype(np.float64)

    whole = total(np.ones(len(metres), dtype=bool))
    counts = [
        int(np.count_nonzero((whole > 0) & (total(rows) > whole / 2)))
        for rows in (judged.matched & judged.right, judged.matched, judged.has_way)
    ]
    return counts[0], counts[1], counts[2], int(np.count_nonzero(whole > 0))


def _figures(right: float, named: float, there: float) -> tuple[float | None, float | None, float | None]:
    """Precision, recall, F1."""
    precision = right / named if named else None
    recall = right / there if there else None
    f1 = 2 * right / (named + there) if named + there else None
    return precision, recall, f1


def _where(covered: Bools, column: np.ndarray, rows: Ints, otherwise: object) -> np.ndarray:
    out = np.full(len(rows), otherwise, dtype=column.dtype)
    out[covered] = column[rows[covered]]
    return out
