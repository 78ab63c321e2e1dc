"""Maps as runs of their deployments on a work pool: any worker of the pool may take any of them."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TypeVar
from uuid import UUID

import httpx
from prefect.client.orchestration import PrefectClient, get_client
from prefect.client.schemas.filters import (
    FlowRunFilter,
    FlowRunFilterId,
    FlowRunFilterState,
    FlowRunFilterStateType,
    FlowRunFilterTags,
)
from prefect.client.schemas.objects import FlowRun, StateType
from prefect.deployments import arun_deployment
from prefect.exceptions import ObjectNotFound, PrefectHTTPStatusError
from prefect.states import Cancelled, Cancelling, Crashed

from flexmap_tasks.fleet_config import FleetConfig
from flows.fleet_jobs import Job, open_store
from flows.fleet_plan import Row, Todo, finished_row

FLOW = "map_update"
ASK_AT_ONCE = 200
"""How many runs are asked for in one request."""

HEARTBEAT_S = 30
"""Prefect's smallest; runs of a deployed fleet send one that often."""

SILENT_S = 4.0 * HEARTBEAT_S
"""A run that has not been heard of for so long has lost its worker."""

LISTEN_TO = 10
"""Runs whose heartbeats are asked for in one request, which answers with 50 events at most."""

T = TypeVar("T")

GONE = "not heard of any more: its worker is gone"

Done = Callable[[Row], None]


@dataclass(slots=True)
class Started:
    """A run on its way.

    asked : when it was started here; begun : when it was first seen running; heard : its last sign of life
    """

    job: Job
    attempt: int
    asked: datetime
    begun: datetime | None = None
    heard: datetime | None = None


class Pool:
    """Starts runs, at most as many at once as the fleet allows, and follows them to their end."""

    def __init__(self, fleet: FleetConfig, client: PrefectClient, label: str, done: Done) -> None:
        self._fleet, self._client, self._label, self._done = fleet, client, label, done
        self._rows: list[Row] = []
        self._running: dict[UUID, Started] = {}
        self._listened = datetime.now(UTC)

    async def run(self, todo: Sequence[Todo]) -> list[Row]:
        """One row per job."""
        waiting = deque((item.job, 0) for item in todo)
        while waiting or self._running:
            while waiting and len(self._running) < self._fleet.runs_at_once:
                await self._start(*waiting.popleft())
            await asyncio.sleep(self._fleet.poll_s)
            await self._listen()
            for run in await self._ask():
                again = await self._follow(run)
                if again is not None:
                    waiting.append(again)
        return self._rows

    async def _start(self, job: Job, attempt: int) -> None:
        assert job.config is not None  # noqa: S101 - planned jobs have one
        asked = datetime.now(UTC)
        try:
            run = await arun_deployment(
                f"{FLOW}/{job.entry.name}",
                client=self._client,
                parameters={
                    "config": job.config.model_dump(mode="json", exclude_unset=True),
                    "store": self._fleet.store,
                    "releases": str(self._fleet.releases) if self._fleet.releases else None,
                },
                flow_run_name=job.map if attempt == 0 else f"{job.map} (again)",
                timeout=0,
                tags=[f"fleet:{self._fleet.name}", f"map:{job.map}"],
                idempotency_key=f"{self._label}-{job.map}-{attempt}",
            )
        except ObjectNotFound:
            self._end(job, "failed", "has no deployment; run `flexmap fleet deploy`")
        except PrefectHTTPStatusError as error:
            self._end(job, "failed", f"could not be started: {error.response.text[:300]}")
        else:
            self._running[run.id] = Started(job, attempt, asked)

    async def _ask(self) -> list[FlowRun]:
        """The runs on their way; none when the server is away for a moment."""
        ids, found = list(self._running), []
        try:
            for some in batched(ids, ASK_AT_ONCE):
                these = FlowRunFilter(id=FlowRunFilterId(any_=some))
                found += await self._client.read_flow_runs(flow_run_filter=these, limit=ASK_AT_ONCE)
        except (httpx.TransportError, PrefectHTTPStatusError):
            return []
        return found

    async def _listen(self) -> None:
        """Ask for the heartbeats of the last minutes, now and then."""
        now = datetime.now(UTC)
        if (now - self._listened).total_seconds() < HEARTBEAT_S:
            return
        self._listened = now
        for run_id in await heard_of(self._client, list(self._running)):
            self._running[run_id].heard = now

    async def _follow(self, run: FlowRun) -> tuple[Job, int] | None:
        """Take note of a run's state; the job again when it has to be started anew."""
        started, now = self._running[run.id], datetime.now(UTC)
        state = run.state
        if state is None:
            return None
        if state.is_final():
            del self._running[run.id]
            return self._final(run, started)
        if state.is_running():
            started.begun = started.begun or now
            if (now - (started.heard or started.begun)).total_seconds() > SILENT_S:
                await self._client.set_flow_run_state(run.id, Crashed(message=GONE))
                return None
        limit = started.job.entry.timeout_s or self._fleet.timeout_s
        if started.begun is not None and (now - started.begun).total_seconds() > limit:
            del self._running[run.id]
            await self._cancel(run.id, f"took longer than {limit:g} s")
            self._end(started.job, "timed out", f"took longer than {limit:g} s", run)
        elif state.is_pending() and (now - state.timestamp).total_seconds() > self._fleet.start_timeout_s:
            # its worker is gone: nothing else would ever move this run
            await self._client.set_flow_run_state(run.id, Crashed(message=GONE))
        return None

    def _final(self, run: FlowRun, started: Started) -> tuple[Job, int] | None:
        assert run.state is not None  # noqa: S101 - told by the caller
        job, state = started.job, run.state
        if state.is_completed() or state.name == "Rejected":
            row = finished_row(open_store(self._fleet), job, started.asked, str(run.id))
            if row is not None:
                self._note(row)
                return None
        if state.is_crashed() and started.attempt < self._fleet.retries:
            return job, started.attempt + 1
        words = {"CRASHED": "crashed", "CANCELLED": "cancelled"}
        self._end(job, words.get(state.type.value, "failed"), state.message or state.name or "", run)
        return None

    async def _cancel(self, run_id: UUID, why: str) -> None:
        """Ask the worker to end the run; where no worker answers, say so ourselves."""
        await self._client.set_flow_run_state(run_id, Cancelling(message=why), force=True)
        for _ in range(10):
            await asyncio.sleep(2)
            run = await self._client.read_flow_run(run_id)
            if run.state is not None and run.state.is_final():
                return
        await self._client.set_flow_run_state(run_id, Cancelled(message=why), force=True)

    def _end(self, job: Job, state: str, reason: str, run: FlowRun | None = None) -> None:
        label = str(run.id) if run is not None else ""
        self._note(Row(job.map, state, reason=reason, recording=job.recording, run=label))

    def _note(self, row: Row) -> None:
        self._rows.append(row)
        self._done(row)


async def heard_of(client: PrefectClient, runs: Sequence[UUID]) -> set[UUID]:
    """Those runs that gave a sign of life lately; all of them when the server does not answer."""
    since = datetime.now(UTC) - timedelta(seconds=SILENT_S)
    found: set[UUID] = set()
    for some in batched(runs, LISTEN_TO):
        wanted = {
            "event": {"name": ["prefect.flow-run.heartbeat", "prefect.flow-run.Running"]},
            "resource": {"id": [f"prefect.flow-run.{run}" for run in some]},
            "occurred": {"since": since.isoformat()},
        }
        try:
            answer = await client.request("POST", "/events/filter", json={"filter": wanted, "limit": 50})
        except (httpx.TransportError, PrefectHTTPStatusError):
            found.update(some)
            continue
        found.update(
            UUID(e["resource"]["prefect.resource.id"].rpartition(".")[2]) for e in answer.json()["events"]
        )
    return found


async def end_lost_runs(fleet: FleetConfig, but: UUID | None) -> int:
    """Runs of this fleet whose worker has gone count as crashed, so that nothing waits for them; their number."""
    async with get_client() as client:
        ours = FlowRunFilter(
            tags=FlowRunFilterTags(all_=[f"fleet:{fleet.name}"]),
            state=FlowRunFilterState(type=FlowRunFilterStateType(any_=[StateType.RUNNING])),
        )
        running = await client.read_flow_runs(flow_run_filter=ours, limit=ASK_AT_ONCE)
        old = datetime.now(UTC) - timedelta(seconds=SILENT_S)
        ids = [run.id for run in running if run.id != but and (run.start_time or old) <= old]
        lost = set(ids) - await heard_of(client, ids)
        for run_id in sorted(lost):
            await client.set_flow_run_state(run_id, Crashed(message=GONE))
    return len(lost)


def batched(items: Sequence[T], size: int) -> Iterator[list[T]]:
    """The items in lists of at most that many."""
    for i in range(0, len(items), size):
        yield list(items[i : i + size])


async def run_on_pool(
    fleet: FleetConfig, todo: Sequence[Todo], label: str, done: Done = lambda _row: None
) -> list[Row]:
    """One row per job; `label` says which update starts them, so that none is started twice."""
    async with get_client() as client:
        return await Pool(fleet, client, label, done).run(todo)
