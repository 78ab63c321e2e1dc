"""What a run shows on the Prefect dashboard: tables under stable keys, so that their history is a trend."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from prefect.artifacts import acreate_link_artifact, acreate_table_artifact

from flexmap_tasks.engine.execute import Outcome
from flexmap_tasks.engine.release import Release


async def publish_to_dashboard(
    map_name: str, outcomes: Mapping[str, Outcome], release: Release
) -> None:  # fmt: skip
    """The quality table, the stages with what they saved, and a link to the release."""
    key = re.sub(r"[^a-z0-9]+", "-", map_name.lower()).strip("-") or "map"
    quality = json.loads((release.folder / "quality.json").read_text())
    await acreate_table_artifact(
        key=f"{key}-quality",
        table=quality["measures"],
        description=f"Quality of {map_name}, release {release.id}",
    )
    await acreate_table_artifact(
        key=f"{key}-stages", table=stage_rows(outcomes), description=f"Stages of {map_name}"
    )
    await acreate_link_artifact(
        key=f"{key}-release", link=release.folder.resolve().as_uri(), link_text=f"{map_name} {release.id}"
    )


def stage_rows(outcomes: Mapping[str, Outcome]) -> list[dict[str, Any]]:
    """One row per stage: state, seconds, action key."""
    return [
        {
            "stage": o.name,
            "state": "cached" if o.cached else "computed",
            "compute_s": round(0.0 if o.cached else o.seconds, 3),
            "saved_s": round(o.seconds if o.cached else 0.0, 3),
            "items": f"{o.computed}/{o.items}",
            "action": o.key[:12],
        }
        for o in outcomes.values()
    ]
