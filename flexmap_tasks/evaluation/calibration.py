"""Does a confidence of 0.9 mean right nine times out of ten?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.evaluation.matching_truth import Judged
from flexmap_tasks.model.arrays import Floats

BINS = 10


@dataclass(frozen=True, slots=True, eq=False)
class Reliability:
    """Confidence against truth in bins of equal width, weighted by metres.

    metres, confidence, accuracy : (BINS,) per bin, the latter two means, NaN in empty bins
    error : expected calibration error, the mean gap between the two; None without a named way
    """

    metres: Floats
    confidence: Floats
    accuracy: Floats
    error: float | None


def reliability(judged: Judged) -> Reliability:
    """Over all stretches for which a way is named, sure of it or up for review."""
    rows = judged.named
    weight, confidence = judged.length_m[rows], np.clip(judged.confidence[rows], 0.0, 1.0)
    place = np.minimum((confidence * BINS).astype(np.int64), BINS - 1)

    def total(values: Floats) -> Floats:
        return np.bincount(place, weights=weight * values, minlength=BINS).astype(np.float64)

    metres, right = total(np.ones(len(weight))), total(judged.right[rows].astype(np.float64))
    filled = np.where(metres > 0, metres, np.nan)
    mean, accuracy = total(confidence) / filled, right / filled
    gap = float(np.nansum(metres * np.abs(mean - accuracy)))
    return Reliability(metres, mean, accuracy, gap / float(metres.sum()) if metres.sum() else None)
