"""What a user may set: one frozen pydantic model per stage, units in every name.

A stage gets only its own model. Paths are relative to the file they stand in. Unknown keys are
errors. `configs/defaults.yaml` is written from these models and checked against them.
"""

from flexmap_tasks.config.alignment import (
    AlignmentParams,
    ControlPointsParams,
    GeoPoint,
    GraphHeldOutParams,
    PairParams,
    PoseGraphParams,
    ProjectionParams,
    RubberSheetParams,
    UmeyamaParams,
)
from flexmap_tasks.config.base import (
    Name,
    NonNegative,
    Params,
    Positive,
    Share,
)
from flexmap_tasks.config.conflation import (
    DEFAULT_RULES,
    HIGHWAY_SUBTYPES,
    ZONE_SPEEDS_KMH,
    CollapseParams,
    ConflationParams,
    GapsParams,
    MatchParams,
    PathParams,
    TransferParams,
    TransferRule,
)
from flexmap_tasks.config.inputs import (
    GnssInput,
    GnssParams,
    LaneletMapInput,
    OsmFetchParams,
    OsmInput,
    OsmRoadsParams,
    PointCloudInput,
    PointCloudParams,
    ScanParams,
    ScanTilesParams,
    SensorPose,
    SlamInput,
    SlamParams,
)
from flexmap_tasks.config.map_update import (
    FlexMapConfig,
)
from flexmap_tasks.config.output import (
    EvaluationParams,
    GateLimit,
    GateParams,
    GeoreferenceParams,
    ReportParams,
    TruthEvaluationParams,
)

__all__ = [
    "DEFAULT_RULES",
    "HIGHWAY_SUBTYPES",
    "ZONE_SPEEDS_KMH",
    "AlignmentParams",
    "CollapseParams",
    "ConflationParams",
    "ControlPointsParams",
    "EvaluationParams",
    "FlexMapConfig",
    "GapsParams",
    "GateLimit",
    "GateParams",
    "GeoPoint",
    "GeoreferenceParams",
    "GnssInput",
    "GnssParams",
    "GraphHeldOutParams",
    "LaneletMapInput",
    "MatchParams",
    "Name",
    "NonNegative",
    "OsmFetchParams",
    "OsmInput",
    "OsmRoadsParams",
    "PairParams",
    "Params",
    "PathParams",
    "PointCloudInput",
    "PointCloudParams",
    "PoseGraphParams",
    "Positive",
    "ProjectionParams",
    "ReportParams",
    "RubberSheetParams",
    "ScanParams",
    "ScanTilesParams",
    "SensorPose",
    "Share",
    "SlamInput",
    "SlamParams",
    "TransferParams",
    "TransferRule",
    "TruthEvaluationParams",
    "UmeyamaParams",
]
