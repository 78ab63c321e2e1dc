"""How long a run takes that has nothing to do, beside DVC, Snakemake and redun.

The peers copy 100 MB through a chain of eight steps. FlexMap updates the Garching map (17 stages or more) with a point
cloud of 100 MB. Each runs once to have everything made, then several times with nothing changed; the best counts, as
processes. The peers live in an environment of their own (`make .venv-peers`, or the folder that
FLEXMAP_BENCH_PEERS names), so that what they need does not meet what FlexMap needs.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.finished import still_finished
from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.store.store import Store
from tests.bench.measure import PROJECT, show

STEPS = 8
BYTES = 100_000_000
REPEAT = 5
PEERS = Path(os.environ.get("FLEXMAP_BENCH_PEERS", PROJECT / ".venv-peers")) / "bin"

REDUN = """
from pathlib import Path
from redun import File, task
redun_namespace = "bench"
@task()
def step(source: File, number: int) -> File:
    target = File(f"part{number}.bin")
    target.write(source.read("rb"), "wb")
    return target
@task()
def main() -> File:
    part = File("part0.bin")
    for number in range(1, %d):
        part = step(part, number)
    return part
"""


def run() -> None:
    """One row per tool, FlexMap first."""
    with tempfile.TemporaryDirectory(prefix="flexmap-bench-") as name:
        folder = Path(name)
        rows = flexmap(folder / "flexmap")
        for tool, prepare in (("dvc", dvc), ("snakemake", snakemake), ("redun", redun)):
            command = shutil.which(tool, path=str(PEERS))
            if command is None:
                rows.append((tool, "not installed: make .venv-peers", ""))
                continue
            place = folder / tool
            place.mkdir()
            (place / "part0.bin").write_bytes(os.urandom(BYTES // STEPS))
            rows.append((tool, measure(place, prepare(place, command)), ""))
    show("Nothing changed: eight stages and 100 MB", rows)


def flexmap(folder: Path) -> list[tuple[str, str, str]]:
    """As a process and inside of one."""
    folder.mkdir()
    write_cloud(folder / "cloud.pcd")
    config, store = PROJECT / "configs" / "garching.yaml", folder / "store"
    overrides = [f"point_cloud.file={folder / 'cloud.pcd'}"]
    command = [sys.executable, "-m", "flows.cli", "run", str(config), "--store", str(store), "--no-prefect"]
    time.sleep(2.5)  # what is younger than two seconds is not trusted by its time stamps
    process = measure(PROJECT, [*command, "--set", *overrides])

    def inside() -> None:
        settings = load_config(FlexMapConfig, config, overrides)
        opened = Store.open(store)
        assert still_finished(opened, settings, opened.releases) is not None

    wall, cpu = best(inside)
    return [
        ("flexmap run, as a process", process, "at most 0.5 s"),
        (
            "the same inside of a process",
            f"{wall * 1e3:.0f} ms, {cpu * 1e3:.0f} ms CPU",
            "at most 50 ms",
        ),
    ]


def write_cloud(path: Path) -> None:
    """Points over 400 by 400 metres, x y z intensity as float32."""
    count = BYTES // 16
    points = np.random.default_rng(1).random((count, 4), dtype=np.float32) * np.float32([400, 400, 10, 1])
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
        f"WIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA binary\n"
    )
    path.write_bytes(header.encode() + points.tobytes())


def dvc(folder: Path, command: str) -> list[str]:
    """A pipeline of copies."""
    call([command, "init", "--no-scm", "-q"], folder)
    stages = "".join(
        f"  s{i}:\n    cmd: cp part{i - 1}.bin part{i}.bin\n    deps: [part{i - 1}.bin]\n    outs: [part{i}.bin]\n"
        for i in range(1, STEPS + 1)
    )
    (folder / "dvc.yaml").write_text(f"stages:\n{stages}")
    return [command, "repro", "-q"]


def snakemake(folder: Path, command: str) -> list[str]:
    """Rules of copies."""
    rules = "".join(
        f'rule s{i}:\n    input: "part{i - 1}.bin"\n    output: "part{i}.bin"\n    shell: "cp {{input}} {{output}}"\n'
        for i in range(1, STEPS + 1)
    )
    (folder / "Snakefile").write_text(f'rule all:\n    input: "part{STEPS}.bin"\n{rules}')
    return [command, "--cores", "1", "--quiet"]


def redun(folder: Path, command: str) -> list[str]:
    """Tasks of copies."""
    (folder / "workflow.py").write_text(REDUN % (STEPS + 1))
    return [command, "run", "workflow.py", "main"]


def measure(folder: Path, command: list[str]) -> str:
    """The first run, then the best of those with nothing to do."""
    first, _ = cost(lambda: call(command, folder))
    call(command, folder)
    wall, cpu = best(lambda: call(command, folder))
    return f"{wall:.2f} s, {cpu:.2f} s CPU (first run {first:.1f} s)"


def best(work: Callable[[], None]) -> tuple[float, float]:
    """Seconds on the wall and of CPU, each of the fastest of several."""
    walls, cpus = zip(*(cost(work) for _ in range(REPEAT)), strict=True)
    return min(walls), min(cpus)


def cost(work: Callable[[], None]) -> tuple[float, float]:
    """Seconds on the wall and of CPU, that of ended children included."""
    wall, cpu = time.perf_counter(), _cpu_s()
    work()
    return time.perf_counter() - wall, _cpu_s() - cpu


def _cpu_s() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def call(command: list[str], folder: Path) -> None:
    """To its end, without its output."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}: {(done.stderr or done.stdout)[-2000:]}")
