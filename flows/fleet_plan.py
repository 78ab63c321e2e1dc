"""Which maps of a fleet have something to do, and why. Costs a few file stamps for a map that has nothing to do."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

from flexmap_tasks.engine.execute import Engine
from flexmap_tasks.engine.finished import still_finished, watch
from flexmap_tasks.engine.gate import read_verdict
from flexmap_tasks.engine.local import heal, run_local
from flexmap_tasks.engine.plan import Plan, make_plan
from flexmap_tasks.engine.runs import last_run, read_last_run
from flexmap_tasks.errors import FlexMapError
from flexmap_tasks.fleet_config import FleetConfig
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.store.store import Store
from flows.failures import known_failure
from flows.finish import finish_run
from flows.fleet_index import Index, Settled, made_with
from flows.fleet_jobs import Job, jobs_of

NOT_AGAIN = "(unchanged since, not tried again)"
"""Ends the reason of a failure that will be the same as long as its files are."""


@dataclass(frozen=True, slots=True)
class Row:
    """What became of one map in one update: a row of the summary.

    state : unchanged, waiting (no complete recording), published, held, rejected, failed, crashed or timed out
    seconds : computed; saved_s : not computed because results were there; run : Prefect's flow run
    """

    map: str
    state: str
    release: str = ""
    reason: str = ""
    seconds: float = 0.0
    saved_s: float = 0.0
    recording: str = ""
    run: str = ""

    def to_json(self) -> dict[str, Any]:
        """The row as plain values."""
        return {**asdict(self), "seconds": round(self.seconds, 2), "saved_s": round(self.saved_s, 2)}


@dataclass(frozen=True, slots=True)
class Todo:
    """A job that has something to do, and why."""

    job: Job
    why: str


def plan_fleet(store: Store, fleet: FleetConfig) -> tuple[list[Row], list[Todo]]:
    """What is settled already, and what has to run."""
    rows: list[Row] = []
    todo: list[Todo] = []
    index = Index(store, fleet, made_with())
    new: dict[str, Settled] = {}
    for entry in fleet.maps:
        known = index.row(entry)
        if known is not None:
            rows.append(Row(**known))
            continue
        jobs = list(jobs_of(fleet, entry, time.time()))
        for job in jobs:
            found = _plan_or_say_why_not(store, job)
            if isinstance(found, Todo):
                todo.append(found)
                continue
            rows.append(found)
            stays = found.state != "failed" or found.reason.endswith(NOT_AGAIN)
            if stays and len(jobs) == 1 and job.config is not None and job.map == entry.name:
                watched = watch(map_update(job.config))
                line = index.line(entry, watched, _expires(store, job), found.to_json())
                new |= {entry.name: line} if line is not None else {}
    index.write(fleet.maps, new)
    return rows, todo


def _plan_or_say_why_not(store: Store, job: Job) -> Row | Todo:
    try:
        return plan_job(store, job)
    except FlexMapError as error:
        return Row(job.map, "failed", reason=str(error), recording=job.recording)


def _expires(store: Store, job: Job) -> float | None:
    """When what was fetched from a server gets too old, seconds since 1970; at once when it is not known."""
    if job.config is None or job.config.osm is None or job.config.osm.fetch is None:
        return None
    key = read_last_run(store, job.map).get("fetch_osm")
    record = store.peek(key) if key else None
    if record is None:
        return 0.0
    return datetime.fromisoformat(record.started).timestamp() + 86_400 * job.config.osm.fetch.max_age_days


def plan_job(store: Store, job: Job, *, publish: bool = True) -> Row | Todo:
    """A row when there is nothing to do; a map whose results are all there is published on the way, if wanted."""
    config = job.config
    if job.fault:
        return Row(job.map, "failed", reason=job.fault, recording=job.recording)
    if config is None:
        left_out = f", {job.left_out} do not count" if job.left_out else ""
        return Row(
            job.map, "waiting", reason=f"no complete recording; {job.on_its_way} on their way{left_out}"
        )
    finished = still_finished(store, config, store.releases)
    if finished is not None:
        return settled(store, job, finished.release.id)
    graph = map_update(config)
    watched = watch(graph)
    known = known_failure(store, config, watched)
    if known is not None:
        return Row(job.map, "failed", reason=f"{known} {NOT_AGAIN}", recording=job.recording)
    plan = make_plan(Engine(store), graph, read_last_run(store, job.map))
    if not plan.all_cached or not publish:
        return Todo(job, why(plan))
    release = heal(lambda: finish_run(store, graph, run_local(store, graph), config, watched))
    return settled(store, job, release.id)


def settled(store: Store, job: Job, release_id: str) -> Row:
    """A map for which nothing ran: unchanged, or still not published."""
    verdict = read_verdict(store, job.map, release_id)
    _, saved = accounts(store, job.map, None)
    published = verdict is None or verdict.state == "published"
    state = "unchanged" if published or verdict is None else verdict.state
    reason = "nothing changed" if published or verdict is None else "; ".join(verdict.reasons)
    return Row(job.map, state, release_id, reason, 0.0, saved, job.recording)


def finished_row(store: Store, job: Job, since: datetime, run: str = "") -> Row | None:
    """The row of a run that came to its end; None when none did."""
    last = last_run(store, job.map)
    if last is None or last.release is None:
        return None
    verdict = read_verdict(store, job.map, last.release)
    computed, saved = accounts(store, job.map, since)
    state = verdict.state if verdict is not None else "published"
    reasons = "; ".join(verdict.reasons) if verdict is not None else ""
    return Row(job.map, state, last.release, reasons, computed, saved, job.recording, run)


def accounts(store: Store, map_name: str, since: datetime | None) -> tuple[float, float]:
    """Seconds of the last run's actions made since a time, and of those from before (all when it is None)."""
    computed = saved = 0.0
    for key in read_last_run(store, map_name).values():
        record = store.peek(key)
        if record is None:
            continue
        if since is not None and datetime.fromisoformat(record.started) >= since:
            computed += record.seconds
        else:
            saved += record.seconds
    return computed, saved


def why(plan: Plan) -> str:
    """The plan in one line."""
    run = [step for step in plan.steps if step.state == "run"]
    more = f", and {len(run) - 1} more" if len(run) > 1 else ""
    return f"{run[0].node.name}: {run[0].why}{more}" if run else "all results are there, but no release"
