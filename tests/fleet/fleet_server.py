"""A real Prefect server and real workers on loopback, started and ended by the test."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx

SETTINGS = {
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    "DO_NOT_TRACK": "1",
    "PREFECT_LOGGING_LEVEL": "WARNING",
    "NO_PROXY": "127.0.0.1,localhost",
    "NUMBA_NUM_THREADS": "1",
    "PREFECT_WORKER_QUERY_SECONDS": "2",
}


PATIENCE_S = 300
"""A server with SQLite on a machine that is busy with other work."""


class Server:
    """A Prefect server with a database of its own."""

    def __init__(self, home: Path, port: int) -> None:
        self.url = f"http://127.0.0.1:{port}"
        self.environment = {
            **{k: v for k, v in os.environ.items() if not k.startswith("PREFECT_")},
            **SETTINGS,
            "PREFECT_HOME": str(home),
            "PREFECT_API_URL": f"{self.url}/api",
            "PREFECT_SERVER_UI_API_URL": f"{self.url}/api",
        }
        self._home, self._port = home, port
        self._started: list[subprocess.Popen[bytes]] = []

    def start(self, *command: str, log: str) -> subprocess.Popen[bytes]:
        """A process of this server's world; its words go to a file below its home."""
        with (self._home / log).open("ab") as file:
            process = subprocess.Popen(
                [sys.executable, "-m", *command],
                env=self.environment, start_new_session=True, stdin=subprocess.DEVNULL, stdout=file, stderr=file,
            )  # fmt: skip
        self._started.append(process)
        return process

    def worker(self, name: str, pool: str, limit: int) -> subprocess.Popen[bytes]:
        """A worker of a process pool."""
        return self.start(
            "prefect", "worker", "start", "--pool", pool, "--type", "process", "--name", name, "--limit", str(limit),
            log=f"{name}.log",
        )  # fmt: skip

    def flexmap(self, *arguments: str, expect: int = 0) -> str:
        """What the command says."""
        done = subprocess.run(
            [sys.executable, "-m", "flows.cli", *arguments],
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == expect, done.stdout + done.stderr
        return done.stdout + done.stderr

    def ask(self, path: str, **body: Any) -> Any:
        """A POST to the API."""
        answer = httpx.post(f"{self.url}/api{path}", json=body, timeout=PATIENCE_S, trust_env=False)
        answer.raise_for_status()
        return answer.json()

    def get(self, path: str) -> Any:
        """A GET from the API."""
        answer = httpx.get(f"{self.url}/api{path}", timeout=PATIENCE_S, trust_env=False)
        answer.raise_for_status()
        return answer.json()

    def update(self, fleet: str, timeout_s: float) -> dict[str, Any]:
        """Run the deployed update to its end; its flow run."""
        deployment = self.get(f"/deployments/name/fleet_update/{fleet}")
        run = self.ask(f"/deployments/{deployment['id']}/create_flow_run", state={"type": "SCHEDULED"})
        return self.wait(run["id"], timeout_s)

    def wait(self, run_id: str, timeout_s: float) -> dict[str, Any]:
        """The flow run when it has ended."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            run: dict[str, Any] = self.get(f"/flow_runs/{run_id}")
            if run["state_type"] in ("COMPLETED", "FAILED", "CRASHED", "CANCELLED"):
                return run
            time.sleep(1)
        raise AssertionError(f"{run['name']} is still {run['state_name']} after {timeout_s} s")

    def runs(self, flow: str) -> list[dict[str, Any]]:
        """Runs of a flow that have begun."""
        return list(
            self.ask(
                "/flow_runs/filter",
                flows={"name": {"any_": [flow]}},
                flow_runs={"start_time": {"is_null_": False}},
                sort="START_TIME_ASC",
            )
        )

    def map_runs(self, since: str) -> list[dict[str, Any]]:
        """Runs of map_update created after a time that have begun."""
        return [run for run in self.runs("map_update") if run["created"] > since]

    def artifact(self, key: str) -> Any:
        """The newest artifact under a key."""
        return self.get(f"/artifacts/{key}/latest")

    def end(self) -> None:
        """End everything that was started."""
        for process in reversed(self._started):
            kill_tree(process.pid)
            process.wait(30)

    def begin(self) -> None:
        """Start the server and wait until it answers."""
        process = self.start(
            "prefect", "server", "start", "--host", "127.0.0.1", "--port", str(self._port), log="server.log"
        )
        deadline = time.monotonic() + 180
        while time.monotonic() < deadline:
            assert process.poll() is None, (self._home / "server.log").read_text()
            with contextlib.suppress(httpx.TransportError):
                if httpx.get(f"{self.url}/api/health", timeout=5, trust_env=False).status_code == 200:
                    return
            time.sleep(0.5)
        raise AssertionError("the server did not answer within 180 s")


@contextlib.contextmanager
def running_server(home: Path, port: int | None = None) -> Iterator[Server]:
    """A server for the length of a test."""
    home.mkdir(parents=True, exist_ok=True)
    server = Server(home, port or free_port())
    try:
        server.begin()
        yield server
    finally:
        server.end()


def free_port() -> int:
    """A port nobody listens on at this moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def kill_tree(pid: int) -> None:
    """End a process and all that descends from it, without a chance to say goodbye."""
    for child in children(pid):
        kill_tree(child)
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def children(pid: int) -> list[int]:
    """Processes that a process has started and that live."""
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            found += [int(word) for word in task.read_text().split()]
    return found
