"""What a simulated world may be: one frozen model per part, units in every name."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from flexmap_tasks.config import Name, NonNegative, Params, Positive, Share

Count = Annotated[int, Field(ge=0, le=1_000_000)]
Metres = Annotated[float, Field(allow_inf_nan=False)]
Degrees = Annotated[float, Field(ge=-360, le=360)]


class Place(Params):
    """Where on Earth the town stands."""

    lat_deg: Annotated[float, Field(ge=-79, le=83)] = 48.2643
    lon_deg: Annotated[float, Field(ge=-180, le=180)] = 11.6690
    height_m: Annotated[float, Field(ge=-400, le=6000)] = Field(480.0, description="above the ellipsoid")


class NetworkSettings(Params):
    """The roads. Every count says how many of a kind are built; each is placed by the seed."""

    layout: Literal["grid", "radial", "organic", "motorway", "osm"] = "grid"
    topology_file: Path | None = Field(None, description="an OSM extract whose roads are taken; layout osm")
    topology_radius_m: Positive = Field(1000.0, description="roads this near the place are taken; layout osm")
    blocks_x: Annotated[int, Field(ge=1, le=400)] = 3
    blocks_y: Annotated[int, Field(ge=1, le=400)] = 3
    block_m: Annotated[float, Field(ge=60, le=5000)] = 130.0
    jitter_m: NonNegative = Field(10.0, description="how far junctions stray from the layout")
    bend_m: NonNegative = Field(6.0, description="how far roads bow between junctions")
    lane_width_m: Annotated[float, Field(ge=2, le=6)] = 3.25
    lane_width_spread_m: Annotated[float, Field(ge=0, le=0.8)] = 0.25
    main_every: Annotated[int, Field(ge=1, le=100)] = Field(3, description="every n-th line is a main road")
    main_lanes: Annotated[int, Field(ge=1, le=4)] = Field(2, description="per direction on main roads")
    roundabouts: Count = 0
    islands: Count = 0
    dual_carriageways: Count = 0
    slip_lanes: Count = 0
    frontage_roads: Count = 0
    one_way_pairs: Count = 0
    overpasses: Count = 0
    cul_de_sacs: Count = 0
    parking_aisles: Count = 0
    living_streets: Count = 0
    bus_lanes: Count = 0
    bicycle_lanes: Count = 0
    signals: Count = 0
    stop_signs: Count = 0
    crosswalks: Count = 0
    tag_changes: Count = Field(0, description="places between junctions where name, limit or surface change")
    relief_m: NonNegative = Field(0.0, description="standard deviation of the ground's height")
    relief_length_m: Positive = 400.0
    clearance_m: Positive = Field(6.0, description="height of a bridge over the road below")

    @model_validator(mode="after")
    def _topology(self) -> NetworkSettings:
        if (self.layout == "osm") != (self.topology_file is not None):
            raise ValueError("`topology_file` belongs to layout osm, and layout osm needs it")
        return self


class DriveSettings(Params):
    """The vehicle's way through the town."""

    length_m: Annotated[float, Field(ge=50, le=1_000_000)] = 1500.0
    return_to_start: bool = False
    acceleration_m_s2: Positive = 1.5
    lateral_acceleration_m_s2: Positive = 2.0
    speed_max_m_s: Positive = 13.9
    stops_per_km: NonNegative = 1.0
    stop_s: NonNegative = 12.0
    start_ns: Annotated[int, Field(ge=0, le=4_000_000_000 * 10**9)] = 1_763_800_000_000_000_000


class GnssSettings(Params):
    """NavSatFix: what the receiver says, and what it gets wrong."""

    rate_hz: Annotated[float, Field(ge=0.1, le=100)] = 10.0
    lever_arm_m: tuple[Metres, Metres, Metres] = Field(
        (0.0, 0.0, 0.0), description="antenna seen from the SLAM body: forward, left, up"
    )
    white_sigma_m: NonNegative = Field(
        0.01, description="RTK fixed, each horizontal axis; twice that in height"
    )
    slow_sigma_m: NonNegative = Field(0.02, description="wandering part, RTK fixed")
    slow_time_s: Positive = 60.0
    float_share: Share = Field(0.0, description="of the time in RTK float")
    float_sigma_m: NonNegative = 0.4
    dgps_share: Share = 0.0
    dgps_sigma_m: NonNegative = 1.0
    single_share: Share = 0.0
    single_sigma_m: NonNegative = 2.5
    covariance: Literal["honest", "optimistic", "wrong", "unknown"] = "honest"
    multipath_stretches: Count = 0
    multipath_offset_m: NonNegative = 1.2
    multipath_length_m: Positive = 100.0
    outages: Count = 0
    outage_length_m: Positive = 150.0
    outage_messages: bool = Field(False, description="send fixes with status -1 and NaN instead of silence")
    jumps: Count = Field(0, description="single fixes far off")
    jump_m: NonNegative = 8.0
    doubled_share: Share = 0.0
    dropped_share: Share = 0.0
    standstill_sigma_m: NonNegative = Field(0.0, description="scatter while the vehicle stands")
    altitude_bias_m: Metres = 0.0
    altitude_steps: Count = Field(0, description="stretches whose altitude is off as a whole, up or down")
    altitude_step_m: NonNegative = 10.0
    altitude_step_length_m: Positive = 200.0
    altitude_resolution_m: NonNegative = Field(0.0, description="what altitudes are rounded to; 0 for not")
    altitude: Literal["measured", "zero", "none"] = Field(
        "measured", description="loggers without altitude write 0, or NaN"
    )
    clock_offset_s: Annotated[float, Field(ge=-10, le=10)] = Field(
        0.0, description="GNSS stamp minus SLAM stamp of one moment"
    )
    latency_s: Annotated[float, Field(ge=0, le=10)] = Field(0.05, description="log time after the stamp")


class SlamSettings(Params):
    """Odometry: how SLAM wanders off."""

    rate_hz: Annotated[float, Field(ge=0.1, le=100)] = 10.0
    keyframe_m: Annotated[float, Field(ge=0, le=10)] = Field(
        0.0, description="a pose only after this distance; 0 keeps all"
    )
    yaw_walk_mrad_per_sqrt_m: NonNegative = 0.3
    pitch_walk_mrad_per_sqrt_m: NonNegative = 0.1
    scale_sigma: Annotated[float, Field(ge=0, le=0.05)] = Field(0.002, description="slowly varying")
    scale_length_m: Positive = 500.0
    position_walk_m_per_sqrt_m: NonNegative = 0.004
    position_noise_m: NonNegative = Field(0.01, description="white, every pose")
    angle_noise_mrad: NonNegative = 0.5
    loop_closure: Literal["smoothed", "jumps", "none"] = "smoothed"
    start_yaw_deg: Degrees = Field(0.0, description="heading of the vehicle in the SLAM frame at the start")
    tilt_roll_deg: Degrees = 0.0
    tilt_pitch_deg: Degrees = 0.0
    start_offset_m: tuple[Metres, Metres, Metres] = Field(
        (0.0, 0.0, 0.0), description="the first pose in the SLAM frame"
    )


class CloudSettings(Params):
    """The point cloud map, and scans in the log."""

    points: Annotated[int, Field(ge=0, le=1_000_000_000)] = 200_000
    noise_m: NonNegative = 0.01
    corridor_m: Positive = Field(18.0, description="half width of what the lidar sees beside a road")
    scans: bool = Field(False, description="PointCloud2 in the log")
    scan_rate_hz: Annotated[float, Field(ge=0.1, le=50)] = 2.0
    scan_points: Annotated[int, Field(ge=1, le=1_000_000)] = 20_000
    scan_range_m: Positive = 40.0
    rings: Annotated[int, Field(ge=1, le=256)] = 32
    truth_points: Annotated[int, Field(ge=0, le=1_000_000)] = Field(2_000, description="rows of the truth")


class HdMapSettings(Params):
    """The Lanelet2 map, drawn in the SLAM frame."""

    coverage: Literal["driven", "all"] = "driven"
    vertex_spacing_m: Annotated[float, Field(ge=0.5, le=50)] = 5.0
    annotation_sigma_m: NonNegative = Field(0.0, description="how far off the annotator clicks")
    cut_share: Share = Field(0.3, description="of the roads drawn as several lanelets in a row")
    stub_share: Share = Field(0.5, description="of the side roads drawn for a few metres")
    stub_min_m: Positive = 8.0
    stub_max_m: Positive = 25.0
    missing_lane_share: Share = Field(0.0, description="outer lanes left out")
    fragment_share: Share = Field(0.0, description="pieces of lane beyond the road's edge that lead nowhere")
    speed_limit_km_h: Annotated[int, Field(ge=1, le=200)] = Field(
        10, description="the drawing tool's own value"
    )
    shoulders: bool = False


class OsmSettings(Params):
    """OpenStreetMap's view of the same roads, and how wrong it is."""

    field_sigma_m: NonNegative = Field(0.5, description="smooth displacement, each axis")
    field_length_m: Positive = Field(60.0, description="over which the displacement changes")
    jitter_sigma_m: NonNegative = 0.1
    thin_m: NonNegative = Field(0.2, description="nodes nearer than this to the line are left out")
    split_share: Share = 0.1
    merge_share: Share = Field(0.7, description="of the joints with equal tags where ways are one")
    omit_share: Share = Field(0.0, description="of the tags")
    wrong_share: Share = Field(0.0, description="of the values of maxspeed, lanes and surface")
    missing_share: Share = Field(0.0, description="of the roads")
    invented_share: Share = Field(0.0, description="parallel roads that do not exist, per road")
    moved_share: Share = Field(0.0, description="of the roads between their junctions")
    moved_m: NonNegative = 8.0
    dual_as_one_share: Share = Field(0.0, description="of the dual carriageways drawn as one line")
    footways: bool = True
    later_date: bool = Field(False, description="a second extract, some time later")
    changed_share: Share = Field(0.05, description="of the roads changed at the second date, per kind")


class ControlPointSettings(Params):
    """Pairs as a person would pick them."""

    count: Annotated[int, Field(ge=0, le=10_000)] = 10
    sigma_m: NonNegative = Field(0.02, description="how far off the pairs are")


class World(Params):
    """A whole world. The same world gives the same bytes."""

    name: Name = "small_town"
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = 1
    place: Place = Place()
    driving_side: Literal["right", "left"] = "right"
    network: NetworkSettings = NetworkSettings()
    drive: DriveSettings = DriveSettings()
    gnss: GnssSettings = GnssSettings()
    slam: SlamSettings = SlamSettings()
    cloud: CloudSettings = CloudSettings()
    hd_map: HdMapSettings = HdMapSettings()
    osm: OsmSettings = OsmSettings()
    control_points: ControlPointSettings = ControlPointSettings()

    def changed(self, **parts: Any) -> World:
        """The same world with some settings changed: `world.changed(osm={"field_sigma_m": 3.0})`."""
        data = self.model_dump()
        for part, values in parts.items():
            if isinstance(data.get(part), dict):
                data[part] = {**data[part], **values}
            else:
                data[part] = values
        return World.model_validate(data)

    def noiseless(self) -> World:
        """The same town and drive with every error at zero: what is left is a rigid motion.

        Fixes and poses are then of the same moments, since lines over different vertices are not the same line.
        """
        return self.changed(
            gnss=dict.fromkeys(
                ("white_sigma_m", "slow_sigma_m", "float_share", "dgps_share", "single_share",
                 "multipath_stretches", "outages", "jumps", "doubled_share", "dropped_share",
                 "standstill_sigma_m", "altitude_bias_m", "altitude_steps",
                 "altitude_resolution_m", "clock_offset_s"), 0
            ) | {"lever_arm_m": (0.0, 0.0, 0.0), "covariance": "honest", "altitude": "measured"},
            slam=dict.fromkeys(
                ("yaw_walk_mrad_per_sqrt_m", "pitch_walk_mrad_per_sqrt_m", "scale_sigma",
                 "position_walk_m_per_sqrt_m",
                 "position_noise_m", "angle_noise_mrad", "tilt_roll_deg", "tilt_pitch_deg", "keyframe_m"), 0
            ) | {"rate_hz": self.gnss.rate_hz},
            cloud={"noise_m": 0},
            hd_map=dict.fromkeys(("annotation_sigma_m", "missing_lane_share", "fragment_share"), 0),
            osm=dict.fromkeys(
                ("field_sigma_m", "jitter_sigma_m", "thin_m", "omit_share", "wrong_share", "missing_share",
                 "invented_share", "moved_share", "dual_as_one_share"), 0
            ),
            control_points={"sigma_m": 0},
        )  # fmt: skip
