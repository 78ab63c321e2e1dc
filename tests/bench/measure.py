"""How the benchmarks measure and show: CPU seconds of this process, the best of three after a warm-up."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

PROJECT = Path(__file__).resolve().parents[2]
DATA = PROJECT.parent / "shared" / "data"
"""Real inputs, beside the project."""

console = Console(highlight=False)


def best_cpu_s(work: Callable[[], Any], repeat: int = 3) -> float:
    """CPU seconds of the fastest of `repeat` runs after a warm-up."""
    work()
    figures = []
    for _ in range(repeat):
        before = time.process_time()
        work()
        figures.append(time.process_time() - before)
    return min(figures)


def show(title: str, rows: list[tuple[str, str, str]]) -> None:
    """A table of (what, figure, goal)."""
    table = Table("what", "figure", "goal", title=title, box=None, title_justify="left")
    for row in rows:
        table.add_row(*row)
    console.print(table)
    console.print()
