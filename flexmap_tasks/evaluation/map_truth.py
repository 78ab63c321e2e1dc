"""Error of every node of a map against the truth: in the plane, in height, along and across its lane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.maps import LaneletMap
from flexmap_tasks.model.osm import node_rows, rows_of
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.truth import TrueNodes


@dataclass(frozen=True, slots=True, eq=False)
class NodeErrors:
    """Errors of the n nodes that truth and map both have, metres.

    node_id : (n,) int64; true_xy_m : (n, 2) in the map frame; gap_m : (n, 3) map minus truth
    along_m, across_m : (n,) size of the error along and across the line the node stands on, NaN on no line
    unknown : nodes of the map that the truth does not know (made by cuts); lost : true nodes the map has no more
    """

    node_id: Ints
    true_xy_m: Floats
    gap_m: Floats
    along_m: Floats
    across_m: Floats
    unknown: int
    lost: int

    @property
    def planar_m(self) -> Floats:
        """(n,) distance in the plane."""
        return np.hypot(self.gap_m[:, 0], self.gap_m[:, 1])


def node_errors(finished: LaneletMap, truth: TrueNodes, projection: Projection) -> NodeErrors:
    """Where the finished map puts the nodes, against where they belong.

    finished : `xyz_m` in the map frame of the projection, z the height as written
    """
    nodes = finished.document.nodes
    row = rows_of(nodes.id, truth.node_id)
    there = row >= 0
    row = row[there]
    true_xy = projection.to_xy_m(truth.lonlat_deg[there])
    gap = finished.xyz_m[row] - np.column_stack([true_xy, truth.ele_m[there]])
    course = _courses(finished)[row]
    along = np.abs((gap[:, :2] * course).sum(axis=1))
    across = np.abs(gap[:, 1] * course[:, 0] - gap[:, 0] * course[:, 1])
    known = len(np.unique(row))
    return NodeErrors(
        truth.node_id[there], true_xy, gap, along, across, len(nodes.id) - known, int((~there).sum())
    )


def _courses(lanelet_map: LaneletMap) -> Floats:
    """(n, 2) unit direction of the line each node stands on, NaN for a node on none; the first line counts."""
    ways, rows = lanelet_map.document.ways, node_rows(lanelet_map.document)
    out = np.full((len(lanelet_map.xyz_m), 2), np.nan)
    if len(rows) == 0:
        return out
    owner = np.repeat(np.arange(len(ways.id)), np.diff(ways.offset))
    xy = np.where((rows >= 0)[:, None], lanelet_map.xyz_m[rows, :2], np.nan)
    before = np.maximum(np.arange(len(rows)) - 1, ways.offset[owner])
    after = np.minimum(np.arange(len(rows)) + 1, ways.offset[owner + 1] - 1)
    run = xy[after] - xy[before]
    size = np.hypot(run[:, 0], run[:, 1])
    good = np.flatnonzero((size > 0) & (rows >= 0))[::-1]
    out[rows[good]] = run[good] / size[good, None]
    return out
