"""All maps of a fleet brought up to date, as a Prefect flow: one run of map_update per map with something to do."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from uuid import UUID

from prefect import flow, get_run_logger
from prefect.artifacts import acreate_markdown_artifact, acreate_table_artifact
from prefect.client.orchestration import get_client
from prefect.client.schemas.objects import State
from prefect.runtime import flow_run
from prefect.states import Completed, Failed

from flexmap_tasks.engine.gate import read_quality
from flexmap_tasks.errors import FlexMapError
from flexmap_tasks.fleet_config import FleetConfig
from flexmap_tasks.store.store import Store
from flows.console import FLEET_HEADLINES
from flows.dashboard import artifact_key, name_run
from flows.fleet_jobs import load_fleet, open_store
from flows.fleet_plan import Row, Todo, plan_fleet
from flows.fleet_pool import end_lost_runs, run_on_pool
from flows.fleet_processes import run_processes

SHOWN = 500
"""Maps on the dashboard's page; it is drawn as a whole."""

GOOD = ("published", "unchanged", "waiting")


@flow(name="fleet_update", persist_result=False, validate_parameters=True)
async def fleet_update(fleet: str) -> State[Any]:
    """Find new recordings, plan every map, run those that have something to do; no map stops another.

    fleet : path of the fleet's YAML file, as the worker sees it
    """
    try:
        config = load_fleet(Path(fleet))
    except FlexMapError as error:
        return Failed(message=str(error), data=error)
    store = open_store(config)
    rows, todo = await asyncio.to_thread(lambda: plan_fleet(store, config))
    log = get_run_logger()
    log.info("%s: %d maps, %d have something to do", config.name, len(rows) + len(todo), len(todo))
    for item in todo:
        log.info("%s: %s", item.job.map, item.why)
    rows += await _run(config, todo)
    rows.sort(key=lambda row: row.map)
    await _show(config, store, rows)
    bad = [row for row in rows if row.state not in GOOD]
    message = summary(rows)
    return Completed(
        name="Attention" if bad else "Completed", message=message, data=[r.to_json() for r in rows]
    )


async def _run(config: FleetConfig, todo: Sequence[Todo]) -> list[Row]:
    log = get_run_logger()

    def done(row: Row) -> None:
        level = log.info if row.state in GOOD else log.warning
        level("%s: %s %s %s", row.map, row.state, row.release, row.reason)

    if config.work_pool is not None:
        run_id = flow_run.get_id()
        lost = await end_lost_runs(config, UUID(run_id) if run_id else None)
        if lost:
            log.warning("%d runs of earlier updates had lost their worker", lost)
        return await run_on_pool(config, todo, str(flow_run.get_id()), done)
    async with get_client() as client:
        return await run_processes(config, todo, done, api_url=str(client.api_url))


async def _show(config: FleetConfig, store: Store, rows: Sequence[Row]) -> None:
    """The summary as a table and a page, what needs a person first, what did nothing last."""
    key = artifact_key(config.name)
    ordered = sorted(rows, key=lambda row: (row.state in GOOD, row.state == "unchanged", row.map))[:SHOWN]
    told = f"{config.name}: {summary(rows)}"
    await acreate_table_artifact(
        key=f"{key}-fleet", table=[row.to_json() for row in ordered], description=told
    )
    figures = {row.map: _figures(store, row) for row in ordered}
    await acreate_markdown_artifact(
        key=f"{key}-fleet-report", markdown=page(config.name, rows, ordered, figures)
    )
    await name_run(told)


def _figures(store: Store, row: Row) -> list[str]:
    """Headline figures of the release that a row names."""
    quality = (read_quality(store, row.map, row.release) if row.release else None) or {}
    values = [quality.get(name, {}).get("value") for name in FLEET_HEADLINES]
    return ["" if value is None else f"{value:.3g}" for value in values]


def summary(rows: Sequence[Row]) -> str:
    """How many maps ended in which state, in words."""
    counts = Counter(row.state for row in rows)
    return ", ".join(f"{n} {state}" for state, n in sorted(counts.items())) or "no maps"


def page(name: str, rows: Sequence[Row], shown: Sequence[Row], figures: Mapping[str, Sequence[str]]) -> str:
    """The summary as Markdown: a link to the run of each map, why it is what it is, and its headline figures."""
    computed, saved = sum(r.seconds for r in rows), sum(r.saved_s for r in rows)
    columns = ("map", "state", "why", *(h.replace("_", " ") for h in FLEET_HEADLINES), "release", "recording")
    lines = [
        f"# {name}: {summary(rows)}",
        "",
        f"{computed:.1f} s computed, {saved:.1f} s saved.",
        "",
        f"| {' | '.join(columns)} |",
        f"|{'---|' * len(columns)}",
        *(f"| {' | '.join(_cells(row, figures[row.map]))} |" for row in shown),
    ]
    if len(rows) > len(shown):
        lines += ["", f"{len(rows) - len(shown)} more are not shown; `flexmap fleet status` has all."]
    return "\n".join(lines) + "\n"


def _cells(row: Row, figures: Sequence[str]) -> list[str]:
    label = f"[{row.map}](/runs/flow-run/{row.run})" if row.run else row.map
    cells = [label, row.state, row.reason, *figures, row.release, row.recording]
    return [cell.replace("|", "\\|") for cell in cells]
