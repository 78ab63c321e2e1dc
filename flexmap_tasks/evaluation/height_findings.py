"""What is odd about the heights of a drive: altitudes that are left out, ground that is not known."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.maps import Findings
from flexmap_tasks.model.pose_graph import GnssUse, GraphFigures

MODEL_SHARE = 0.98
"""A height model that knows less of the drive is worth a word."""

Row = tuple[str, str, str, int, str]


def height_findings(use: GnssUse, figures: GraphFigures) -> Findings:
    """One finding per reason for which altitudes were left out, but for those that were never given."""
    rows = [*_altitudes(use), *_model(figures)]
    code, severity, primitive, place, message = zip(*rows, strict=True) if rows else ((),) * 5
    return Findings(
        strings(code),
        strings(severity),
        strings(primitive),
        np.array(place, dtype=np.int64),
        strings(message),
    )


def _altitudes(use: GnssUse) -> Iterator[Row]:
    reasons = set(use.altitude_reason.tolist()) - {"", "no altitude"}
    for reason in sorted(reasons):
        rows = np.flatnonzero(use.altitude_reason == reason)
        first, last = use.row[rows[0]], use.row[rows[-1]]
        text = f"{len(rows)} fixes from {first} to {last}: {reason}"
        yield "altitude-left-out", "warning", "fix", int(first), text


def _model(figures: GraphFigures) -> Iterator[Row]:
    if figures.height.startswith("model") and figures.height_share < MODEL_SHARE:
        text = (
            f"the height model tells the height of {figures.height_share:.0%} of the drive; SLAM bridges the rest: "
            "bridges, tunnels, and what lies outside or has no data"
        )
        yield "height-model-incomplete", "warning", "pose", 0, text
