"""Heights of a ground model as heights seen at nodes."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.alignment.altitudes import Seen, offset_stretches
from flexmap_tasks.alignment.drive import Drive
from flexmap_tasks.alignment.vertical_graph import Heights
from flexmap_tasks.errors import CoverageError
from flexmap_tasks.geometry.graph2d import State
from flexmap_tasks.geometry.polyline import arc_length_m
from flexmap_tasks.geometry.se2 import rotated, wrapped
from flexmap_tasks.model.height_model import HeightModel
from flexmap_tasks.model.projection import Projection

SAMPLE_M = 0.5
"""The model is asked for its height so often along the drive."""

SIGMA_M = 0.1
"""Of a model's height on a road; its factor is estimated like every other."""


def ground_heights(
    drive: Drive, state: State, model: HeightModel, projection: Projection, body_up_m: float, scale: float
) -> Heights:
    """What a model of the ground says of nodes. Bridges and tunnels stand off from it as stretches of altitudes do.

    state : of the adjusted plane; body_up_m : height of the body over the ground; scale : metres per SLAM metre
    Raises CoverageError when the model knows no place of the drive.
    """
    along, nodes = arc_length_m(drive.pose[:, :2]), drive.pose[drive.node]
    at = np.arange(0.0, along[-1], SAMPLE_M)
    x, y, z = (np.interp(at, along, column) for column in (*drive.pose.T[:2], drive.z_m))
    node = np.clip(np.searchsorted(along[drive.node], at, side="right") - 1, 0, len(nodes) - 1)
    arm = np.column_stack([x, y]) - nodes[node, :2]
    turn = wrapped(state.pose[:, 2] - nodes[:, 2])[node]
    place = state.pose[node, :2] + rotated(np.exp(state.shared[2]) * arm, turn)
    ground = model.at_m(place, projection) + body_up_m
    known = np.flatnonzero(np.isfinite(ground))
    if len(known) == 0:
        raise CoverageError("height model", "knows no place of the drive; give one that covers it")
    base = drive.z_m[drive.node][node]
    seen = Seen(at, ground, base + scale * (z - base)).take(known)
    stretch = offset_stretches(seen, np.ones(len(known)))
    heights = Heights(
        node[known], scale * arm[known], seen.misfit_m, np.full(len(known), SIGMA_M), stretch, 0.0
    )
    return heights.take(heights.unmixed(len(nodes)))
