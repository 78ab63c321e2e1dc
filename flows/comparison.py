"""Releases of one map beside each other, as rows for the terminal, a file and the dashboard."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexmap_tasks.engine.compare import DECISIVE, Figure, best_of, compare_figures
from flexmap_tasks.engine.gate import read_quality
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.table_files import write_table
from flexmap_tasks.store.store import Store
from flows.console import HEADLINES

Facts = Mapping[str, Any]
"""What is known of a release besides its figures, by column."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """One row per release.

    facts : columns in front, such as settings; figures : of quality.json
    best : numbers of the rows that no other beats; by : the figure that says so, empty where none does
    """

    map: str
    facts: tuple[Facts, ...]
    figures: tuple[Figure, ...]
    best: frozenset[int]
    by: str

    def shown(self) -> list[Figure]:
        """What a person looks at first: headline figures that differ."""
        first = (*DECISIVE, *HEADLINES)
        return [f for f in self.figures if f.differs and (f.name in first or f.name == self.by)]

    def rows(self, figures: Sequence[Figure]) -> list[dict[str, Any]]:
        """Plain values; figures carry their unit in the name of the column."""
        return [
            {"best": i in self.best, **facts, **{column(figure): figure.values[i] for figure in figures}}
            for i, facts in enumerate(self.facts)
        ]

    def cells(self) -> list[dict[str, str]]:
        """The same for people: a star where no other row is better."""
        figures = self.shown()
        return [
            {
                "": "best" if i in self.best else "",
                **{name: _text(value) for name, value in facts.items()},
                **{column(f): f"{_text(f.values[i])}{'*' if i in f.best else ''}" for f in figures},
            }
            for i, facts in enumerate(self.facts)
        ]

    def headline(self) -> str:
        """What came out, in one line."""
        rows = len(self.facts)
        if not self.best:
            return f"{self.map}: {rows} releases; no figure says that one is better"
        names = dict.fromkeys(str(self.facts[i]["release"]) for i in sorted(self.best))
        return f"{self.map}: {rows} releases; best by {self.by}: {', '.join(names)}"


def compared(
    store: Store, map_name: str, facts: Sequence[Facts], by: str | None = None, candidates: Sequence[int] = ()
) -> Comparison:
    """The releases that `facts` name; only rows in `candidates` (all when empty) may be called the best."""
    ids = [str(row["release"]) for row in facts]
    figures = compare_figures([read_quality(store, map_name, name) if name else None for name in ids])
    best, by_name = best_of(figures, candidates or range(len(ids)), by)
    return Comparison(map_name, tuple(facts), tuple(figures), best, by_name)


def column(figure: Figure) -> str:
    """A figure's name with its unit."""
    return figure.name if figure.unit in ("1", "count") else f"{figure.name}_{figure.unit}"


def markdown(comparison: Comparison) -> str:
    """A page: what came out, and the table."""
    cells = comparison.cells()
    names = list(cells[0])
    lines = [f"# {comparison.headline()}", "", f"| {' | '.join(names)} |", f"|{'---|' * len(names)}"]
    lines += [
        f"| {' | '.join(value.replace('|', chr(92) + '|') for value in row.values())} |" for row in cells
    ]
    return "\n".join([*lines, "", "`*`: no other row is better in this figure.", ""])


def write_comparison(comparison: Comparison, file: Path) -> None:
    """A file by its suffix: .md for people, .parquet or .csv with every figure for programs."""
    if file.suffix not in (".md", ".parquet", ".csv"):
        raise InputError(str(file), "a table is written as .md, .parquet or .csv")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        if file.suffix == ".md":
            file.write_text(markdown(comparison), encoding="utf-8")
        else:
            write_table(comparison.rows(comparison.figures), file)
    except OSError as error:
        raise InputError(str(file), f"cannot be written ({error.strerror})") from error


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
