"""What the engine and a fleet's planner cost by themselves: per stage, and for thousands of maps."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexmap_tasks.config import Params
from flexmap_tasks.engine.graph import Graph, Ref, SourceRef
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.engine.stage import AnyStage, Stage
from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.source import Source
from flexmap_tasks.store.store import Store
from tests.bench.measure import show

STAGES = 100
SIZES = (500, 2_000, 8_000)
NEW = 3


class Step(Params):
    """Which stage of the chain this is."""

    number: int


@dataclass(frozen=True, slots=True, eq=False)
class Numbers:
    """A few numbers."""

    value: Floats


def run() -> None:
    """Show both."""
    show(f"The engine's own cost per stage, of {STAGES} stages that do nothing", stage_rows())
    show(f"Planning a fleet in which {NEW} maps have something to do", planner_rows())


def stage_rows() -> list[tuple[str, str, str]]:
    """Into an empty folder, and again with every result there; the clock on the wall waits for the disk's syncing."""
    with tempfile.TemporaryDirectory(prefix="flexmap-bench-") as name:
        file = Path(name, "numbers.txt")
        file.write_text("1\n2\n3\n")
        first = min(_run_ms(Store.open(Path(name, f"store{i}")), file) for i in range(3))
        again = min(_run_ms(Store.open(Path(name, "store0")), file) for _ in range(3))
    return [
        (what, f"{cpu:.2f} ms CPU, {wall:.2f} ms wall clock", "at most 5 ms")
        for what, (cpu, wall) in (("computed and stored", first), ("found in the store", again))
    ]


def _run_ms(store: Store, file: Path) -> tuple[float, float]:
    graph = chain(file)
    cpu, wall = time.process_time(), time.perf_counter()
    run_local(store, graph)
    per_stage = 1e3 / len(graph.nodes)
    return (time.process_time() - cpu) * per_stage, (time.perf_counter() - wall) * per_stage


def chain(file: Path) -> Graph:
    """Stages one after the other, each of which hands on what it gets."""

    def read(source: Source) -> Numbers:
        return Numbers(np.loadtxt(source.path, ndmin=1))

    graph = Graph()
    last: Ref = graph.run(Stage(read, "numbers"), source=SourceRef(file))
    for i in range(STAGES):
        last = graph.run(_step(i), Step(number=i), numbers=last)
    return graph


def _step(number: int) -> AnyStage:
    def step(numbers: Numbers, params: Step) -> Numbers:
        return Numbers(numbers.value + params.number)

    step.__name__ = f"step{number}"
    return Stage(step, "numbers")


def planner_rows() -> list[tuple[str, str, str]]:
    """Cost over sizes, and what the growth means for 100,000 maps."""
    from tests.fleet.fleet_planner import planned  # noqa: PLC0415 - loads every stage

    found = list(planned(SIZES, NEW))
    rows = [
        (f"{p.maps} maps", f"{p.read_s:.2f} s to read + {p.plan_s:.2f} s to plan (CPU)", "") for p in found
    ]
    costs = [p.read_s + p.plan_s for p in found]
    growth = np.polyfit(np.log(SIZES[1:]), np.log(costs[1:]), 1)[0]
    rows.append(("grows with the number of maps to the power of", f"{growth:.2f}", "at most 1.1"))
    rate = (costs[-1] - costs[0]) / (SIZES[-1] - SIZES[0])
    rows.append(("100,000 maps at that rate", f"{costs[0] + rate * 1e5:.0f} s CPU", "at most 60 s"))
    return rows
