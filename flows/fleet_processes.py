"""Maps as processes of this machine: a limit at once, a limit of time, and no fault of one reaches another."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

from flexmap_tasks.errors import HeldError, RejectedError
from flexmap_tasks.fleet_config import FleetConfig
from flexmap_tasks.formats.config_file import dump_config
from flows.fleet_jobs import Job, open_store
from flows.fleet_plan import Row, Todo, finished_row

GRACE_S = 10.0
"""Between asking a process to end and ending it."""

ENDED = (0, HeldError.exit_code, RejectedError.exit_code)
"""Exit codes of runs that made a candidate."""

Done = Callable[[Row], None]


async def run_processes(
    fleet: FleetConfig, todo: Sequence[Todo], done: Done = lambda _row: None, *, api_url: str | None = None
) -> list[Row]:
    """One row per job. With `api_url` each map runs as a Prefect flow against that server."""
    gate = asyncio.Semaphore(fleet.runs_at_once)

    async def one(item: Todo) -> Row:
        async with gate:
            row = await _run(fleet, item.job, api_url)
        done(row)
        return row

    return list(await asyncio.gather(*(one(item) for item in todo)))


async def _run(fleet: FleetConfig, job: Job, api_url: str | None) -> Row:
    """The map's row; a run that crashed is started again as often as the fleet allows."""
    name = ""
    for _ in range(fleet.retries + 1):
        started = datetime.now(UTC)
        code, last_line = await _process(fleet, job, api_url)
        if code is None:
            limit = job.entry.timeout_s or fleet.timeout_s
            return Row(job.map, "timed out", reason=f"took longer than {limit:g} s", recording=job.recording)
        if code in ENDED:
            row = finished_row(open_store(fleet), job, started)
            return row or Row(job.map, "failed", reason="ended without a release", recording=job.recording)
        if code > 0:
            return Row(job.map, "failed", reason=last_line or f"exit code {code}", recording=job.recording)
        name = signal.Signals(-code).name if -code in signal.valid_signals() else str(code)
    times = fleet.retries + 1
    return Row(job.map, "crashed", reason=f"ended by {name}, {times} times", recording=job.recording)


async def _process(fleet: FleetConfig, job: Job, api_url: str | None) -> tuple[int | None, str]:
    """Exit code (None after the time limit) and the last line of errors of `flexmap run`."""
    assert job.config is not None  # noqa: S101 - planned jobs have one
    with tempfile.TemporaryDirectory(prefix="flexmap-") as folder:
        file = Path(folder, f"{job.map}.yaml")
        file.write_text(dump_config(job.config), encoding="utf-8")
        command = [sys.executable, "-m", "flows.cli", "run", str(file), "--store", fleet.store]
        command += ["--releases", str(fleet.releases)] if fleet.releases else []
        command += [] if api_url else ["--no-prefect"]
        environment = {**os.environ, **({"PREFECT_API_URL": api_url} if api_url else {})}
        process = await asyncio.create_subprocess_exec(
            *command, env=environment, start_new_session=True,
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        try:
            timeout = job.entry.timeout_s or fleet.timeout_s
            _, errors = await asyncio.wait_for(process.communicate(), timeout)
        except TimeoutError:
            return None, ""
        finally:
            await _end(process)
    lines = errors.decode(errors="replace").strip().splitlines()
    return process.returncode, lines[-1].removeprefix("flexmap: ") if lines else ""


async def _end(process: asyncio.subprocess.Process) -> None:
    """End the process and its children, gently first."""
    for what in (signal.SIGTERM, signal.SIGKILL):
        if process.returncode is not None:
            return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, what)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(process.wait(), GRACE_S)
