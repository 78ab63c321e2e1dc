"""The simulated fleet over three nights: `python -m tests.fleet.fleet_nights` (20 maps, 2 workers, one killed)."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import tempfile
import threading
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from fleet_server import Server, children, kill_tree, running_server
from fleet_town import break_log, drive_again, write_fleet


def night(
    server: Server, timeout_s: float = 1800, pictures: Path | None = None
) -> tuple[list[dict[str, Any]], list[dict[str, Any]], float]:
    """One update: the rows of its table, the runs of maps it started, seconds."""
    clock, since = time.monotonic(), datetime.now(UTC).isoformat()
    run = server.update("towns", timeout_s)
    assert run["state_type"] == "COMPLETED", run["state"]["message"]
    table = json.loads(server.artifact("towns-fleet")["data"])
    seconds = time.monotonic() - clock
    if pictures is not None:
        from fleet_pictures import take  # noqa: PLC0415 - needs a browser

        bad = [row["reason"] for row in table if row["state"] == "failed"]
        take(server, run["id"], pictures, [run["name"], "published", *(reason[:40] for reason in bad)])
    return table, server.map_runs(since), seconds


def states(table: list[dict[str, Any]]) -> dict[str, str]:
    """State by map."""
    return {row["map"]: row["state"] for row in table}


def nights(
    root: Path, maps: int, workers: int, *, kill: bool, port: int | None = None, pictures: Path | None = None
) -> dict[str, float]:
    """Three nights, asserted through Prefect's API; the seconds of each."""
    file = write_fleet(root, maps, work_pool={"name": "towns"}, runs_at_once=2 * workers, poll_s=1.0, retries=2,
                       start_timeout_s=120.0)  # fmt: skip
    broken = f"town{maps - 1:02d}"
    break_log(root / broken)
    names = [f"town{n:02d}" for n in range(maps)]
    seconds = {}
    with running_server(root / "prefect", port) as server:
        server.flexmap("fleet", "deploy", str(file))
        crew = [server.worker(f"worker{n}", "towns", limit=3) for n in range(workers)]

        if kill:
            killer = KillInTheMiddle(server, [worker.pid for worker in crew])
            killer.start()
        table, runs, seconds["first"] = night(server, pictures=pictures)
        if kill:
            killer.join()
            assert killer.killed, "nothing ran on the worker when it was to be killed"
            server.worker("worker-new", "towns", limit=3)
        assert states(table) == {n: "failed" if n == broken else "published" for n in names}
        reason = next(row["reason"] for row in table if row["map"] == broken)
        assert "night1.mcap" in reason, reason
        done = [run for run in runs if run["state_type"] == "COMPLETED"]
        assert len(done) == maps - 1
        failed = [run for run in runs if run["state_name"] == "Failed"]
        assert [run["state"]["message"] for run in failed] == [reason]
        crashed = [run for run in runs if run["state_type"] == "CRASHED"]
        assert bool(crashed) == kill, crashed
        latest = {
            n: (root / "store" / "releases" / n / "latest").resolve().name for n in names if n != broken
        }
        assert {run["name"] for run in done} == {f"{n} {release}" for n, release in latest.items()}

        changed = names[: min(3, maps - 1)]
        for n in changed:
            drive_again(root / n, int(n[-2:]) + 1, night=2)
        table, runs, seconds["second"] = night(server)
        assert sorted(run["name"].split()[0] for run in runs) == changed
        assert states(table) == {
            n: "failed" if n == broken else "published" if n in changed else "unchanged" for n in names
        }
        assert all((root / "store" / "releases" / n / "latest").resolve().name != latest[n] for n in changed)

        table, runs, seconds["third"] = night(server)
        assert runs == []
        assert states(table) == {n: "failed" if n == broken else "unchanged" for n in names}
    return seconds


class KillInTheMiddle:
    """Kills a worker with everything it runs, as soon as it runs a map; not the one that runs the update itself."""

    def __init__(self, server: Server, workers: list[int]) -> None:
        self._server, self._workers, self.killed = server, workers, False
        self._thread = threading.Thread(target=self._run)

    def start(self) -> None:
        """Begin to lie in wait."""
        self._thread.start()

    def join(self) -> None:
        """Wait until it is done."""
        self._thread.join()

    def _run(self) -> None:
        deadline = time.monotonic() + 600
        since = datetime.now(UTC).isoformat()
        while time.monotonic() < deadline and not self.killed:
            update = [pid_of(run) for run in self._server.runs("fleet_update")]
            for run in self._server.map_runs(since):
                worker = self._worker_of(pid_of(run))
                if run["state_type"] == "RUNNING" and worker and worker not in map(self._worker_of, update):
                    kill_tree(worker)
                    self.killed = True
                    return
            time.sleep(0.2)

    def _worker_of(self, pid: int) -> int | None:
        return next((worker for worker in self._workers if pid in descendants(worker)), None)


def pid_of(run: dict[str, Any]) -> int:
    """The process of a run; 0 when it has none."""
    pid = str(run.get("infrastructure_pid") or "").rpartition(":")[2]
    return int(pid) if pid.isdigit() else 0


def descendants(pid: int) -> set[int]:
    """All processes that a process has led to."""
    found = set(children(pid))
    return found.union(*(descendants(child) for child in found))


def main() -> None:
    """The full form; says how long each night took."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--maps", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--port", type=int)
    parser.add_argument("--no-kill", action="store_true")
    parser.add_argument("--pictures", type=Path, help="folder for pictures of the dashboard")
    given = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # end what was started
    with tempfile.TemporaryDirectory(prefix="flexmap-nights-") as root:
        seconds = nights(
            Path(root),
            given.maps,
            given.workers,
            kill=not given.no_kill,
            port=given.port,
            pictures=given.pictures,
        )
    for name, s in seconds.items():
        print(f"{name} night: {s:.0f} s")


if __name__ == "__main__":
    main()
