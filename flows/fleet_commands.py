"""What `flexmap fleet` does."""

from __future__ import annotations

import asyncio
import json
import os
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.table import Table

from flexmap_tasks.engine.gate import published_release, read_quality, read_verdict
from flexmap_tasks.engine.runs import last_run
from flexmap_tasks.errors import FlexMapError, InputError
from flexmap_tasks.fleet_config import FleetConfig
from flexmap_tasks.store.store import Store
from flows import console
from flows.fleet_jobs import Job, find_jobs, load_fleet, open_store
from flows.fleet_plan import Row, Todo, plan_fleet, plan_job
from flows.fleet_processes import run_processes
from flows.fleet_recordings import choose, find_recordings
from flows.running import PREFECT_SETTINGS

BAD = ("failed", "crashed", "timed out", "cancelled")


class FleetFailedError(FlexMapError):
    """An update came to its end, but not all of its maps did."""

    exit_code = 5


def update(file: Path, *, through_prefect: bool) -> None:
    """Bring all maps up to date, and say what became of each."""
    rows = _update_with_prefect(file) if through_prefect else _update_here(file)
    show_rows(rows)
    bad = [row.map for row in rows if row.state in BAD]
    if bad:
        raise FleetFailedError(
            f"{len(bad)} of {len(rows)} maps did not come to an end: {', '.join(bad[:10])}"
        )


def _update_here(file: Path) -> list[Row]:
    fleet = load_fleet(file)
    store = open_store(fleet)
    store.check_writable()
    rows, todo = plan_fleet(store, fleet)
    for item in todo:
        console.say(f"{item.job.map}: {item.why}")
    rows += asyncio.run(
        run_processes(fleet, todo, lambda row: console.say(f"{row.map}: {row.state} {row.reason}"))
    )
    return sorted(rows, key=lambda row: row.map)


def _update_with_prefect(file: Path) -> list[Row]:
    load_fleet(file)  # its faults as one line, before Prefect starts
    prepare_prefect()
    from flows.fleet_update import fleet_update  # noqa: PLC0415 - importing Prefect takes seconds

    flow: Any = fleet_update(str(file.resolve()), return_state=True)
    state: Any = asyncio.run(flow)
    result = state.result(raise_on_failure=False)
    if isinstance(result, BaseException):
        raise result
    return [Row(**row) for row in result]


def show_rows(rows: Sequence[Row]) -> None:
    """The summary."""
    table = Table(box=None)
    for column in ("map", "state", "release", "seconds", "saved", "recording", "why"):
        table.add_column(
            column, overflow="fold", justify="right" if column in ("seconds", "saved") else "left"
        )
    for row in rows:
        reason = row.reason.replace("[", r"\[")
        table.add_row(
            row.map, row.state, row.release, f"{row.seconds:.1f}", f"{row.saved_s:.1f}", row.recording, reason
        )
    console.show(table)


def status(file: Path, *, as_json: bool) -> None:
    """Every map: what is published, how old, how good, and what waits."""
    fleet = load_fleet(file)
    store = open_store(fleet)
    rows = [status_row(store, job) for job in find_jobs(fleet)]
    if as_json:
        console.write(json.dumps(rows, indent=1) + "\n")
        return
    table = Table(box=None)
    for column in rows[0]:
        table.add_column(column.replace("_", " "), overflow="fold")
    for row in rows:
        table.add_row(*("" if v is None else str(v).replace("[", r"\[") for v in row.values()))
    console.show(table)


def status_row(store: Store, job: Job) -> dict[str, Any]:
    """One map's standing; changes nothing."""
    published = published_release(store, job.map)
    last = last_run(store, job.map)
    verdict = read_verdict(store, job.map, last.release) if last is not None and last.release else None
    quality = (read_quality(store, job.map, published) if published else None) or {}
    try:
        found = plan_job(store, job, publish=False)
    except FlexMapError as error:
        found = Row(job.map, "failed", reason=str(error))
    return {
        "map": job.map,
        "release": published,
        "age_h": _hours(read_verdict(store, job.map, published)) if published else None,
        "last_run": last.finished[:16] if last is not None else None,
        "last_state": verdict.state if verdict is not None else None,
        **{name: _figure(quality.get(name)) for name in console.FLEET_HEADLINES},
        "next": "will run" if isinstance(found, Todo) else found.state,
        "why": found.why if isinstance(found, Todo) else found.reason,
        "on_their_way": job.on_its_way,
    }


def recordings(file: Path, maps: Sequence[str]) -> None:
    """Every recording that arrived: whether it is used, and why."""
    fleet = load_fleet(file)
    unknown = sorted(set(maps) - {entry.name for entry in fleet.maps})
    if unknown:
        raise InputError(file.name, f"has no map {unknown[0]}")
    table = Table(box=None)
    for name in ("map", "recording", "written", "MB", "why"):
        table.add_column(name, overflow="fold", justify="right" if name == "MB" else "left")
    now = time.time()
    for entry in fleet.maps:
        if entry.recordings is None or (maps and entry.name not in maps):
            continue
        complete, moving = find_recordings(entry.recordings, now)
        for choice in choose(entry.recordings, complete, now):
            found = choice.recording
            written = datetime.fromtimestamp(found.written_ns / 1e9, UTC).isoformat(timespec="minutes")
            row = (entry.name, found.name, written, f"{found.stamp[0] / 1e6:.1f}", choice.why)
            table.add_row(*(cell.replace("[", r"\[") for cell in row), style="green" if choice.used else None)
        if moving:
            table.add_row(entry.name, f"{moving} more", "", "", "on their way")
    console.show(table)


def _hours(verdict: Any) -> float | None:
    if verdict is None:
        return None
    return round((datetime.now(UTC) - datetime.fromisoformat(verdict.decided)).total_seconds() / 3600, 1)


def _figure(measure: Any) -> float | None:
    return None if measure is None or measure["value"] is None else float(f"{measure['value']:.4g}")


def deploy(file: Path) -> None:
    """Register the fleet on the configured server."""
    prepare_prefect()
    from flows.deployments import deploy_fleet  # noqa: PLC0415 - importing Prefect takes seconds

    for name in asyncio.run(deploy_fleet(file)):
        console.say(f"deployed {name}")


def notify(file: Path, maps: Sequence[str]) -> None:
    """Tell the server that recordings arrived."""
    fleet = load_fleet(file)
    prepare_prefect()
    from flows.deployments import announce_recordings  # noqa: PLC0415 - importing Prefect takes seconds

    asyncio.run(announce_recordings(fleet, list(maps)))
    console.say(f"{fleet.name}: told the server that recordings arrived")


def watch(file: Path, every_s: float) -> None:
    """Look for ever for recordings that have become complete, and for runs that have lost their worker.

    In both cases the server is told, and starts an update.
    """
    prepare_prefect()
    from flows.fleet_pool import end_lost_runs  # noqa: PLC0415 - importing Prefect takes seconds

    known = arrived(load_fleet(file))
    console.say(f"watching {sum(len(files) for files in known.values())} recordings of {len(known)} maps")
    while True:
        time.sleep(every_s)
        fleet = load_fleet(file)
        found = arrived(fleet)
        new = [name for name, files in found.items() if files - known.get(name, frozenset())]
        if asyncio.run(end_lost_runs(fleet, None)) or new:
            notify(file, new)
        known = found


def arrived(fleet: FleetConfig) -> dict[str, frozenset[tuple[str, int]]]:
    """Complete recordings by map, each with its time: a file that is written anew is a new one."""
    found = {}
    for entry in fleet.maps:
        if entry.recordings is not None:
            try:
                files, _ = find_recordings(entry.recordings, time.time())
            except FlexMapError:  # said by the update; a folder or server may come back
                continue
            found[entry.name] = frozenset((file.path, file.written_ns) for file in files)
    return found


def prepare_prefect() -> None:
    """Settings without which Prefect is slow to start or talks to others, unless they are set."""
    for name, value in PREFECT_SETTINGS.items():
        os.environ.setdefault(name, value)
