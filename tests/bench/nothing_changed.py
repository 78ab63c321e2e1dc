"""How long a run takes that has nothing to do, beside DVC, Snakemake and redun.

    python -m tests.bench.nothing_changed [FOLDER WITH THE PEERS' COMMANDS]

The peers copy 100 MB through a chain of eight steps. FlexMap updates the Garching map (17 stages or more) with a point
cloud of 100 MB. Each runs once to have everything made, then three times with nothing changed; the best counts, wall
clock, as processes. A peer that is not installed is named and left out.
"""

from __future__ import annotations

import os
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

PROJECT = Path(__file__).resolve().parents[2]
STEPS = 8
BYTES = 100_000_000
REPEAT = 3

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


def main(peers: Path | None = None) -> None:
    """Print one line per tool."""
    with tempfile.TemporaryDirectory(prefix="flexmap-bench-") as name:
        folder = Path(name)
        flexmap(folder / "flexmap")
        for tool, prepare in (("dvc", dvc), ("snakemake", snakemake), ("redun", redun)):
            command = shutil.which(tool, path=str(peers) if peers else None)
            if command is None:
                print(f"{tool}: not installed, left out")
                continue
            place = folder / tool
            place.mkdir()
            (place / "part0.bin").write_bytes(os.urandom(BYTES // STEPS))
            measure(tool, place, prepare(place, command))


def flexmap(folder: Path) -> None:
    """As a process and inside of one."""
    folder.mkdir()
    write_cloud(folder / "cloud.pcd")
    config = PROJECT / "configs" / "garching.yaml"
    overrides = ["--set", f"point_cloud.file={folder / 'cloud.pcd'}"]
    command = [
        sys.executable,
        "-m",
        "flows.cli",
        "run",
        str(config),
        "--store",
        str(folder / "store"),
        "--no-prefect",
    ]
    command += overrides
    time.sleep(2.5)  # what is younger than two seconds is not trusted by its time stamps
    measure("flexmap", PROJECT, command)

    def inside() -> None:
        settings = load_config(FlexMapConfig, config, overrides[1:])
        store = Store.open(folder / "store")
        assert still_finished(store, settings, store.releases) is not None

    print(f"{'flexmap, inside a process':<28}{best(inside):8.3f} s")


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
    run([command, "init", "--no-scm", "-q"], folder)
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


def measure(name: str, folder: Path, command: list[str]) -> None:
    """The first run, then the best of those with nothing to do."""
    before = time.perf_counter()
    run(command, folder)
    first = time.perf_counter() - before
    run(command, folder)
    print(f"{name:<28}{best(lambda: run(command, folder)):8.3f} s   (first run {first:.1f} s)", flush=True)


def best(work: Callable[[], None]) -> float:
    """Seconds of the fastest of several."""
    figures = []
    for _ in range(REPEAT):
        before = time.perf_counter()
        work()
        figures.append(time.perf_counter() - before)
    return min(figures)


def run(command: list[str], folder: Path) -> None:
    """To its end, without its output."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}: {(done.stderr or done.stdout)[-2000:]}")


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:]))
