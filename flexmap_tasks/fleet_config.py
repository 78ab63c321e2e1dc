"""What a fleet is: its maps, where their recordings arrive, and how they are kept up to date."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints, model_validator

from flexmap_tasks.config import Name, NonNegative, OsmInput, Params, Positive


class Recordings(Params):
    """Where the recordings of a map arrive."""

    folder: Path | None = Field(None, description="of this machine, or mounted alike on all")
    bucket: Annotated[str, StringConstraints(pattern=r"^s3://[^/]+")] | None = Field(
        None,
        description="s3://bucket/prefix in place of a folder; server and credentials from the environment",
    )
    pattern: Annotated[str, StringConstraints(min_length=1, pattern=r"^[^/]")] = Field(
        "*.mcap", description="glob below it; `*/recording.mcap` and `**/*.mcap` work too"
    )
    take: Literal["newest", "all", "fuse"] = Field(
        "newest",
        description="newest: the map follows the last drive; all: each drive makes a map <name>.<recording>; fuse: "
        "each is fused with the config's own files, in whose SLAM frame its poses are localised (`drives`)",
    )
    order: Literal["time", "name"] = Field(
        "time", description="what newest means: last written, or last by name"
    )
    settle_s: NonNegative = Field(30.0, description="a file written to more recently is still on its way")
    leave_out: tuple[str, ...] = Field(
        (), description="globs of recordings that do not count, by their path below it"
    )
    max_age_days: Positive | None = Field(None, description="recordings written longer ago do not count")
    at_most: Annotated[int, Field(ge=1)] | None = Field(
        None, description="of those that count, only so many of the newest are taken"
    )
    inputs: tuple[Literal["gnss.file", "slam.file", "point_cloud.file"], ...] = Field(
        ("gnss.file", "slam.file"), min_length=1, description="settings that a recording stands for"
    )

    @model_validator(mode="after")
    def _one_place(self) -> Recordings:
        if (self.folder is None) == (self.bucket is None):
            raise ValueError("give either `folder` or `bucket`")
        if self.take == "fuse" and set(self.inputs) != {"gnss.file", "slam.file"}:
            raise ValueError("take: fuse is for recordings that hold both gnss.file and slam.file")
        return self


class FleetMap(Params):
    """One map of the fleet."""

    name: Name
    config: Path = Field(description="YAML of map_update that everything else is taken from")
    recordings: Recordings | None = Field(None, description="the config's own files when empty")
    osm: OsmInput | None = Field(None, description="in place of the config's")
    parameters: dict[str, Any] = Field({}, description="settings to override, as key.path: value")
    timeout_s: Positive | None = Field(None, description="in place of the fleet's")


class Schedule(Params):
    """When the fleet is updated by itself."""

    cron: str | None = Field(None, min_length=9, description='such as "0 2 * * *"')
    interval_s: Annotated[float, Field(ge=60)] | None = None
    timezone: str = "UTC"

    @model_validator(mode="after")
    def _one_of(self) -> Schedule:
        if (self.cron is None) == (self.interval_s is None):
            raise ValueError("give either `cron` or `interval_s`")
        return self


class WorkPool(Params):
    """Prefect's work pool that runs the maps."""

    name: Name = "flexmap"
    type: Literal["process", "docker", "kubernetes"] = "process"
    job_variables: dict[str, Any] = Field({}, description="for every run, such as env, working_dir or image")


class FleetConfig(Params):
    """All maps of a fleet, and how they are run."""

    name: Name = "fleet"
    store: str = Field("artifacts", description="folder of the artifact store, or s3://bucket/prefix")
    releases: Path | None = Field(None, description="folder of the releases; below the store when empty")
    maps: tuple[FleetMap, ...] = Field(min_length=1)
    parameters: dict[str, Any] = Field({}, description="overrides for every map, as key.path: value")
    runs_at_once: Annotated[int, Field(ge=1, le=10_000)] = 2
    timeout_s: Positive = Field(7200.0, description="a run of one map that takes longer is ended")
    start_timeout_s: Positive = Field(
        600.0, description="a run that a worker took but has not begun after this time is started again"
    )
    retries: Annotated[int, Field(ge=0, le=10)] = Field(
        1, description="how often a run that crashed is started again; a wrong input is not tried again"
    )
    poll_s: Annotated[float, Field(ge=0.2, le=600)] = Field(
        3.0, description="how often the state of runs is asked for"
    )
    work_pool: WorkPool | None = Field(None, description="without one, maps run as processes of the update")
    schedule: Schedule | None = None
    notification_block: str | None = Field(
        None, description="Prefect block for notes about held and failed maps, such as slack-webhook/maps"
    )

    @model_validator(mode="after")
    def _names_differ(self) -> FleetConfig:
        names = [m.name for m in self.maps]
        twice = next((n for n in names if names.count(n) > 1), None) if len(set(names)) < len(names) else None
        if twice is not None:
            raise ValueError(f"map {twice} stands twice")
        return self
