"""A fleet whose recordings and OSM extracts arrive in a bucket, over a real connection to moto's server."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import obstore
import pytest
import yaml
from fleet_town import drive_again, write_town
from test_fleet_maps import states, update

from flexmap_tasks.engine.explain import source_files
from flexmap_tasks.engine.released import find_release
from flexmap_tasks.fleet_config import Recordings
from flexmap_tasks.store import s3
from flows import fleet_commands
from flows.fleet_jobs import load_fleet, open_store
from flows.fleet_plan import plan_fleet
from flows.fleet_recordings import find_recordings

sys.path.insert(0, str(Path(__file__).parents[1] / "store"))
from s3_server import BUCKET, serve_s3


@pytest.fixture(scope="module")
def bucket(tmp_path_factory: pytest.TempPathFactory) -> Iterator[object]:
    with serve_s3() as environment, pytest.MonkeyPatch.context() as patch:
        for name, value in environment.items():
            patch.setenv(name, value)
        patch.setenv("FLEXMAP_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield s3.open_bucket(BUCKET, None, BUCKET)


def arrive(bucket: object, key: str, file: Path) -> None:
    obstore.put(bucket, key, file.read_bytes())  # type: ignore[arg-type]


def test_a_night_from_a_bucket(bucket: object, tmp_path: Path) -> None:
    town = tmp_path / "town"
    write_town(town, 1)
    arrive(bucket, "drives/town/2026/night1.mcap", town / "recordings" / "night1.mcap")
    arrive(bucket, "drives/town/notes.txt", town / "map.yaml")
    arrive(bucket, "osm/town.osm", town / "osm_extract.osm")
    recordings = {
        "bucket": f"s3://{BUCKET}/drives/town",
        "pattern": "**/*.mcap",
        "settle_s": 0,
        "order": "name",
    }
    entry = {"name": "town", "config": "town/map.yaml", "recordings": recordings,
             "osm": {"file": f"s3://{BUCKET}/osm/town.osm"}}  # fmt: skip
    file = tmp_path / "fleet.yaml"
    file.write_text(yaml.safe_dump({"name": "bucket", "store": "store", "maps": [entry]}))
    time.sleep(3)  # what is younger than two seconds is not trusted

    (row,) = update(file)
    assert (row.state, row.recording) == ("published", "night1.mcap")
    store = open_store(load_fleet(file))
    sources = source_files(store, find_release(store, "town"))
    assert sources["ingest_gnss.source"]["path"] == f"s3://{BUCKET}/drives/town/2026/night1.mcap"
    assert sources["ingest_osm_roads.source"]["path"] == f"s3://{BUCKET}/osm/town.osm"

    fleet = load_fleet(file)
    assert [states(plan_fleet(store, fleet)[0]) for _ in range(2)] == [{"town": "unchanged"}] * 2
    known = fleet_commands.arrived(fleet)
    drive_again(town, 1, night=2)
    arrive(bucket, "drives/town/2026/night2.mcap", town / "recordings" / "night2.mcap")
    (name,) = (n for n, found in fleet_commands.arrived(fleet).items() if found - known[n])
    assert name == "town"
    (row,) = update(file)
    assert (row.state, row.recording) == ("published", "night2.mcap")

    shutil.rmtree(town / "recordings")  # nothing of this came from this machine's folders
    local = tmp_path / "local.yaml"
    local.write_text(yaml.safe_dump({"name": "local", "store": "other", "maps": [
        {**entry, "recordings": {**recordings, "bucket": f"s3://{BUCKET}/nothing"}}]}))  # fmt: skip
    assert states(update(local)) == {"town": "waiting"}


def test_patterns_mean_the_same_in_a_bucket_and_in_a_folder(bucket: object, tmp_path: Path) -> None:
    names = ("a.mcap", "d/a.mcap", "d/e/a.mcap", ".a.mcap", "d/.x/a.mcap", "d/a.txt")
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"1")
        arrive(bucket, f"patterns/{name}", tmp_path / name)
    for pattern in ("*.mcap", "*/a.mcap", "**/*.mcap", "d/**/a.mcap", "d/*", "[a-c].mcap", "**"):
        there = find_recordings(Recordings(folder=tmp_path, pattern=pattern), time.time() + 60)
        here = find_recordings(
            Recordings(bucket=f"s3://{BUCKET}/patterns", pattern=pattern), time.time() + 60
        )
        assert sorted(r.name for r in here[0]) == sorted(r.name for r in there[0]), pattern


def test_a_bucket_that_is_not_there_fails_one_map_with_one_line(bucket: object, tmp_path: Path) -> None:
    write_town(tmp_path / "town", 1)
    file = tmp_path / "fleet.yaml"
    file.write_text(yaml.safe_dump({"store": "store", "maps": [
        {"name": "town", "config": "town/map.yaml", "recordings": {"bucket": "s3://no-such-bucket/x"}}]}))  # fmt: skip
    fleet = load_fleet(file)
    (row,), todo = plan_fleet(open_store(fleet), fleet)
    assert (row.state, todo) == ("failed", [])
    assert "there is no such bucket" in row.reason
