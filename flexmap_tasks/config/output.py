"""How the finished map is written, judged and gated."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, StringConstraints, model_validator

from flexmap_tasks.config.base import Name, NonNegative, Params, Positive, Share


class GeoreferenceParams(Params):
    """How the finished map is written."""

    projector: Literal["LocalCartesianUTM", "MGRS", "Local"] = Field(
        "LocalCartesianUTM", description="projector_type in map_projector_info.yaml"
    )
    vertical_datum: str = Field("WGS84", description="recorded in map_projector_info.yaml")


class EvaluationParams(Params):
    """Limits of the quality table; an empty limit is not judged."""

    deviation_rmse_max_m: Positive | None = Field(None, description="over all poses, after the warp")
    match_rate_min: Share | None = Field(None, description="share of reference polylines with a match")
    sigma_max_m: Positive | None = Field(None, description="largest predicted deviation of a pose, per axis")
    held_out_rmse_max_m: Positive | None = Field(None, description="error on withheld GNSS")
    lane_width_change_max_m: Positive | None = Field(
        None, description="change of a lane's width anywhere by moving the map"
    )
    lanelets_folded_max: Annotated[int, Field(ge=0)] | None = Field(
        0, description="lanelets whose outline crosses itself once the map is moved"
    )
    held_out_block_m: NonNegative = Field(
        100.0,
        description="GNSS withheld in blocks of this length to see how far the pose graph can be trusted; 0 for none",
    )
    held_out_folds: Annotated[int, Field(ge=2, le=50)] = Field(
        5, description="every so-many-th block at once"
    )
    short_reference_m: NonNegative = Field(1.5, description="shorter references are left out of statistics")
    true_positive_score: Share = Field(0.8, description="the paper's self-score for a true positive")


TILE_URL = r"^https?://[A-Za-z0-9.-]+(:[0-9]{1,5})?/[A-Za-z0-9._~/?=&%{}-]*$"


class TilesParams(Params):
    """Pictures behind the map of the report, from a server of web-map tiles; the page asks it only when told to."""

    url: Annotated[str, StringConstraints(pattern=TILE_URL, max_length=500)] = Field(
        description="with {z}, {x} and {y}, for example of an orthophoto"
    )
    attribution: str = Field("", max_length=200, description="what its licence wants to be read")
    max_zoom: Annotated[int, Field(ge=1, le=24)] = 19

    @model_validator(mode="after")
    def _names_a_tile(self) -> TilesParams:
        if any(part not in self.url for part in ("{z}", "{x}", "{y}")):
            raise ValueError("the address of a tile needs {z}, {x} and {y}")
        return self


class ReportParams(Params):
    """What the report says at its top, and what may lie behind its map."""

    map: Name = Field(description="name of the map")
    background: TilesParams | None = None


class TruthEvaluationParams(Params):
    """Limits of an evaluation against the truth; an empty limit is not judged."""

    trajectory_rmse_max_m: Positive | None = Field(None, description="error in the plane, poses with GNSS")
    map_error_p95_max_m: Positive | None = Field(None, description="error of the map's nodes in the plane")
    width_change_max_m: Positive | None = Field(None, description="change of a lane's width anywhere")
    harm_max: Annotated[int, Field(ge=0)] = Field(0, description="all counts of harm to the map together")
    match_f1_min: Share | None = Field(None, description="F1 of matching, by metre")
    calibration_error_max: Share | None = Field(None, description="expected calibration error of confidence")
    attribute_error_max: Share | None = Field(None, description="metres wrong or missing, each attribute")
    lane_subtypes: tuple[str, ...] = Field(
        ("road", "highway", "play_street", "bus_lane"), description="subtypes the baseline matches"
    )
    relative_steps: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        (1, 10, 100), description="relative pose error over so many poses"
    )


class GateLimit(Params):
    """What one figure of quality.json must keep, in its own unit, for a candidate to be published."""

    measure: str = Field(description="name in quality.json, such as deviation_after_valid_rmse")
    min: Annotated[float, Field(allow_inf_nan=False)] | None = None
    max: Annotated[float, Field(allow_inf_nan=False)] | None = None
    max_rise: NonNegative | None = Field(None, description="against the published release")
    max_fall: NonNegative | None = Field(None, description="against the published release")
    otherwise: Literal["hold", "reject"] = "hold"

    @model_validator(mode="after")
    def _some_bound(self) -> GateLimit:
        if self.min is None and self.max is None and self.max_rise is None and self.max_fall is None:
            raise ValueError("give at least one of min, max, max_rise and max_fall")
        return self


class GateParams(Params):
    """What decides whether a candidate becomes `latest`; with nothing set every candidate does."""

    limits: tuple[GateLimit, ...] = Field(
        (), description="each: measure, min, max, max_rise, max_fall, otherwise"
    )
    missed_quality: Literal["publish", "hold", "reject"] = Field(
        "publish", description="when a figure misses its limit of `evaluation`"
    )
