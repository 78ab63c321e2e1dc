"""What the parts of the pipeline hand to each other: references, by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

from flexmap_tasks.config import Params
from flexmap_tasks.engine.graph import Ref

M = TypeVar("M", bound=Params)


def only(kind: type[M], settings: M) -> M:
    """The settings of an input without its path: what the stage gets."""
    return kind.model_validate({name: getattr(settings, name) for name in kind.model_fields})


@dataclass(frozen=True, slots=True)
class Drive:
    """What alignment starts from; height_model : the ground it is laid onto, if any."""

    projection: Ref
    gnss_track: Ref
    slam: Ref
    height_model: Ref | None = None


@dataclass(frozen=True, slots=True)
class Adjusted:
    """The pose graph, its antenna track, its errors on withheld GNSS and altitudes, and what is odd about it."""

    graph: Ref
    antenna: Ref
    held_out: Ref | None
    held_out_heights: Ref | None
    findings: Ref


@dataclass(frozen=True, slots=True)
class Aligned:
    """The drive in the map frame, and the warp that brought it there."""

    projection: Ref
    gnss_track: Ref
    slam: Ref
    control_points: Ref | None
    warp: Ref
    track: Ref
    adjusted: Adjusted | None


@dataclass(frozen=True, slots=True)
class Conflated:
    """What conflation decided, the enriched map, what people had decided, and what OSM changed."""

    matches: Ref
    references: Ref
    enriched: Ref
    decided: Ref | None
    changes: Ref | None


@dataclass(frozen=True, slots=True)
class Cloud:
    """The list of the map's tiles as Autoware reads it, the tiles that are there, and what is odd about them."""

    metadata: Ref
    keys: Ref
    findings: Ref


@dataclass(frozen=True, slots=True)
class Drawn:
    """What the report and the layers show.

    recorded : the map as it was read; lanelets : where georeferencing put it
    """

    recorded: Ref | None
    lanelets: Ref | None
    roads: Ref | None
    aligned: Aligned
    conflated: Conflated | None
    quality: Ref
    bundle_findings: Ref | None
    cloud_findings: Ref | None
