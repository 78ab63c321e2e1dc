"""The paper's figures of a matching."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.model.conflation import References


@dataclass(frozen=True, slots=True)
class MatchStatistics:
    """Figures over the reference polylines that are not short; shares are None where there is nothing to share.

    references, length_m : how many, and their length in metres
    matched, matched_length_m : those with a match
    rate, rate_by_length : matched over all
    self_scored_precision : share of the matched whose own score reaches the limit. The paper calls it
    precision; it says nothing about truth
    mean_score : over the matched
    """

    references: int
    length_m: float
    matched: int
    matched_length_m: float
    rate: float | None
    rate_by_length: float | None
    self_scored_precision: float | None
    mean_score: float | None


def match_statistics(
    references: References, short_reference_m: float, true_positive_score: float
) -> MatchStatistics:
    """Statistics of the reference polylines of at least `short_reference_m` (section IV of the paper)."""
    counted = references.length_m >= short_reference_m
    hit = counted & references.matched
    score = references.score[hit]
    n, m = int(counted.sum()), int(hit.sum())
    length, matched_length = (float(references.length_m[rows].sum()) for rows in (counted, hit))
    return MatchStatistics(
        references=n,
        length_m=length,
        matched=m,
        matched_length_m=matched_length,
        rate=m / n if n else None,
        rate_by_length=matched_length / length if n else None,
        self_scored_precision=float(np.mean(score >= true_positive_score)) if m else None,
        mean_score=float(score.mean()) if m else None,
    )
