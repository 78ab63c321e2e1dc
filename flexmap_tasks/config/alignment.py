"""How track, map and cloud come into the map frame."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, StringConstraints, model_validator

from flexmap_tasks.config.base import NonNegative, Params, Positive


class GeoPoint(Params):
    """A place on the WGS84 ellipsoid."""

    lat_deg: Annotated[float, Field(ge=-80, le=84)]
    lon_deg: Annotated[float, Field(ge=-180, le=180)]


class ProjectionParams(Params):
    """The map frame: UTM metres minus the origin."""

    origin: Literal["first_fix"] | GeoPoint = "first_fix"
    datum: str = Field("WGS84", description="datum and realisation of the fixes, recorded as given")
    zone: Annotated[str, StringConstraints(pattern=r"^([1-9]|[1-5][0-9]|60)[NS]$")] | None = Field(
        None, description='UTM zone such as "32N"; the origin\'s own when empty'
    )


class UmeyamaParams(Params):
    """Rigid start (Umeyama 1991)."""

    points: Annotated[int, Field(ge=3, le=1_000_000)] = Field(500, description="samples over the arc length")
    grid_scale: bool = Field(
        True, description="apply the UTM grid scale at the origin, so that true metres become grid metres"
    )


class AutomaticControlPointsParams(Params):
    """Control points of the rubber sheet, chosen from the tracks."""

    count: Annotated[int, Field(ge=3, le=1000)] = Field(20, description="at most so many")
    spacing_m: Positive = Field(50.0, description="none is nearer than this to another")
    sigma_m: Positive = Field(
        0.1, description="a pair with this standard deviation counts 0.7 of a perfect one"
    )
    max_stretch: Annotated[float, Field(gt=0, lt=1)] = Field(
        0.1,
        description="a point is left out where it would stretch or squeeze the sheet by more than this share",
    )
    clock_offset_max_s: NonNegative = Field(
        2.0, description="how far the clocks of GNSS and SLAM may be apart"
    )


class ControlPointsParams(Params):
    """Control points given by the user."""

    max_rigid_distance_m: Positive = Field(
        200.0, description="a pair further apart than this after the rigid start does not belong together"
    )
    sigma_m: Positive = Field(0.1, description="standard deviation of a pair whose line gives none")
    automatic: AutomaticControlPointsParams | None = Field(
        None,
        description="points that the rubber sheet chooses from the tracks, under those of the file; left empty, it "
        "does so where there is no file",
    )


class PairParams(ControlPointsParams):
    """The same, with what the method needs of them."""

    sheet: bool = Field(
        True, description="they alone say how the plane is bent: at least three, not on a line"
    )


class RubberSheetParams(Params):
    """Rubber sheet (White and Griffin 1985)."""

    margin_share: NonNegative = Field(0.1, description="rectangle around all that moves, grown by this share")


class PoseGraphParams(Params):
    """Pose graph: SLAM, GNSS, revisits and control points in one adjustment."""

    node_spacing_m: Positive = Field(
        2.5, description="SLAM poses nearer than this to the last one are carried along"
    )
    revisit_radius_m: NonNegative = Field(
        5.0, description="poses of different passes this near hold each other as SLAM has them; 0 for none"
    )
    clock_offset_max_s: NonNegative = Field(
        2.0, description="how far the clocks of GNSS and SLAM may be apart; 0 takes them as one"
    )
    antenna_up_m: float = Field(
        0.0, allow_inf_nan=False, description="height of the antenna over the SLAM body; no drive can tell it"
    )
    height: Literal["altitude", "keep", "model"] = Field(
        "altitude",
        description="heights by the altitudes of GNSS; as SLAM has them; or laid onto alignment.height_model",
    )
    body_up_m: float = Field(
        0.0, allow_inf_nan=False, description="height of the SLAM body over the ground of a height model"
    )
    multipath_min_m: Positive = Field(
        0.5,
        description="a stretch of GNSS that stands off by more than this, and significantly, is left out",
    )
    blend_sigma_m: Positive = Field(8.0, description="places between poses follow all poses about this near")


class HeightModelParams(Params):
    """What the numbers of a height model mean."""

    epsg: Annotated[int, Field(ge=1024, le=32766)] | None = Field(
        None, description="of its coordinates; may stay empty where a GeoTIFF states it"
    )
    vertical_datum: str = Field(
        "", max_length=100, description="of its heights, such as DHHN2016; recorded, nothing is converted"
    )


class HeightModelInput(HeightModelParams):
    """The ground's height: GeoTIFF, ESRI ASCII grid or lines "x y height"."""

    file: Path


class GraphHeldOutParams(Params):
    """GNSS withheld to see how far the pose graph is to be trusted."""

    block_m: Positive = Field(100.0, description="length of a withheld block")
    folds: Annotated[int, Field(ge=2, le=50)] = Field(
        5, description="every so-many-th block is withheld at once"
    )
    graph: PoseGraphParams = PoseGraphParams()


class AlignmentParams(Params):
    """How track, map and cloud come into the map frame."""

    master: Literal["gnss", "slam"] = Field(
        "gnss", description="the frame that stays; slam moves OSM instead"
    )
    method: Literal["pose_graph", "rubber_sheet", "rigid"] = Field(
        "pose_graph", description="rubber_sheet is the paper's and needs control points; rigid bends nothing"
    )
    control_points_file: Path | None = Field(None, description="CSV of pairs, see README")
    pose_graph: PoseGraphParams = PoseGraphParams()
    height_model: HeightModelInput | None = Field(
        None, description="what pose_graph.height: model lays the drive onto"
    )
    umeyama: UmeyamaParams = UmeyamaParams()
    control_points: ControlPointsParams = ControlPointsParams()
    rubber_sheet: RubberSheetParams = RubberSheetParams()

    @model_validator(mode="after")
    def _a_model_where_one_is_used(self) -> AlignmentParams:
        wanted = self.method == "pose_graph" and self.pose_graph.height == "model"
        if wanted and self.height_model is None:
            raise ValueError("pose_graph.height: model needs height_model.file")
        if self.height_model is not None and not wanted:
            raise ValueError("height_model is used by pose_graph.height: model only")
        return self
