"""Everything one map update needs."""

from __future__ import annotations

from pydantic import Field, model_validator

from flexmap_tasks.config.alignment import AlignmentParams, ProjectionParams
from flexmap_tasks.config.base import Name, Params
from flexmap_tasks.config.conflation import ConflationParams
from flexmap_tasks.config.inputs import (
    DriveInput,
    GnssInput,
    LaneletMapInput,
    OsmInput,
    PointCloudInput,
    SlamInput,
)
from flexmap_tasks.config.output import EvaluationParams, GateParams, GeoreferenceParams, TilesParams


class FlexMapConfig(Params):
    """Everything one map update needs."""

    map: Name = Field(description="name of the map; releases go to releases/<map>/")
    gnss: GnssInput
    slam: SlamInput
    drives: tuple[DriveInput, ...] = Field(
        (),
        description="more recordings of the area (name, gnss, slam), their SLAM poses localised in the frame of "
        "`slam`: fused into one alignment",
    )
    lanelet_map: LaneletMapInput | None = None
    point_cloud: PointCloudInput | None = None
    osm: OsmInput | None = None
    projection: ProjectionParams = ProjectionParams()
    alignment: AlignmentParams = AlignmentParams()
    conflation: ConflationParams = ConflationParams()
    georeference: GeoreferenceParams = GeoreferenceParams()
    evaluation: EvaluationParams = EvaluationParams()
    gate: GateParams = GateParams()
    background: TilesParams | None = None

    @model_validator(mode="after")
    def _automatic_points_are_for_the_sheet(self) -> FlexMapConfig:
        if self.alignment.method != "rubber_sheet" and self.alignment.control_points.automatic is not None:
            raise ValueError(
                "alignment.control_points.automatic is for alignment.method rubber_sheet; "
                f"{self.alignment.method} needs none"
            )
        return self

    @model_validator(mode="after")
    def _drives_differ(self) -> FlexMapConfig:
        names = [drive.name.lower() for drive in self.drives]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f"drive {twice} stands twice in drives")
        seen = {(self.gnss.file, self.slam.file)}
        for drive in self.drives:
            if (drive.gnss.file, drive.slam.file) in seen:
                raise ValueError(f"drive {drive.name} is the same recording as another: it would count twice")
            seen.add((drive.gnss.file, drive.slam.file))
        if self.drives and self.alignment.method != "pose_graph":
            raise ValueError(f"drives are fused by alignment.method pose_graph, not {self.alignment.method}")
        return self
