"""What a map update reads."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, StringConstraints, model_validator

from flexmap_tasks.config.base import NonNegative, Params, Positive

Metres = Annotated[float, Field(ge=-1000, le=1000)]
Degrees = Annotated[float, Field(ge=-360, le=360)]


class GnssParams(Params):
    """Which GNSS fixes to read from a recording."""

    format: Literal["auto", "mcap", "text", "nmea"] = Field("auto", description="by content when auto")
    topic: str | None = Field(None, description="MCAP topic; may stay empty when only one fits")
    nmea_date: date | None = Field(
        None, description="UTC day of the first fix of an NMEA log without dates (no RMC, no ZDA)"
    )


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


class DriveName(Params):
    """What a drive beside the map's own is called."""

    name: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,99}$")]


class DriveInput(DriveName):
    """Another recording of the area, its SLAM poses localised in the frame of the map's own SLAM."""

    gnss: GnssInput
    slam: SlamInput


class EditsInput(Params):
    """What a person has changed in a released map: the release they opened, and what they saved."""

    released: Path = Field(description="lanelet2_map.osm of the release that was opened")
    edited: Path = Field(description="the same map as it was saved after editing")


class LaneletMapInput(Params):
    """The Lanelet2 map in the SLAM frame."""

    file: Path
    edits: EditsInput | None = Field(
        None, description="a released map that a person has edited since: their edits are kept"
    )


class PointCloudParams(Params):
    """How a point cloud is cut into tiles."""

    tile_size_m: Annotated[int, Field(ge=1, le=10_000)] = Field(
        20,
        description="edge of a tile, axis-parallel in the map frame; whole metres, as Autoware's loader wants",
    )
    voxel_size_m: Annotated[float, Field(ge=0, allow_inf_nan=False)] = Field(
        0.0,
        description="of each voxel of this edge the point nearest its middle stays; at least 0.001; 0 keeps all",
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


class PcdParams(Params):
    """How the map's tiles are written."""

    coordinates: Literal["float32", "float64"] = Field(
        "float32",
        description="Autoware and PCL read only float32: within 0.5 mm up to 16 km from the origin",
    )


class CloudCheckParams(PcdParams):
    """What the check of a finished cloud depends on."""

    tile_size_m: int


class SensorPose(Params):
    """Where the sensor sits in the body whose poses SLAM gives: x forward, y left, z up."""

    x_m: Metres = 0.0
    y_m: Metres = 0.0
    z_m: Metres = 0.0
    roll_deg: Degrees = 0.0
    pitch_deg: Degrees = Field(0.0, description="positive: the sensor looks down")
    yaw_deg: Degrees = Field(0.0, description="positive: to the left; turned by roll, then pitch, then yaw")


class ScanParams(Params):
    """How scans of a recording become a cloud."""

    topic: str | Annotated[tuple[str, ...], Field(min_length=1)] | None = Field(
        None,
        description="of a recording: MCAP topic of the scans, or a list; may stay empty when only one fits",
    )
    sensor_pose: SensorPose | None = Field(
        None, description="overrules the recording's transforms from the body to the sensor"
    )
    body_frame: str | None = Field(
        None, description="frame that the SLAM poses are of; empty takes it from the topic of the poses"
    )
    min_range_m: NonNegative = Field(0.5, description="points nearer to the sensor are left out")
    max_range_m: NonNegative = Field(
        0.0, description="points further from the sensor are left out; 0 keeps all"
    )
    point_time: str = Field(
        "auto", description="field with the time of each point; auto finds it, none places each scan at once"
    )
    pose_gap_s: Positive = Field(
        1.0, description="no point is placed between poses further apart, unless the vehicle stood still"
    )

    @model_validator(mode="after")
    def _one_sensor_at_one_place(self) -> ScanParams:
        if self.sensor_pose is not None and isinstance(self.topic, tuple) and len(self.topic) > 1:
            raise ValueError("sensor_pose is the place of one sensor, but topic names several")
        return self


class PointCloudInput(PcdParams, ScanParams, PointCloudParams):
    """The point cloud map in the SLAM frame, or the recording whose scans make one."""

    file: Path
    format: Literal["auto", "cloud", "scans"] = Field(
        "auto", description="auto takes *.mcap for a recording with scans, all else for a cloud"
    )

    @property
    def has_scans(self) -> bool:
        """The file is a recording."""
        return self.format == "scans" or (self.format == "auto" and self.file.suffix.lower() == ".mcap")


class ScanTilesParams(Params):
    """Everything the making of a cloud from scans depends on."""

    tiles: PointCloudParams
    scans: ScanParams
    poses: SlamParams


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
    previous: Path | None = Field(
        None,
        description="an extract of another date: road_changes.parquet says what changed on matched roads",
    )

    @model_validator(mode="after")
    def _one_of(self) -> OsmInput:
        if (self.file is None) == (self.fetch is None):
            raise ValueError("give either `file` or `fetch`")
        return self
