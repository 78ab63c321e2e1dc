"""Everything one map update needs."""

from __future__ import annotations

from pydantic import Field, model_validator

from flexmap_tasks.config.alignment import AlignmentParams, ProjectionParams
from flexmap_tasks.config.base import Name, Params
from flexmap_tasks.config.conflation import ConflationParams
from flexmap_tasks.config.inputs import GnssInput, LaneletMapInput, OsmInput, PointCloudInput, SlamInput
from flexmap_tasks.config.output import EvaluationParams, GateParams, GeoreferenceParams


class FlexMapConfig(Params):
    """Everything one map update needs."""

    map: Name = Field(description="name of the map; releases go to releases/<map>/")
    gnss: GnssInput
    slam: SlamInput
    lanelet_map: LaneletMapInput | None = None
    point_cloud: PointCloudInput | None = None
    osm: OsmInput | None = None
    projection: ProjectionParams = ProjectionParams()
    alignment: AlignmentParams = AlignmentParams()
    conflation: ConflationParams = ConflationParams()
    georeference: GeoreferenceParams = GeoreferenceParams()
    evaluation: EvaluationParams = EvaluationParams()
    gate: GateParams = GateParams()

    @model_validator(mode="after")
    def _needs_control_points(self) -> FlexMapConfig:
        if self.alignment.method == "rubber_sheet" and self.alignment.control_points_file is None:
            raise ValueError("alignment.method rubber_sheet needs alignment.control_points_file")
        return self
