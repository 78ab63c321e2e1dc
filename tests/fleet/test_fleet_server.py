"""A small fleet on a real Prefect server with a real worker: what the dashboard shows, and what happens by itself."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import yaml
from fleet_nights import night, states
from fleet_server import Server, running_server
from fleet_town import break_log, drive_again, write_fleet

pytestmark = pytest.mark.server

NEVER = {"limits": [{"measure": "poses", "min": 1e9}]}


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four towns: two good ones, one that the gate holds, one with a broken log."""
    root = tmp_path_factory.mktemp("fleet")
    write_fleet(
        root, 4, work_pool={"name": "towns"}, runs_at_once=2, poll_s=0.5, schedule={"cron": "0 2 * * *"}
    )
    held = root / "town02" / "map.yaml"
    held.write_text(yaml.safe_dump({**yaml.safe_load(held.read_text()), "gate": NEVER}))
    break_log(root / "town03")
    return root


@pytest.fixture(scope="module")
def server(root: Path) -> Iterator[Server]:
    with running_server(root / "prefect") as server:
        server.flexmap("fleet", "deploy", str(root / "fleet.yaml"))
        server.worker("worker", "towns", limit=3)
        yield server


@pytest.fixture(scope="module")
def first(server: Server) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    table, runs, _ = night(server, 400)
    return table, runs


def test_every_map_has_its_run_and_none_stops_another(first: Any, root: Path) -> None:
    table, runs = first
    rows = {row["map"]: row for row in table}
    assert states(table) == {
        "town00": "published",
        "town01": "published",
        "town02": "held",
        "town03": "failed",
    }
    by_state = {run["state_name"]: run for run in runs}
    assert by_state["Failed"]["state"]["message"] == rows["town03"]["reason"]
    assert "night1.mcap" in rows["town03"]["reason"]
    assert "poses" in by_state["Held"]["state"]["message"]
    names = {run["name"] for run in runs if run["state_name"] in ("Completed", "Held")}
    assert names == {f"{m} {rows[m]['release']}" for m in ("town00", "town01", "town02")}
    releases = root / "store" / "releases"
    assert (releases / "town00" / "latest").resolve().name == rows["town00"]["release"]
    assert (releases / "town02" / rows["town02"]["release"] / "lanelet2_map.osm").is_file()
    assert not (releases / "town02" / "latest").exists()


def test_the_dashboard_shows_quality_stages_decisions_and_the_report(first: Any, server: Server) -> None:
    release = next(row["release"] for row in first[0] if row["map"] == "town00")
    quality = json.loads(server.artifact("town00-quality")["data"])
    assert any(m["name"] == "match_rate_by_length" for m in quality)
    stages = json.loads(server.artifact("town00-stages")["data"])
    assert stages[-1]["stage"] == "all"
    assert sum(row["compute_s"] for row in stages[:-1]) > 0
    assert isinstance(json.loads(server.artifact("town00-decisions")["data"]), list)
    assert f"{release} is published" in server.artifact("town00-report")["data"]
    assert release in server.artifact("town00-release")["data"]


def test_parameters_are_a_form_filled_in(first: Any, server: Server) -> None:
    deployment = server.get("/deployments/name/map_update/town00")
    schema = deployment["parameter_openapi_schema"]
    assert "umeyama" in schema["definitions"]["AlignmentParams"]["properties"]
    assert deployment["parameters"]["config"]["alignment"]["method"] == "rigid"
    schedules = server.get("/deployments/name/fleet_update/towns")["schedules"]
    assert schedules[0]["schedule"]["cron"] == "0 2 * * *"


def test_trials_are_started_from_the_dashboard_and_compared_there(first: Any, server: Server) -> None:
    deployment = server.get("/deployments/name/map_trials/town00")
    asked = {**deployment["parameters"], "grid": {"conflation.match.method": ["path", "buffer_growing"]}}
    run = server.ask(
        f"/deployments/{deployment['id']}/create_flow_run", state={"type": "SCHEDULED"}, parameters=asked
    )
    ended = server.wait(run["id"], 200)
    assert ended["state_type"] == "COMPLETED", ended["state"]["message"]
    rows = json.loads(server.artifact("town00-trials")["data"])
    assert [row["conflation.match.method"] for row in rows] == ["path", "buffer_growing"]
    published = next(row["release"] for row in first[0] if row["map"] == "town00")
    assert [row["gate"] for row in rows] == ["is published", "would publish"]
    assert rows[0]["release"] == published
    assert rows[0]["stages_run"] == "0"
    assert published in server.artifact("town00-report")["data"], "the trend of the map is not touched"


def test_the_schedule_makes_runs(first: Any, server: Server) -> None:
    deadline, found = time.monotonic() + 120, []
    while not found and time.monotonic() < deadline:
        time.sleep(1)
        state = {"type": {"any_": ["SCHEDULED"]}}
        found = [
            r for r in server.ask("/flow_runs/filter", flow_runs={"state": state}) if r["auto_scheduled"]
        ]
    assert {run["expected_start_time"][11:16] for run in found} == {"02:00"}


def test_a_held_map_is_noted_and_new_recordings_start_an_update(
    first: Any, server: Server, root: Path
) -> None:
    since = datetime.now(UTC).isoformat()
    drive_again(root / "town01", 2, night=2)
    server.flexmap("fleet", "notify", str(root / "fleet.yaml"), "town01")
    run = _update_after(server, since, 60)
    assert server.wait(run["id"], 300)["state_type"] == "COMPLETED"
    table = json.loads(server.artifact("towns-fleet")["data"])
    assert states(table) == {
        "town00": "unchanged",
        "town01": "published",
        "town02": "held",
        "town03": "failed",
    }
    assert [r["name"].split()[0] for r in server.map_runs(since)] == ["town01"]
    triggered = server.ask("/events/filter", filter={"event": {"name": ["prefect.automation.triggered"]}})[
        "events"
    ]
    names = {event["resource"].get("prefect.resource.name") for event in triggered}
    assert names == {"towns: recordings arrived", "towns: held or failed"}


def _update_after(server: Server, since: str, timeout_s: float) -> dict[str, Any]:
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        runs = server.ask(
            "/flow_runs/filter", flows={"name": {"any_": ["fleet_update"]}}, sort="START_TIME_DESC"
        )
        new = [r for r in runs if r["created"] > since and not r["auto_scheduled"]]
        if new:
            return dict(new[0])
        time.sleep(1)
    raise AssertionError("no update was started by the event")
