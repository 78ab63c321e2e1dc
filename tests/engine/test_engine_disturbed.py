"""Runs that are killed, and runs at the same time: the store never holds anything that is not a result."""

from __future__ import annotations

import random
import shutil
import time
from pathlib import Path

import pytest
from work import PROCESSES, collect_until, files_of, join_all, run_many, run_once, run_toy

from flexmap_tasks.engine.released import all_released
from flexmap_tasks.engine.verify import verify
from flexmap_tasks.store.store import Store

KILLS = 102
KILLS_IN_A_ROW = 3


@pytest.fixture
def numbers(tmp_path: Path) -> Path:
    file = tmp_path / "numbers.txt"
    file.write_text("1\n2\n3\n4\n")
    return file


def kill_runs(
    folder: Path, numbers: Path, expected: dict[str, bytes], kills: int, seed: int, longest_s: float
) -> int:
    """Kill runs at random times on a store that fills up; the run after them must end as if nothing had happened.

    Returns how many were killed before they were done.
    """
    rng = random.Random(seed)
    early = 0
    for _ in range(kills // KILLS_IN_A_ROW):
        shutil.rmtree(folder, ignore_errors=True)
        for _ in range(KILLS_IN_A_ROW):
            process = PROCESSES.Process(
                target=run_once, args=(str(folder), str(folder / "r"), str(numbers), 2.0)
            )
            process.start()
            time.sleep(rng.random() * longest_s)
            process.kill()
            process.join()
            early += process.exitcode != 0
        store = Store.open(folder, folder / "r")
        release = run_toy(store, numbers)
        assert files_of(release.folder) == expected
        assert verify(store).damages == ()
    return early


def time_of_a_run(folder: Path, numbers: Path) -> float:
    process = PROCESSES.Process(target=run_once, args=(str(folder), str(folder / "r"), str(numbers), 2.0))
    clock = time.monotonic()
    process.start()
    join_all([process])
    return time.monotonic() - clock


def test_a_run_after_kills_ends_with_the_undisturbed_bytes(tmp_path, numbers):
    calm = run_toy(Store.open(tmp_path / "calm"), numbers)
    longest_s = min(time_of_a_run(tmp_path / f"timed{i}", numbers) for i in range(3))
    early = kill_runs(tmp_path / "killed", numbers, files_of(calm.folder), KILLS, 1, longest_s)
    assert early > KILLS // 8  # else this proved little


def together(
    url: str, releases: Path, numbers: Path, processes: int, rounds: int, grace_s: float, environment=None
):
    """Processes with overlapping work, and gc all the while."""
    stop = PROCESSES.Event()
    shared = (url, str(releases), str(numbers))
    environment = environment or {}
    sweeper = PROCESSES.Process(target=collect_until, args=(url, str(releases), stop, grace_s, environment))
    workers = [
        PROCESSES.Process(
            target=run_many, args=(*shared, random.Random(i).choices([1.0, 2.0, 3.0], k=rounds), environment)
        )
        for i in range(processes)
    ]
    for process in (sweeper, *workers):
        process.start()
    try:
        join_all(workers)
    finally:
        stop.set()
    join_all([sweeper])


def check_results(store: Store, calm: Store) -> None:
    expected = {release.id: files_of(release.folder) for release in all_released(calm)}
    assert {release.id: files_of(release.folder) for release in all_released(store)} == expected
    assert verify(store).damages == ()


def test_eight_processes_and_gc_on_one_folder(tmp_path, numbers):
    calm = Store.open(tmp_path / "calm")
    for factor in (1.0, 2.0, 3.0):
        run_toy(calm, numbers, factor)
    store = Store.open(tmp_path / "store")
    together(str(tmp_path / "store"), store.releases, numbers, processes=8, rounds=4, grace_s=10.0)
    check_results(store, calm)
