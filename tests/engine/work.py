"""Runs of the toy DAG in processes of their own, cheap to start: forked from a server that has it loaded."""

from __future__ import annotations

import multiprocessing
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import toy

from flexmap_tasks.engine.fingerprint import learn_code
from flexmap_tasks.engine.gc import collect
from flexmap_tasks.engine.local import heal, run_local
from flexmap_tasks.engine.release import Release, publish_release
from flexmap_tasks.engine.runs import sources_of, write_last_run
from flexmap_tasks.store import backend
from flexmap_tasks.store.store import Store

# The server does not look at sys.path, only at the environment.
os.environ["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
PROCESSES: Any = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["work"])


def _no_sync(_descriptor: int) -> None:
    """A killed process loses nothing that it handed to the system; only a machine that loses power does."""


os.fsync = _no_sync
learn_code(None)  # parsing the package takes a second: once here, not once per process


def run_toy(store: Store, numbers: Path, factor: float = 2.0) -> Release:
    """What `flexmap run` does, with the toy DAG."""

    def work() -> Release:
        graph = toy.toy_graph(numbers, factor)
        outcomes = run_local(store, graph)
        actions = {n: o.key for n, o in outcomes.items()}
        artifacts = {n: o.artifact for n, o in outcomes.items()}
        release = publish_release(store, graph, artifacts, actions, store.releases, "toy")
        write_last_run(store, "toy", actions, release.id, sources_of(store, graph))
        return release

    return heal(work)


def run_once(url: str, releases: str, numbers: str, factor: float) -> None:
    """For a process of its own."""
    run_toy(Store.open(url, Path(releases)), Path(numbers), factor)


def run_many(
    url: str, releases: str, numbers: str, factors: list[float], environment: dict[str, str]
) -> None:
    """Several runs, one after the other; what is reused counts as new at once."""
    os.environ.update(environment)
    backend.RENEW_AFTER_S = 0.05
    store = Store.open(url, Path(releases))
    for factor in factors:
        run_toy(store, Path(numbers), factor)


def collect_until(url: str, releases: str, stop: Any, grace_s: float, environment: dict[str, str]) -> None:
    """`gc` again and again."""
    os.environ.update(environment)
    store = Store.open(url, Path(releases))
    while not stop.wait(0.05):
        collect(store, keep_runs=1, keep_days=0, grace_s=grace_s)


def join_all(processes: list[Any], timeout_s: float = 240) -> None:
    """All of them end by themselves, without an error."""
    deadline = time.monotonic() + timeout_s
    for process in processes:
        process.join(max(0.0, deadline - time.monotonic()))
        assert process.exitcode == 0


def _warm_up() -> None:
    """What is loaded on first use is loaded in the server, so that a kill meets a run and not its imports."""
    with tempfile.TemporaryDirectory() as folder:
        numbers = Path(folder) / "numbers.txt"
        numbers.write_text("1\n2\n")
        run_toy(Store.open(Path(folder) / "store"), numbers)


def files_of(folder: Path) -> dict[str, bytes]:
    return {
        p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }


_warm_up()
