"""Finding recordings, planning maps, running them as processes: a fleet without Prefect."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import pytest
import yaml
from fleet_town import break_log, drive_again, write_fleet, write_town
from prometheus_client.openmetrics.parser import text_string_to_metric_families
from pydantic import ValidationError

from flexmap_tasks.engine.finished import watch
from flexmap_tasks.errors import ConfigError, InputError
from flexmap_tasks.fleet_config import FleetConfig, Recordings
from flexmap_tasks.pipeline import map_update
from flows import fleet_commands
from flows.fleet_index import Index, made_with
from flows.fleet_jobs import Job, find_jobs, load_fleet, open_store
from flows.fleet_plan import Row, Todo, plan_fleet
from flows.fleet_recordings import Recording, choose, find_recordings


@pytest.fixture(scope="module")
def fleet_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three towns, the last with a log that ends too early."""
    root = tmp_path_factory.mktemp("fleet")
    file = write_fleet(root, 3)
    break_log(root / "town02")
    settle(root)
    return file


def settle(root: Path) -> None:
    """Let all files be old enough to trust their stamps."""
    old = time.time() - 60
    for path in root.rglob("*"):
        if path.is_file():
            os.utime(path, (old, old))
    time.sleep(2.1)  # nobody can set back the time of last change


def states(rows: list[Row]) -> dict[str, str]:
    return {row.map: row.state for row in rows}


def update(file: Path) -> list[Row]:
    return fleet_commands._update_here(file)


def test_nights_without_prefect(fleet_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = fleet_file.parent
    first = update(fleet_file)
    assert states(first) == {"town00": "published", "town01": "published", "town02": "failed"}
    assert "night1.mcap" in first[2].reason
    assert all(row.seconds > 0 for row in first[:2])

    drive_again(root / "town01", 2, night=2)
    settle(root)
    second = update(fleet_file)
    assert states(second) == {"town00": "unchanged", "town01": "published", "town02": "failed"}
    assert second[1].recording == "night2.mcap"
    assert second[1].saved_s > 0, "map and roads did not change, so their stages were not run again"
    assert second[1].release != first[1].release

    fleet = load_fleet(fleet_file)
    rows, todo = plan_fleet(open_store(fleet), fleet)
    assert todo == []
    assert states(rows) == {"town00": "unchanged", "town01": "unchanged", "town02": "failed"}
    assert "not tried again" in rows[2].reason

    capsys.readouterr()
    fleet_commands.status(fleet_file, as_json=True)
    status = {row["map"]: row for row in json.loads(capsys.readouterr().out)}
    assert status["town01"]["release"] == second[1].release
    assert status["town01"]["match_rate_by_length"] > 0.5
    assert (status["town02"]["release"], status["town02"]["next"]) == (None, "failed")

    text = (root / "store" / "metrics" / "town01.prom").read_text()
    families = {f.name: f for f in text_string_to_metric_families(text)}
    assert {s.labels["state"]: s.value for s in families["flexmap_release"].samples}["published"] == 1
    cached = {s.labels["stage"]: s.value for s in families["flexmap_stage_cached"].samples}
    assert (cached["ingest_lanelet_map"], cached["ingest_gnss"]) == (1, 0)
    assert all(s.value > 0 for s in families["flexmap_stage_output_bytes"].samples)


def test_a_settled_map_is_looked_at_again_when_anything_moved(fleet_file: Path) -> None:
    fleet = load_fleet(fleet_file)
    config = find_jobs(fleet)[0].config
    assert config is not None
    if not watch(map_update(config)).steady:
        pytest.skip("the code was written to while it was loaded: nothing is remembered then")
    store = open_store(fleet)
    index = Index(store, fleet, made_with())
    town, other, broken = fleet.maps
    assert [bool(index.row(entry)) for entry in fleet.maps] == [True, True, True]
    assert Index(store, fleet, "another version").row(town) is None
    (other.config.parent / "recordings" / "night3.mcap").write_bytes(b"")
    assert index.row(other) is None, "a recording came"
    (other.config.parent / "recordings" / "night3.mcap").unlink()
    assert index.row(other) is not None
    assert index.row(other.model_copy(update={"parameters": {"alignment.method": "rigid"}})) is None
    os.utime(broken.recordings.folder / "night1.mcap")  # type: ignore[union-attr]
    assert index.row(broken) is None, "its log was written to"
    latest = store.releases / "town00" / "latest"
    target = latest.readlink()
    latest.unlink()
    assert index.row(town) is None, "nothing is published any more"
    latest.symlink_to(target)
    assert index.row(town) is not None


def test_a_fleet_says_what_is_wrong_with_one_map_and_goes_on(tmp_path: Path) -> None:
    file = write_fleet(tmp_path, 2)
    data = yaml.safe_load(file.read_text())
    data["maps"][0]["parameters"] = {"alignment.method": "magic"}
    data["maps"].append({"name": "nowhere", "config": "town01/map.yaml", "recordings": {"folder": "absent"}})
    data["maps"].append({"name": "empty", "config": "town01/map.yaml",
                         "recordings": {"folder": "town01/recordings", "pattern": "*.bag"}})  # fmt: skip
    file.write_text(yaml.safe_dump(data))
    fleet = load_fleet(file)
    rows, todo = plan_fleet(open_store(fleet), fleet)
    assert states(rows) == {"town00": "failed", "nowhere": "failed", "empty": "waiting"}
    assert "alignment.method" in rows[0].reason
    assert [item.job.map for item in todo] == ["town01"]
    assert "has not run" in todo[0].why


def test_every_drive_can_be_a_map_of_its_own(tmp_path: Path) -> None:
    file = write_fleet(tmp_path, 1)
    drive_again(tmp_path / "town00", 1, night=2)
    data = yaml.safe_load(file.read_text())
    data["maps"][0]["recordings"]["take"] = "all"
    file.write_text(yaml.safe_dump(data))
    jobs = find_jobs(load_fleet(file))
    assert [job.map for job in jobs] == ["town00.night1", "town00.night2"]
    assert [job.config.gnss.file.name for job in jobs if job.config] == ["night1.mcap", "night2.mcap"]


def test_drives_of_a_map_are_fused(tmp_path: Path) -> None:
    write_town(
        tmp_path,
        1,
        alignment={"method": "pose_graph"},
        gnss={"file": "recordings/night1.mcap", "topic": "/fix"},
    )
    for night in ("2", "-3"):
        (tmp_path / "recordings" / f"night{night}.mcap").touch()
    entry = {
        "name": "town",
        "config": "map.yaml",
        "recordings": {"folder": "recordings", "settle_s": 0, "order": "name"},
    }
    entry["recordings"]["take"] = "fuse"

    def job() -> Job:
        (tmp_path / "fleet.yaml").write_text(yaml.safe_dump({"maps": [entry]}))
        (found,) = find_jobs(load_fleet(tmp_path / "fleet.yaml"), time.time() + 1)
        return found

    config = job().config
    assert config is not None
    assert config.gnss.file.name == "night1.mcap"
    assert [(d.name, d.gnss.file.name, d.gnss.topic, d.slam.file.name) for d in config.drives] == [
        ("night-3", "night-3.mcap", "/fix", "night-3.mcap"),
        ("night2", "night2.mcap", "/fix", "night2.mcap"),
    ]
    assert "align_drive.night2" in map_update(config).nodes
    entry["recordings"]["leave_out"] = ["*"]
    alone = job().config
    assert alone is not None
    assert alone.drives == ()
    entry |= {"parameters": {"alignment.method": "rigid"}}
    entry["recordings"]["leave_out"] = []
    assert "drives are fused by alignment.method pose_graph" in job().fault
    with pytest.raises(ValidationError, match="take: fuse is for recordings that hold both"):
        Recordings(folder=tmp_path, take="fuse", inputs=("gnss.file",))


def test_recordings_wait_until_they_are_complete(tmp_path: Path) -> None:
    now = time.time()
    for name, age in (("b.mcap", 300), ("a.mcap", 100), ("c.mcap", 1), ("d.txt", 100)):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (now - age, now - age))
    by_time = Recordings(folder=tmp_path)
    files, moving = find_recordings(by_time, now)
    assert ([f.file for f in files], moving) == (["b.mcap", "a.mcap"], 1)
    files, _ = find_recordings(by_time.model_copy(update={"order": "name"}), now)
    assert [f.file for f in files] == ["a.mcap", "b.mcap"]
    with pytest.raises(ValidationError, match="pattern"):
        Recordings(folder=tmp_path, pattern="/etc/*")


def test_recordings_lie_in_folders_of_their_own_too(tmp_path: Path) -> None:
    for name in ("2026/d1/drive.mcap", "2026/d2/drive.mcap", "2026/d2/.drive.mcap.x7", "drive.mcap"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "2026" / "d3" / "drive.mcap").mkdir(parents=True)  # a folder by that name is no recording
    found = {}
    for pattern in ("*.mcap", "2026/*/drive.mcap", "**/*.mcap", "2026/d2/*"):
        files, _ = find_recordings(Recordings(folder=tmp_path, pattern=pattern, settle_s=0), time.time() + 1)
        found[pattern] = sorted(f.name for f in files)
    assert found["*.mcap"] == ["drive.mcap"]
    assert found["2026/*/drive.mcap"] == ["2026/d1/drive.mcap", "2026/d2/drive.mcap"]
    assert found["**/*.mcap"] == ["2026/d1/drive.mcap", "2026/d2/drive.mcap", "drive.mcap"]
    assert found["2026/d2/*"] == ["2026/d2/drive.mcap"]


def test_which_recordings_count_and_why(tmp_path: Path) -> None:
    now = time.time()
    arrived = [
        Recording(f"/d/{name}", name, [1, 1, 1, 1], int((now - days * 86_400) * 1e9))
        for name, days in (("old.mcap", 40), ("a.mcap", 5), ("test/b.mcap", 3), ("c.mcap", 2), ("d.mcap", 1))
    ]
    rules = Recordings(folder=tmp_path, take="all", max_age_days=30, at_most=2, leave_out=("test/*",))
    assert [(c.recording.file, c.used, c.why) for c in choose(rules, arrived, now)] == [
        ("old.mcap", False, "older than 30 days"),
        ("a.mcap", False, "2 newer ones are used"),
        ("b.mcap", False, "left out by test/*"),
        ("c.mcap", True, "used"),
        ("d.mcap", True, "used"),
    ]
    newest = choose(Recordings(folder=tmp_path, leave_out=("d.*",)), arrived, now)
    assert [c.recording.file for c in newest if c.used] == ["c.mcap"]
    assert choose(rules, [], now) == []


def test_a_person_sees_which_recordings_count(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write_fleet(tmp_path, 1)
    drive_again(tmp_path / "town00", 1, night=2)
    fleet_commands.recordings(file, [])
    said = capsys.readouterr().out
    assert "1 newer one is used" in said
    assert [line.split()[1] for line in said.splitlines()[1:]] == ["night1.mcap", "night2.mcap"]
    with pytest.raises(InputError, match="has no map"):
        fleet_commands.recordings(file, ["nowhere"])
    data = yaml.safe_load(file.read_text())
    data["maps"][0]["recordings"]["leave_out"] = ["*"]
    file.write_text(yaml.safe_dump(data))
    fleet = load_fleet(file)
    rows, todo = plan_fleet(open_store(fleet), fleet)
    assert (todo, rows[0].state) == ([], "waiting")
    assert "2 do not count" in rows[0].reason


def test_a_run_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    file = write_fleet(tmp_path, 2, timeout_s=0.05)
    assert states(update(file)) == {"town00": "timed out", "town01": "timed out"}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"maps": []}, "maps"),
        ({"maps": [{"name": "a", "config": "a"}] * 2}, "stands twice"),
        ({"schedule": {"cron": "0 2 * * *", "interval_s": 60}}, "either"),
        ({"runs_at_once": 0}, "runs_at_once"),
        ({"colour": "red"}, "unknown key"),
    ],
)
def test_a_fleet_file_with_a_mistake_is_one_clear_line(
    tmp_path: Path, change: dict[str, object], words: str
) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text(yaml.safe_dump({"maps": [{"name": "a", "config": "a.yaml"}], **change}))
    with pytest.raises(ConfigError, match=words):
        load_fleet(file)


def test_the_example_is_a_fleet() -> None:
    fleet = load_fleet(Path(__file__).resolve().parents[2] / "configs" / "fleet.yaml")
    assert isinstance(fleet, FleetConfig)
    assert fleet.work_pool is not None


def test_a_job_has_something_to_do_until_it_was_done(tmp_path: Path) -> None:
    fleet = load_fleet(write_fleet(tmp_path, 1))
    _, todo = plan_fleet(open_store(fleet), fleet)
    assert isinstance(todo[0], Todo)
    assert todo[0].job.recording == "night1.mcap"
