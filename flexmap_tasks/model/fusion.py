"""Several drives through one area, and what became of each."""

from __future__ import annotations

from dataclasses import dataclass

from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.model.pose_graph import PoseGraph


@dataclass(frozen=True, slots=True, eq=False)
class AlignedDrive:
    """A drive beside the map's own, adjusted by itself.

    graph : None where it cannot be aligned, and `reason` says why
    poses, fixes : how many it has, used or not
    """

    graph: PoseGraph | None
    reason: str
    poses: int
    fixes: int


@dataclass(frozen=True, slots=True, eq=False)
class DriveUse:
    """One row per drive, the map's own first.

    drive : (n,) str, "" for the map's own
    poses, fixes, fixes_used : (n,) int64, recorded, and fixes that its own alignment used
    common_places : (n,) int64, nodes of it that lie on what the drives before it cover
    disagreement_m, disagreement_sigmas : (n,) float64, median there of its distance from where those drives put the
        place, in metres and in the deviations both predict; NaN without a common place and for the map's own
    weight : (n,) float64, its share in the certainty (1 / variance) of all places, 0 where it is left out
    used : (n,) bool; reason : (n,) str, why it was left out, else ""
    lever_forward_m, lever_left_m, clock_offset_s : (n,) float64, as GraphFigures has them; NaN where not aligned
    """

    drive: Strings
    poses: Ints
    fixes: Ints
    fixes_used: Ints
    common_places: Ints
    disagreement_m: Floats
    disagreement_sigmas: Floats
    weight: Floats
    used: Bools
    reason: Strings
    lever_forward_m: Floats
    lever_left_m: Floats
    clock_offset_s: Floats

    def __len__(self) -> int:
        return len(self.drive)


@dataclass(frozen=True, slots=True, eq=False)
class Fusion:
    """graph : nodes of all drives that count, corrected as all say; all else in it is the map's own drive's."""

    graph: PoseGraph
    drives: DriveUse
