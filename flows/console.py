"""What a person sees in the terminal."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table

if TYPE_CHECKING:  # a run that has nothing to do must not load the stages
    from flexmap_tasks.engine.execute import Outcome
    from flexmap_tasks.engine.graph import Node
    from flexmap_tasks.engine.plan import Plan
    from flexmap_tasks.engine.release import Release
    from flows.comparison import Comparison

_console = Console(highlight=False)
HEADLINES = (
    "deviation_before_all_rmse",
    "deviation_after_all_mean",
    "deviation_after_all_rmse",
    "deviation_after_valid_rmse",
    "lane_width_change_max",
    "control_point_residual_rmse",
    "control_point_leave_one_out_max",
    "match_rate",
    "match_rate_by_length",
    "transfers_set",
    "transfers_review",
    "lanes_agree",
    "lanes_differ",
    "findings_error",
    "findings_warning",
)
"""What a person wants to know first."""

FLEET_HEADLINES = ("deviation_after_valid_rmse", "match_rate_by_length", "lanes_differ", "transfers_review")
"""The same where there is one line per map."""

STATE_STYLE = {"cached": "green", "run": "yellow", "depends": "cyan"}


def say(line: str) -> None:
    """One line."""
    _console.print(line, markup=False, soft_wrap=True)


def show(table: Table) -> None:
    """A table of any kind."""
    _console.print(table)


def write(text: str) -> None:
    """Text as it is, for other programs to read."""
    sys.stdout.write(text)


def show_plan(map_name: str, plan: Plan) -> None:
    """One row per stage with its state and the reason."""
    table = Table(title=f"Plan for {map_name}", box=None, title_justify="left")
    for column in ("stage", "state", "why"):
        table.add_column(column, overflow="fold")
    for step in plan.steps:
        style = STATE_STYLE[step.state]
        table.add_row(step.node.name, f"[{style}]{step.state}[/]", step.why.replace("[", r"\["))
    _console.print(table)
    run = sum(1 for s in plan.steps if s.state == "run")
    depends = sum(1 for s in plan.steps if s.state == "depends")
    say(f"{len(plan.steps) - run - depends} cached, {run} will run, {depends} depend on what comes before")


def show_summary(map_name: str, release: Release, seconds: float) -> None:
    """The main figures, everything that has a limit, and where the release lies; the path ends it all."""
    quality: dict[str, Any] = json.loads((release.folder / "quality.json").read_text())
    table = Table(box=None, title_justify="left", title=f"Quality of {map_name} (all figures: quality.json)")
    table.add_column("figure")
    table.add_column("value", justify="right")
    table.add_column("unit")
    table.add_column("limit", justify="right")
    for measure in quality["measures"]:
        if measure["name"] in HEADLINES or measure["limit"] is not None:
            limit = (
                ""
                if measure["limit"] is None
                else f"{measure['limit']:g} {'ok' if measure['passed'] else 'MISSED'}"
            )
            value = "-" if measure["value"] is None else f"{measure['value']:.4g}"
            table.add_row(measure["name"], value, measure["unit"], limit)
    _console.print(table)
    if release.fresh and (release.folder / "control_points.parquet").exists():
        _say_worst_point(release.folder / "control_points.parquet")
    state = "new release" if release.fresh else "release unchanged:"
    say(f"{state} {release.id} of {map_name}, {seconds:.1f} s")
    finished = release.folder / "lanelet2_map.osm"
    say(str(finished if finished.exists() else release.folder))


def show_comparison(comparison: Comparison) -> None:
    """One line per figure and fact, one column per release: that fits a terminal."""
    cells = comparison.cells()
    table = Table(box=None, title=comparison.headline(), title_justify="left")
    table.add_column("", no_wrap=True)
    for i in range(len(cells)):
        table.add_column(str(i + 1), justify="right", overflow="fold")
    for name in cells[0]:
        table.add_row(name, *(row[name].replace("[", r"\[") for row in cells))
    _console.print(table)


def _say_worst_point(file: Path) -> None:
    """The control point that the others contradict most."""
    from flexmap_tasks.formats.table_files import first_row  # noqa: PLC0415 - loads pyarrow

    worst = first_row(file)
    if worst is None or not worst["used"] or math.isnan(worst["leave_one_out_m"]):
        return
    label = "".join(c for c in worst["label"] if c.isprintable())[:60]
    say(
        f"worst control point: {label}, {worst['leave_one_out_m']:.2f} m from where the others put it, "
        f"{worst['residual_m']:.2f} m off in the map (all: {file.name})"
    )


class StageProgress:
    """A bar over stages and, for those that run per item, over items."""

    def __init__(self, stages: int) -> None:
        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=_console,
            transient=True,
        )
        self._stages = self._progress.add_task("stages", total=stages)
        self._items = self._progress.add_task("", total=None, visible=False)

    def __enter__(self) -> StageProgress:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def start(self, node: Node) -> None:
        """A stage begins."""
        self._progress.update(self._stages, description=node.name)

    def item(self, node: Node, done: int, total: int) -> None:
        """Some items of a stage are done."""
        self._progress.update(
            self._items, description=f"  {node.name}", completed=done, total=total, visible=done < total
        )

    def done(self, outcome: Outcome) -> None:
        """A stage ended."""
        self._progress.advance(self._stages)
        state = "cached  " if outcome.cached else "computed"
        items = (
            f"  {outcome.computed} of {outcome.items} items"
            if outcome.items > 1 and not outcome.cached
            else ""
        )
        self._progress.console.print(
            f"{state}  {outcome.name:<22}{outcome.seconds:8.2f} s{items}", markup=False
        )
