"""The flow on a real Prefect server: states and artifacts as its API shows them."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

PROJECT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """A Prefect server on loopback that ends with the test, and the environment that points to it."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    api = f"http://127.0.0.1:{port}/api"
    env = {
        **os.environ,
        "PREFECT_HOME": str(tmp_path_factory.mktemp("prefect")),
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "DO_NOT_TRACK": "1",
        "PREFECT_SERVER_UI_API_URL": api,
    }
    command = [sys.executable, "-m", "prefect", "server", "start", "--host", "127.0.0.1", "--port", str(port)]
    server = subprocess.Popen(command, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        _wait_for(api, server)
        yield {**env, "PREFECT_API_URL": api}
    finally:
        server.terminate()
        try:
            server.wait(timeout=20)
        except subprocess.TimeoutExpired:
            server.kill()


def _wait_for(api: str, server: subprocess.Popen[bytes]) -> None:
    for _ in range(240):
        assert server.poll() is None, "the Prefect server ended"
        try:
            if httpx.get(f"{api}/health", timeout=2).is_success:
                return
        except httpx.HTTPError:
            pass
        time.sleep(0.5)
    pytest.fail("the Prefect server did not come up within two minutes")


def flexmap(env: dict[str, str], store: Path, *more: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "flows.cli", *more, "--store", str(store)]
    return subprocess.run(command, env=env, cwd=PROJECT, capture_output=True, text=True, check=False)


def post(env: dict[str, str], path: str, body: dict[str, Any]) -> list[dict[str, Any]]:
    answer = httpx.post(f"{env['PREFECT_API_URL']}{path}", json=body, timeout=30)
    answer.raise_for_status()
    return answer.json()


def flow_runs(env: dict[str, str]) -> list[dict[str, Any]]:
    return post(env, "/flow_runs/filter", {"sort": "START_TIME_DESC"})


def task_states(env: dict[str, str], flow_run_id: str) -> dict[str, str]:
    runs = post(env, "/task_runs/filter", {"flow_runs": {"id": {"any_": [flow_run_id]}}, "limit": 200})
    return {run["name"]: run["state_name"] for run in runs}


@pytest.mark.server
def test_the_demo_through_a_real_server(environment: dict[str, str], tmp_path: Path) -> None:
    first = flexmap(environment, tmp_path, "demo")
    assert first.returncode == 0, first.stderr
    assert Path(first.stdout.strip().splitlines()[-1]).name == "lanelet2_map.osm"
    (run,) = flow_runs(environment)
    release = Path(first.stdout.strip().splitlines()[-1]).parent.name
    assert (run["name"], run["state_type"]) == (f"demo {release}", "COMPLETED")
    states = task_states(environment, run["id"])
    assert states["demo: pose graph"] == "Completed"
    assert states["demo: match"] == "Completed"

    keys = {a["key"] for a in post(environment, "/artifacts/filter", {})}
    assert {"demo-quality", "demo-stages", "demo-release"} <= keys

    again = flexmap(environment, tmp_path, "demo")
    assert "no flow was started" in again.stdout
    assert len(flow_runs(environment)) == 1

    bent = rerun_with(environment, tmp_path, tmp_path / "demo" / "control_points.csv")
    assert bent["demo: rubber sheet"] == "Completed"
    other = moved_point(tmp_path / "demo" / "control_points.csv", tmp_path / "moved.csv")
    states = rerun_with(environment, tmp_path, other)
    above = ["ingest gnss", "ingest slam", "ingest lanelet map", "ingest osm roads", "ingest point cloud", "project utm",
             "umeyama", "place roads"]  # fmt: skip
    assert {states[f"demo: {name}"] for name in above} == {"Cached"}
    assert states["demo: control points"] == "Completed"
    assert states["demo: georeference"] == "Completed"


def rerun_with(env: dict[str, str], store: Path, points: Path) -> dict[str, str]:
    """The demo by the paper's method with these control points; states of its stages."""
    sets = [f"{key}={store / 'demo' / name}" for key, name in DEMO_INPUTS.items()]
    sets += [f"alignment.control_points_file={points}", "alignment.method=rubber_sheet"]
    config = str(PROJECT / "configs" / "demo.yaml")
    done = flexmap(env, store, "run", config, *[p for s in sets for p in ("--set", s)])
    assert done.returncode == 0, done.stderr
    return task_states(env, flow_runs(env)[0]["id"])


def moved_point(points: Path, out: Path) -> Path:
    """The same list with its first target some centimetres further north."""
    lines = points.read_text().splitlines()
    first = lines[1].split(",")
    column = lines[0].split(",").index("target_lat_deg")
    first[column] = f"{float(first[column]) + 2e-6:.9f}"
    out.write_text("\n".join([lines[0], ",".join(first), *lines[2:]]) + "\n")
    return out


DEMO_INPUTS = {
    "gnss.file": "recording.mcap",
    "slam.file": "recording.mcap",
    "lanelet_map.file": "lanelet2_map.osm",
    "point_cloud.file": "pointcloud_map.pcd",
    "osm.file": "osm_extract.osm",
    "conflation.review_file": "review_decisions.csv",
}


@pytest.mark.server
def test_a_bad_input_fails_its_stage_with_one_line(environment: dict[str, str], tmp_path: Path) -> None:
    bad = tmp_path / "bad.csv"
    bad.write_text("colour,weight\nred,3\n")
    flexmap(environment, tmp_path, "demo", "--no-prefect")
    sets = [f"{key}={tmp_path / 'demo' / name}" for key, name in DEMO_INPUTS.items()]
    sets += [f"alignment.control_points_file={bad}", "map=bad"]
    done = flexmap(
        environment,
        tmp_path,
        "run",
        str(PROJECT / "configs" / "demo.yaml"),
        *[p for s in sets for p in ("--set", s)],
    )
    assert done.returncode == 2
    assert (
        done.stderr.strip().splitlines()[-1].startswith("flexmap: bad.csv")
        or "flexmap: bad.csv" in done.stderr
    )
    assert "Traceback" not in done.stderr
    assert "NoneType" not in done.stdout + done.stderr
    assert (done.stdout + done.stderr).count("Finished in state Failed") <= 2, "the stage and the flow"
    latest = next(r for r in flow_runs(environment) if r["name"] == "bad")
    assert latest["state_type"] == "FAILED"
    assert "bad.csv" in latest["state"]["message"]
