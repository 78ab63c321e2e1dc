"""What a fleet's files ask for: one job per map (or per drive of a map), with its settings."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.errors import FlexMapError
from flexmap_tasks.fleet_config import FleetConfig, FleetMap
from flexmap_tasks.formats.config_file import change_config, load_config
from flexmap_tasks.store.store import Store
from flows.fleet_recordings import Recording, choose, find_recordings


@dataclass(frozen=True, slots=True)
class Job:
    """One map to keep up to date.

    map : name of the release line; recording : name of its file, "" when the config names the files
    config : None when there is none; fault : why there is none; on_its_way : recordings still being written
    left_out : complete ones that do not count, where none does
    """

    map: str
    entry: FleetMap
    recording: str = ""
    config: FlexMapConfig | None = None
    fault: str = ""
    on_its_way: int = 0
    left_out: int = 0


def load_fleet(file: Path) -> FleetConfig:
    """The fleet in a file; paths relative to it. Raises ConfigError."""
    fleet = load_config(FleetConfig, file)
    if "://" in fleet.store:
        return fleet
    store = str((file.parent / Path(fleet.store).expanduser()).resolve())
    return fleet.model_copy(update={"store": store})


def open_store(fleet: FleetConfig) -> Store:
    """The fleet's store."""
    return Store.open(fleet.store, fleet.releases)


def find_jobs(fleet: FleetConfig, now_s: float | None = None) -> list[Job]:
    """All jobs in the order of the file; a map whose files are at fault becomes a job with that fault."""
    now = time.time() if now_s is None else now_s
    return [job for entry in fleet.maps for job in jobs_of(fleet, entry, now)]


def jobs_of(fleet: FleetConfig, entry: FleetMap, now_s: float) -> Iterator[Job]:
    """The jobs of one map: one, or one per drive."""
    if entry.recordings is None:
        yield _job(fleet, entry, entry.name, None, 0)
        return
    try:
        settled, moving = find_recordings(entry.recordings, now_s)
    except FlexMapError as error:
        yield Job(entry.name, entry, fault=str(error))
        return
    used = [choice.recording for choice in choose(entry.recordings, settled, now_s) if choice.used]
    if entry.recordings.take == "fuse":
        yield _fused_job(fleet, entry, used, moving)
    elif not used:
        yield Job(entry.name, entry, on_its_way=moving, left_out=len(settled))
    elif entry.recordings.take == "newest":
        yield _job(fleet, entry, entry.name, used[-1], moving)
    else:
        for file in used:
            yield _job(fleet, entry, f"{entry.name}.{_label(file)}", file, moving)


def _job(fleet: FleetConfig, entry: FleetMap, name: str, recording: Recording | None, moving: int) -> Job:
    values: dict[str, Any] = {**fleet.parameters, **entry.parameters, "map": name}
    if entry.osm is not None:
        values["osm"] = entry.osm.model_dump(mode="json", exclude_unset=True)
    if recording is not None and entry.recordings is not None:
        values |= dict.fromkeys(entry.recordings.inputs, recording.path)
    label = recording.file if recording is not None else ""
    try:
        config = load_config(FlexMapConfig, entry.config, overrides(values))
    except FlexMapError as error:
        return Job(name, entry, label, fault=str(error), on_its_way=moving)
    return Job(name, entry, label, config, on_its_way=moving)


def _fused_job(fleet: FleetConfig, entry: FleetMap, used: Sequence[Recording], moving: int) -> Job:
    """The config's own recording, and as `drives` of it all others that count; read with the config's topics."""
    job = _job(fleet, entry, entry.name, None, moving)
    if job.config is None:
        return job
    gnss, slam = (
        part.model_dump(mode="json", exclude_unset=True) for part in (job.config.gnss, job.config.slam)
    )
    own = {gnss["file"], slam["file"]}
    drives = [drive.model_dump(mode="json", exclude_unset=True) for drive in job.config.drives]
    drives += [
        {
            "name": _label(file).strip("-") or "drive",
            "gnss": {**gnss, "file": file.path},
            "slam": {**slam, "file": file.path},
        }
        for file in used
        if file.path not in own
    ]
    try:
        config = change_config(job.config, overrides({"drives": drives}))
    except FlexMapError as error:
        return replace(job, config=None, fault=str(error))
    return replace(job, config=config, recording=used[-1].file if used else "")


def overrides(values: Mapping[str, Any]) -> list[str]:
    """Settings as `--set` takes them."""
    return [f"{key}={json.dumps(value)}" for key, value in values.items()]


def _label(recording: Recording) -> str:
    """A recording's part of a map's name: its path below the folder without suffix, in plain characters."""
    text = PurePosixPath(recording.name).with_suffix("").as_posix()
    return "".join(c if c.isalnum() and c.isascii() else "-" for c in text)[:60]
