"""Where the drive is predicted worse than it may be: one finding per stretch."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.config import EvaluationParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.evaluation.height_findings import height_findings
from flexmap_tasks.geometry.polyline import arc_length_m
from flexmap_tasks.model.arrays import Floats, Ints, strings
from flexmap_tasks.model.maps import Findings
from flexmap_tasks.model.pose_graph import GnssUse, GraphFigures, GraphNodes

CODE = "predicted-sigma-over-limit"

APART_M = 20.0
"""Stretches over the limit nearer than this to each other are told as one."""


@stage("drive_findings")
def sigma_findings(
    graph_nodes: GraphNodes,
    params: EvaluationParams,
    gnss_use: GnssUse | None = None,
    graph_figures: GraphFigures | None = None,
) -> Findings:
    """A warning for every stretch whose predicted deviation per axis exceeds `sigma_max_m`, none without a limit, and
    what is odd about heights.

    The id of a finding is the row of the first pose of its stretch in the SLAM trajectory, or of the first fix.
    """
    sigma = axis_sigma_m(graph_nodes)
    along = arc_length_m(graph_nodes.source_xyz_m[:, :2])
    limit = np.inf if params.sigma_max_m is None else params.sigma_max_m
    found = stretches(sigma > limit, along)
    rows, message = graph_nodes.row, []
    for first, last in found.tolist():
        message.append(
            f"{along[first]:.0f} m to {along[last]:.0f} m along the drive (poses {rows[first]} to {rows[last]}): "
            f"predicted deviation up to {sigma[first : last + 1].max():.3f} m per axis, limit {limit:g} m"
        )
    code, severity, primitive = (strings([word] * len(found)) for word in (CODE, "warning", "pose"))
    over = Findings(code, severity, primitive, rows[found[:, 0]].astype(np.int64), strings(message))
    if gnss_use is None or graph_figures is None:
        return over
    more = height_findings(gnss_use, graph_figures)
    return Findings(
        *(np.concatenate([getattr(f, name) for f in (over, more)]) for name in Findings.__slots__)
    )


def axis_sigma_m(nodes: GraphNodes) -> Floats:
    """(n,) predicted standard deviation of every node per axis in the plane."""
    sigma: Floats = np.sqrt((nodes.sigma_m[:, :2] ** 2).mean(axis=1))
    return sigma


def stretches(over: np.ndarray, along_m: Floats) -> Ints:
    """(k, 2) first and last row of every run of rows that are over, runs within `APART_M` taken as one."""
    rows = np.flatnonzero(over)
    if len(rows) == 0:
        return np.empty((0, 2), np.int64)
    cut = np.diff(along_m[rows]) > APART_M
    return np.column_stack([rows[np.append(True, cut)], rows[np.append(cut, True)]])
