"""What a tool did to a Lanelet2 map, counted: 0 everywhere is what a harmless tool shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.evaluation.harm_document import local_frame, lost_and_emptied, nodes_moved
from flexmap_tasks.evaluation.harm_geometry import broken_geometry
from flexmap_tasks.evaluation.routing import reachable_share, routing
from flexmap_tasks.model.arrays import Ints
from flexmap_tasks.model.maps import LaneletMap

TOLERATED_PER_MILLE = 5
"""Reachability is a mean over lanelets: cutting some shifts it a little."""


@dataclass(frozen=True, slots=True)
class Harm:
    """Counts of harm, and figures that are no harm in themselves, by name in a fixed order."""

    counts: dict[str, int]
    info: dict[str, float]

    @property
    def total(self) -> int:
        """All harm."""
        return sum(self.counts.values())


def harm_done(before: LaneletMap, after: LaneletMap, *, moved: bool, deleted: Ints | None = None) -> Harm:
    """Compare a map before and after.

    moved : coordinates were meant to change; deleted : ids of lanelets that were meant to go
    """
    gone = np.empty(0, dtype=np.int64) if deleted is None else deleted
    base, now = broken_geometry(before.document), broken_geometry(after.document)
    counts = {f"new {name}": max(0, now[name] - base[name]) for name in base}
    counts |= lost_and_emptied(before.document, after.document, gone)
    if not moved:
        counts["nodes moved"] = nodes_moved(before.document.nodes, after.document.nodes)
    driving, info = _routing_harm(before, after, len(gone) > 0)
    (tagged_before, _), (tagged, off) = (local_frame(m.document.nodes) for m in (before, after))
    counts |= driving
    counts["nodes that lost local_x/local_y"] = max(0, tagged_before - tagged)
    counts["nodes whose local_x/local_y disagree with lat/lon"] = off
    return Harm(counts, info)


def _routing_harm(
    before: LaneletMap, after: LaneletMap, removed: bool
) -> tuple[dict[str, int], dict[str, float]]:
    """Harm to what a vehicle can do; edges are not compared when lanelets were meant to go."""
    old, new = routing(before), routing(after)
    # a lanelet that is cut adds exactly one following edge; a lost edge shows as a shortfall
    split = max(0, len(new.lanelet_id) - len(old.lanelet_id))
    edges = len(new.follow) - len(old.follow) - split
    share_before, share_after = reachable_share(old), reachable_share(new)
    counts = {
        "lanelets with speed limit 0": max(0, int(new.without_limit.sum()) - int(old.without_limit.sum())),
        "lanelets that became two-way": max(0, int(new.two_way.sum()) - int(old.two_way.sum())),
        "following edges short": 0 if removed else max(0, -edges),
        "following edges in excess": 0 if removed else max(0, edges),
        "reachability lost (per mille)": max(
            0, round(1000 * (share_before - share_after)) - TOLERATED_PER_MILLE
        ),
    }
    info: dict[str, float] = {
        "lanelets before": len(old.lanelet_id),
        "lanelets after": len(new.lanelet_id),
        "following edges before": len(old.follow),
        "following edges after": len(new.follow),
        "mean reachable share before": share_before,
        "mean reachable share after": share_after,
    }
    return counts, info
