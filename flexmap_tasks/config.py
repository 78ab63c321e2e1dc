"""What a user may set: one frozen pydantic model per stage, units in every name.

A stage gets only its own model. Paths are relative to the file they stand in. Unknown keys are
errors. `configs/defaults.yaml` is written from these models and checked against them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$")]


class Params(BaseModel):
    """Base of all settings: frozen, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", str_strip_whitespace=True, validate_default=True)


# --- inputs -------------------------------------------------------------------------------------


class GnssParams(Params):
    """Which GNSS fixes to read from a recording."""

    format: Literal["auto", "mcap", "text"] = Field("auto", description="by content when auto")
    topic: str | None = Field(None, description="MCAP topic; may stay empty when only one fits")


class SlamParams(Params):
    """Which SLAM trajectory to read from a recording."""

    format: Literal["auto", "mcap", "kitti", "tum"] = Field("auto", description="by content when auto")
    topic: str | None = Field(None, description="MCAP topic; may stay empty when only one fits")
    parent_frame: str | None = Field(None, description="tf2_msgs/TFMessage: frame the pose is given in")
    child_frame: str | None = Field(None, description="tf2_msgs/TFMessage: frame whose pose is taken")


class GnssInput(GnssParams):
    """The recording that holds GNSS fixes."""

    file: Path


class SlamInput(SlamParams):
    """The recording that holds the SLAM trajectory."""

    file: Path


class LaneletMapInput(Params):
    """The Lanelet2 map in the SLAM frame."""

    file: Path


class PointCloudParams(Params):
    """How a point cloud is cut into tiles."""

    tile_size_m: Annotated[int, Field(ge=1, le=10_000)] = Field(
        20,
        description="edge of a tile, axis-parallel in the map frame; whole metres, as Autoware's loader wants",
    )
    voxel_size_m: Annotated[float, Field(ge=0, allow_inf_nan=False)] = Field(
        0.0, description="one point kept per voxel of this edge, at least 0.001; 0 keeps all"
    )
    outlier_neighbours: Annotated[int, Field(ge=0, le=1000)] = Field(
        0,
        description="points whose mean distance to this many neighbours stands out are left out; 0 keeps all",
    )
    outlier_deviations: Positive = Field(
        2.0, description="how many standard deviations over the tile's mean distance stand out"
    )
    viewpoint: Literal["refuse", "ignore"] = Field(
        "refuse",
        description="a PCD VIEWPOINT other than identity: an error, or known to say nothing about the points",
    )

    @model_validator(mode="after")
    def _voxel_of_a_millimetre(self) -> PointCloudParams:
        if 0 < self.voxel_size_m < 0.001:
            raise ValueError("voxel_size_m must be 0 or at least 0.001")
        return self


class PointCloudInput(PointCloudParams):
    """The point cloud map in the SLAM frame."""

    file: Path


class OsmFetchParams(Params):
    """An OpenStreetMap server asked for the box around the track."""

    endpoint: Annotated[str, StringConstraints(pattern=r"^https?://[^\s/]+")] = Field(
        description="http(s) address of an OSM API 0.6 or Overpass endpoint"
    )
    api: Literal["osm06", "overpass"] = "osm06"
    margin_m: Annotated[float, Field(ge=0, le=10_000)] = Field(
        200.0, description="added around the track's box"
    )
    max_age_days: NonNegative = Field(30.0, description="an extract older than this is fetched again")
    timeout_s: Annotated[float, Field(gt=0, le=3600)] = 60.0


class OsmRoadsParams(Params):
    """Which ways of OpenStreetMap count as roads."""

    highways: tuple[str, ...] = Field(
        (
            "motorway", "motorway_link", "trunk", "trunk_link", "primary", "primary_link", "secondary",
            "secondary_link", "tertiary", "tertiary_link", "unclassified", "residential",
            "living_street", "service", "busway", "road",
        ),
        description="values of `highway` that vehicles drive on",
    )  # fmt: skip


class OsmInput(OsmRoadsParams):
    """OpenStreetMap: a file, or a server to fetch it from."""

    file: Path | None = None
    fetch: OsmFetchParams | None = None

    @model_validator(mode="after")
    def _one_of(self) -> OsmInput:
        if (self.file is None) == (self.fetch is None):
            raise ValueError("give either `file` or `fetch`")
        return self


# --- alignment ----------------------------------------------------------------------------------


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


class ControlPointsParams(Params):
    """Control points of the rubber sheet."""

    max_rigid_distance_m: Positive = Field(
        200.0, description="a pair further apart than this after the rigid start does not belong together"
    )
    sigma_m: Positive = Field(0.1, description="standard deviation of a pair whose line gives none")


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
    multipath_min_m: Positive = Field(
        0.5,
        description="a stretch of GNSS that stands off by more than this, and significantly, is left out",
    )
    blend_sigma_m: Positive = Field(8.0, description="places between poses follow all poses about this near")


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
    umeyama: UmeyamaParams = UmeyamaParams()
    control_points: ControlPointsParams = ControlPointsParams()
    rubber_sheet: RubberSheetParams = RubberSheetParams()


# --- conflation ---------------------------------------------------------------------------------


class CollapseParams(Params):
    """Adjacent lanelets become one centreline."""

    lane_subtypes: tuple[str, ...] = Field(
        ("road", "highway", "play_street", "bus_lane"), description="subtypes that count as lanes"
    )
    driving_side: Literal["right", "left"] = "right"
    connect_distance_m: Positive = Field(1.0, description="ends nearer than this become one point")


class PathParams(Params):
    """Matching of all lanelet paths as paths on the road graph, at once."""

    spacing_m: Positive = Field(5.0, description="distance between samples along the lanelets")
    radius_m: Positive = Field(20.0, description="roads further away than this are no candidates")
    candidates: Annotated[int, Field(ge=1, le=30)] = Field(8, description="candidates per sample")
    correlation_m: Positive = Field(
        20.0, description="roads are displaced as a whole: samples nearer than this say the same thing"
    )
    sigma_start_m: Positive = Field(3.0, description="scatter of roads before it is estimated")
    angle_sigma_deg: Positive = 12.0
    absent_cost: NonNegative = Field(
        4.0, description="misfit of a sample at which no counterpart is as likely"
    )
    gap_cost: NonNegative = Field(3.0, description="misfit for a change between a road and no counterpart")
    jump_cost: NonNegative = Field(5.0, description="misfit for a change to a road that is not connected")
    detour_m: Positive = Field(4.0, description="metres of detour per unit of misfit")
    wrong_way_cost: NonNegative = Field(2.0, description="misfit for driving against a one-way road")
    level_cost: NonNegative = Field(
        2.0,
        description="misfit for the lower of two roads above each other on a bridge, or the upper below it",
    )
    minor_cost: NonNegative = Field(0.5, description="misfit for service roads for few, and private roads")
    rounds: Annotated[int, Field(ge=1, le=10)] = Field(3, description="estimates of displacement and scatter")
    review_confidence: Share = Field(0.7, description="a less certain match goes to review")


class MatchParams(Params):
    """How lanelets find their roads. All but `path` belongs to buffer growing, with the original's defaults."""

    method: Literal["path", "buffer_growing"] = Field(
        "path",
        description="path: all lanelet paths at once; buffer_growing: the paper's (Zhang and Meng 2005)",
    )
    path: PathParams = PathParams()
    segment_length_m: Positive = 5.0
    reference_angle_max_deg: Positive = Field(
        30.0, description="a reference polyline ends at a sharper corner"
    )
    buffer_half_width_m: Positive = 2.5
    buffer_overshoot_m: NonNegative = 3.0
    buffer_corner: Share = Field(0.5, description="how much of the buffer's corner is cut")
    enlargement_factor: Annotated[float, Field(gt=1)] = 1.5
    enlargements: Annotated[int, Field(ge=1, le=10)] = Field(3, description="rounds, the first included")
    angle_max_deg: Positive = 20.0
    length_max_m: Positive = 20.0
    chord_max_m: Positive = 15.0
    area_max_m: Positive = Field(10.0, description="enclosed area over length")
    weight_angle: NonNegative = 0.35
    weight_length: NonNegative = 0.2
    weight_chord: NonNegative = 0.35
    weight_area: NonNegative = 0.1


class TransferRule(Params):
    """One row of the mapping table: an OSM key and where its value goes."""

    key: str = Field(description="OSM tag")
    variants: tuple[str, ...] = Field((), description="OSM tags read, in this order, where `key` is absent")
    target: str = Field(description="Lanelet2 attribute")
    parser: Literal["text", "word", "speed", "subtype", "location", "oneway"] = "text"
    element: Literal["tag", "speed_limit_rule"] = Field(
        "tag", description="write a tag of the lanelet, or a Lanelet2 speed limit rule it refers to"
    )
    policy: Literal["osm_wins", "fill_only", "review_conflicts"] = Field(
        "osm_wins", description="when the map has another value: replace it, leave it, or ask a person"
    )

    @model_validator(mode="after")
    def _speed_rule(self) -> TransferRule:
        if self.element == "speed_limit_rule" and (self.parser, self.target) != ("speed", "speed_limit"):
            raise ValueError("element speed_limit_rule needs parser speed and target speed_limit")
        return self


DEFAULT_RULES = (
    TransferRule(key="highway", target="subtype", parser="subtype"),
    TransferRule(key="highway", target="location", parser="location"),
    TransferRule(key="maxspeed", target="speed_limit", parser="speed"),
    TransferRule(key="name", variants=("official_name", "loc_name"), target="road_name"),
    TransferRule(key="surface", target="road_surface", parser="word"),
    TransferRule(key="oneway", target="one_way", parser="oneway"),
    TransferRule(key="lane_markings", target="lane_markings", parser="word"),
)

HIGHWAY_SUBTYPES = {
    "motorway": "highway", "motorway_link": "highway", "trunk": "highway", "trunk_link": "highway",
    "primary": "road", "primary_link": "road", "secondary": "road", "secondary_link": "road",
    "tertiary": "road", "tertiary_link": "road", "unclassified": "road", "residential": "road",
    "service": "road", "road": "road", "track": "road", "living_street": "play_street",
    "busway": "bus_lane", "cycleway": "bicycle_lane", "pedestrian": "walkway", "footway": "walkway",
}  # fmt: skip

ZONE_SPEEDS_KMH: dict[str, float | Literal["none"]] = {
    "at:urban": 50, "at:rural": 100, "at:trunk": 100, "at:motorway": 130, "at:living_street": 7,
    "be:urban": 50, "be:motorway": 120, "be:living_street": 20,
    "ch:urban": 50, "ch:rural": 80, "ch:trunk": 100, "ch:motorway": 120, "ch:living_street": 20,
    "cz:urban": 50, "cz:rural": 90, "cz:motorway": 130, "cz:living_street": 20,
    "de:urban": 50, "de:rural": 100, "de:motorway": "none", "de:living_street": 7, "de:bicycle_road": 30,
    "dk:urban": 50, "dk:rural": 80, "dk:motorway": 130,
    "es:urban": 50, "es:rural": 90, "es:motorway": 120, "es:living_street": 20,
    "fr:urban": 50, "fr:rural": 80, "fr:motorway": 130, "fr:living_street": 20,
    "gb:nsl_single": 96.56, "gb:nsl_dual": 112.65, "gb:nsl_restricted": 48.28, "gb:motorway": 112.65,
    "it:urban": 50, "it:rural": 90, "it:trunk": 110, "it:motorway": 130,
    "nl:urban": 50, "nl:rural": 80, "nl:trunk": 100, "nl:living_street": 15,
    "pl:urban": 50, "pl:rural": 90, "pl:motorway": 140, "pl:living_street": 20,
    "se:urban": 50, "se:rural": 70, "se:motorway": 110, "se:living_street": 7,
}  # fmt: skip
"""Limits that OSM names by country and zone, in lower case."""


class TransferParams(Params):
    """What OSM's tags become on the lanelets."""

    rules: tuple[TransferRule, ...] = DEFAULT_RULES
    highway_subtypes: dict[str, str] = Field(HIGHWAY_SUBTYPES, description="OSM highway to Lanelet2 subtype")
    zone_speeds_kmh: dict[str, float | Literal["none"]] = Field(
        ZONE_SPEEDS_KMH, description="limit behind a maxspeed code such as DE:urban; codes in lower case"
    )
    no_limit_kmh: Positive | None = Field(None, description="written for maxspeed=none; review when empty")
    confidence_min: Share = Field(0.5, description="a match less certain than this changes nothing")
    coverage_min: Share = Field(0.5, description="less of a lanelet matched goes to review")
    split: bool = Field(True, description="cut lanelets where a transferred value changes")
    split_end_distance_m: Positive = Field(3.0, description="no cut nearer to an end than this")
    split_snap_m: NonNegative = Field(1.0, description="cut at an existing vertex when one is this near")
    split_stretch_m: NonNegative = Field(5.0, description="a value that holds for less is not worth a cut")
    split_gap_m: Positive = Field(20.0, description="an unmatched end longer than this is cut off")
    split_junctions: bool = Field(
        False,
        description="also cut lanelets that fork, merge or turn; else the longer part decides for the whole",
    )
    junction_max_m: Positive = Field(50.0, description="a longer lanelet is no mere way through a junction")
    split_everywhere: bool = Field(
        False, description="also cut carriageways with lanelets that are closed to cars or driven both ways"
    )
    remove_fragments: bool = Field(False, description="delete unconnected lanelets beyond OSM's lane count")
    speed_jump_kmh: Positive = Field(
        50.0,
        description="a short stretch this much faster, or slower, than before and after it goes to review",
    )
    speed_jump_max_m: NonNegative = Field(100.0, description="a longer stretch is believed; 0 believes all")
    lanes_far: Annotated[int, Field(ge=1)] = Field(
        2, description="a lane count this far from OSM's goes to review"
    )
    provenance_tags: bool = Field(
        False, description="write way, version and time beside every value: source:<key>"
    )
    lane_check_tags: bool = Field(False, description="write the verdict of the lane check: lane_check")

    @model_validator(mode="after")
    def _one_rule_per_target(self) -> TransferParams:
        targets = [rule.target for rule in self.rules]
        twice = sorted({t for t in targets if targets.count(t) > 1})
        if twice:
            raise ValueError(f"two rules write {twice[0]}: give one, with the other key among its `variants`")
        return self


class ConflationParams(Params):
    """How OpenStreetMap's knowledge reaches the lanelets."""

    collapse: CollapseParams = CollapseParams()
    match: MatchParams = MatchParams()
    transfer: TransferParams = TransferParams()
    review_file: Path | None = Field(
        None, description="CSV of people's decisions on values up for review, as the report saves it"
    )


# --- output -------------------------------------------------------------------------------------


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
    held_out_block_m: NonNegative = Field(
        100.0,
        description="GNSS withheld in blocks of this length to see how far the pose graph can be trusted; 0 for none",
    )
    held_out_folds: Annotated[int, Field(ge=2, le=50)] = Field(
        5, description="every so-many-th block at once"
    )
    short_reference_m: NonNegative = Field(1.5, description="shorter references are left out of statistics")
    true_positive_score: Share = Field(0.8, description="the paper's self-score for a true positive")


class ReportParams(Params):
    """What the report says at its top."""

    map: Name = Field(description="name of the map")


class HeldOutParams(Params):
    """Which GNSS is withheld from the alignment, to judge it by."""

    block_m: Positive = Field(100.0, description="length of a block")
    every: Annotated[int, Field(ge=2, le=100)] = Field(5, description="one block of so many is withheld")
    fold: Annotated[int, Field(ge=0)] = Field(0, description="the first withheld block")

    @model_validator(mode="after")
    def _fold_of_every(self) -> HeldOutParams:
        if self.fold >= self.every:
            raise ValueError("fold must be less than every")
        return self


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
