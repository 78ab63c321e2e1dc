"""A whole fleet on one machine: Prefect server, workers, schedules, started and ended together."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import FrameType

import httpx

from flexmap_tasks.errors import ConfigError, FlexMapError
from flows import console
from flows.fleet_commands import deploy, prepare_prefect
from flows.fleet_jobs import load_fleet

HOST = "127.0.0.1"
START_S = 180.0
"""A server with a new database on a busy machine."""
GRACE_S = 15.0


class Stopped(Exception):  # noqa: N818 - no error: someone asked for it
    """A signal asked for the end."""


def up(file: Path, port: int, workers: int, *, watch_recordings: bool) -> None:
    """Start everything, and end everything when a signal comes or a part dies."""
    fleet = load_fleet(file)
    if fleet.work_pool is None:
        raise ConfigError(file.name, "a fleet that is run by workers needs a work pool", "work_pool")
    prepare_prefect()
    url = f"http://{HOST}:{port}"
    os.environ["PREFECT_API_URL"] = f"{url}/api"
    os.environ["PREFECT_SERVER_UI_API_URL"] = f"{url}/api"
    limit = max(2, -(-fleet.runs_at_once // workers) + 1)
    prefect = [sys.executable, "-m", "prefect"]
    with _family() as family, contextlib.suppress(Stopped, KeyboardInterrupt):
        server = [*prefect, "server", "start", "--host", HOST, "--port", str(port)]
        family["server"] = _start(server, quiet=True)
        _wait_for(f"{url}/api/health", family)
        deploy(file)
        for n in range(workers):
            worker = [
                *prefect,
                "worker",
                "start",
                "--pool",
                fleet.work_pool.name,
                "--type",
                fleet.work_pool.type,
            ]
            name = f"{fleet.name}-{n + 1}"
            family[f"worker {name}"] = _start([*worker, "--name", name, "--limit", str(limit)], quiet=False)
        if watch_recordings:
            family["watch"] = _start(
                [sys.executable, "-m", "flows.cli", "fleet", "watch", str(file)], quiet=False
            )
        console.say(f"{fleet.name} is up: {url} (Ctrl-C ends it)")
        while True:
            time.sleep(1)
            _check(family)


@contextlib.contextmanager
def _family() -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Processes that end with this one, the last started first."""
    family: dict[str, subprocess.Popen[bytes]] = {}
    before = signal.signal(signal.SIGTERM, _stop)
    try:
        yield family
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        for process in reversed(family.values()):
            end(process)
        signal.signal(signal.SIGTERM, before)
        console.say("everything has ended")


def end(process: subprocess.Popen[bytes], grace_s: float = GRACE_S) -> None:
    """End a process and all it has started: asked first, then ended."""
    for what in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, what)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(grace_s)
            break
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)  # children that outlived it


def _start(
    command: list[str], *, quiet: bool, environment: Mapping[str, str] = os.environ
) -> subprocess.Popen[bytes]:
    """A process in a group of its own, so that a Ctrl-C reaches only us and we end it in order."""
    out = subprocess.DEVNULL if quiet else None
    return subprocess.Popen(  # noqa: S603 - our own commands
        command, env=dict(environment), start_new_session=True, stdin=subprocess.DEVNULL, stdout=out
    )


def _wait_for(health: str, family: Mapping[str, subprocess.Popen[bytes]]) -> None:
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline:
        _check(family)
        with contextlib.suppress(httpx.TransportError):
            if httpx.get(health, timeout=5, trust_env=False).status_code == 200:
                return
        time.sleep(0.5)
    raise FlexMapError(f"Prefect's server did not answer at {health} within {START_S:g} s")


def _check(family: Mapping[str, subprocess.Popen[bytes]]) -> None:
    for name, process in family.items():
        if process.poll() is not None:
            raise FlexMapError(
                f"{name} ended with exit code {process.returncode}; its last words stand above"
            )


def _stop(_signal: int, _frame: FrameType | None) -> None:
    raise Stopped
