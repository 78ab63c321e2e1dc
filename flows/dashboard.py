"""What a run shows on the Prefect dashboard, under stable keys, so that the history of each is a trend."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any
from uuid import UUID

from prefect.artifacts import acreate_link_artifact, acreate_markdown_artifact, acreate_table_artifact
from prefect.client.orchestration import get_client
from prefect.runtime import flow_run

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.execute import Outcome
from flexmap_tasks.engine.gate import Verdict
from flexmap_tasks.engine.release import Release
from flows.dashboard_report import decisions, report_markdown


async def publish_to_dashboard(
    config: FlexMapConfig, outcomes: Mapping[str, Outcome], release: Release, verdict: Verdict | None, *, trial: bool
) -> None:  # fmt: skip
    """Tables of quality, stages and decisions, a report, links to what was made; the run is named after it.

    A trial has keys of its own, so that the trend of a map shows only what might have been published.
    """
    name, key = config.map, artifact_key(config.map) + "-trial" * trial
    quality = json.loads((release.folder / "quality.json").read_text())["measures"]
    rows = decisions(release.folder)
    await acreate_table_artifact(
        key=f"{key}-quality", table=quality, description=f"Quality of {name}, release {release.id}"
    )
    await acreate_table_artifact(
        key=f"{key}-stages", table=stage_rows(outcomes), description=f"Stages of {name}: {savings(outcomes)}"
    )
    await acreate_table_artifact(
        key=f"{key}-decisions", table=rows, description=f"What {name} leaves to a person, first {len(rows)}"
    )
    await acreate_markdown_artifact(
        key=f"{key}-report",
        markdown=report_markdown(config, outcomes, release, verdict, quality, rows, trial=trial),
        description=f"{name}, release {release.id}",
    )
    await acreate_link_artifact(
        key=f"{key}-release", link=release.folder.resolve().as_uri(), link_text=f"{name} {release.id}"
    )
    report = release.folder / "report.html"
    if report.is_file():
        await acreate_link_artifact(
            key=f"{key}-report-page",
            link=report.resolve().as_uri(),
            link_text=f"report of {name} {release.id}",
        )
    await name_run(f"{name} {release.id}")


async def name_run(name: str) -> None:
    """Let the run say what it made."""
    run_id = flow_run.get_id()
    if run_id is not None:
        async with get_client() as client:
            await client.update_flow_run(UUID(run_id), name=name)


def artifact_key(name: str) -> str:
    """A name as Prefect wants keys of artifacts: lower case, digits and dashes."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") or "map"


def savings(outcomes: Mapping[str, Outcome]) -> str:
    """Hits and what they saved, in words."""
    cached = [o for o in outcomes.values() if o.cached]
    saved = sum(o.seconds for o in cached)
    return f"{len(cached)} of {len(outcomes)} stages cached, {saved:.1f} s saved"


def stage_rows(outcomes: Mapping[str, Outcome]) -> list[dict[str, Any]]:
    """One row per stage: state, seconds, action key; the sums last."""
    rows: list[dict[str, Any]] = [
        {
            "stage": o.name,
            "state": "cached" if o.cached else "computed",
            "compute_s": round(0.0 if o.cached else o.seconds, 3),
            "saved_s": round(o.seconds if o.cached else 0.0, 3),
            "items": f"{o.computed}/{o.items}",
            "kilobytes": round(sum(b.size for _, b in o.artifact.files) / 1000, 1),
            "action": o.key[:12],
        }
        for o in outcomes.values()
    ]
    hits = sum(o.cached for o in outcomes.values())
    total: dict[str, Any] = {
        "stage": "all",
        "state": f"{hits} of {len(rows)} cached",
        "items": "",
        "action": "",
    }
    for column in ("compute_s", "saved_s", "kilobytes"):
        total[column] = round(sum(row[column] for row in rows), 3)
    return [*rows, total]
