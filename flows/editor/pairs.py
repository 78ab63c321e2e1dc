"""Pairs as the page sends them: checked, and written as the file that the pipeline reads."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace
from typing import Any, TypeGuard

import numpy as np

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.control_points_csv import WRITTEN
from flexmap_tasks.model.alignment import ControlPoints, RigidMotion
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.projection import Projection

MOST_PAIRS = 2000
LONGEST_NAME = 200
FARTHEST_M = 1e7
LARGEST_SIGMA_M = 100.0


def control_points_of(sent: Any) -> ControlPoints:
    """Control points of a list of {label, source, target, sigma, used}; InputError says what is wrong with it."""
    if not isinstance(sent, list) or len(sent) > MOST_PAIRS:
        raise InputError("the page", f"sent no list of at most {MOST_PAIRS} pairs")
    rows = [_row(row, i) for i, row in enumerate(sent)]
    place = {side: np.array([r[side] for r in rows]).reshape(-1, 2) for side in ("source", "target")}
    used = np.array([r["used"] for r in rows], dtype=bool)
    return ControlPoints(
        label=strings(r["label"] for r in rows),
        source_xy_m=place["source"],
        target_xy_m=place["target"],
        sigma_m=np.array([r["sigma"] for r in rows], dtype=np.float64),
        used=used,
        reason=strings("picked" if u else "excluded by the user" for u in used.tolist()),
    )


def own_points(sent: ControlPoints, shown: ControlPoints | None, automatic: ControlPoints) -> ControlPoints:
    """The points that the file has to hold, where automatic ones lie under it: the user's own, automatic ones that
    were changed, and, not used, automatic ones that were removed.

    sent : all points as the page has them; shown : as it was given them
    """
    auto, before = set(automatic.label.tolist()), {} if shown is None else _by_label(shown)
    kept = [
        i
        for i, label in enumerate(sent.label.tolist())
        if label not in auto or _row_of(sent, i) != before.get(label)
    ]
    gone = np.flatnonzero(~np.isin(automatic.label, sent.label) & automatic.used)
    removed = replace(automatic.take(gone), used=np.zeros(len(gone), dtype=bool))
    parts = sent.take(np.array(kept, dtype=np.int64)), removed
    return ControlPoints(*(np.concatenate([getattr(p, n) for p in parts]) for n in ControlPoints.__slots__))


def _by_label(points: ControlPoints) -> dict[str, tuple[object, ...]]:
    """Automatic points as they were shown; those that a line of the file names are left out: the line stays."""
    rows = enumerate(zip(points.label.tolist(), points.reason.tolist(), strict=True))
    return {label: _row_of(points, i) for i, (label, why) in rows if "user" not in why.split(":", 1)[0]}


def _row_of(points: ControlPoints, i: int) -> tuple[object, ...]:
    places = (*points.source_xy_m[i].tolist(), *points.target_xy_m[i].tolist())
    return (*(round(v, 3) for v in places), round(float(points.sigma_m[i]), 6), bool(points.used[i]))


def csv_of(points: ControlPoints, motion: RigidMotion, projection: Projection, note: str) -> bytes:
    """The pairs as CSV: sources in the SLAM frame, targets in WGS84; `note` says who saved it and when."""
    source = motion.inverse().apply_xy(points.source_xy_m)
    lonlat = projection.to_lonlat_deg(points.target_xy_m)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(WRITTEN)
    for i, name in enumerate(points.label.tolist()):
        (x, y), (lon, lat) = source[i].tolist(), lonlat[i].tolist()
        use = "yes" if points.used[i] else "no"
        place = (f"{x:.4f}", f"{y:.4f}", f"{lat:.10f}", f"{lon:.10f}")
        writer.writerow([name, *place, f"{points.sigma_m[i]:g}", use, note])
    return text.getvalue().encode()


def _row(row: Any, number: int) -> dict[str, Any]:
    where = f"pair {number + 1}"
    if not isinstance(row, dict):
        raise InputError("the page", "sent something that is no pair", where)
    label, sigma, used = row.get("label"), row.get("sigma"), row.get("used")
    if not isinstance(label, str) or not 0 < len(label) <= LONGEST_NAME or not label.isprintable():
        raise InputError("the page", f"needs a name of 1 to {LONGEST_NAME} printable characters", where)
    if label.lstrip().startswith("#") or label != label.strip():
        raise InputError("the page", "sent a name that begins with # or ends in a blank", where)
    if not _finite(sigma) or not 0 < sigma <= LARGEST_SIGMA_M or not isinstance(used, bool):
        raise InputError("the page", f"needs a sigma up to {LARGEST_SIGMA_M:g} m, and used or not", where)
    for side in ("source", "target"):
        place = row.get(side)
        good = isinstance(place, list) and len(place) == 2 and all(_finite(v) for v in place)
        if not good or max(abs(v) for v in row[side]) > FARTHEST_M:
            raise InputError("the page", f"sent no place for the {side}", where)
    return row


def _finite(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
