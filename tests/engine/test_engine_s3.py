"""Whole runs on an S3-compatible server, alone and together."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "store"))
from s3_server import BUCKET, serve_s3
from test_engine_disturbed import check_results, together
from work import files_of, run_toy

from flexmap_tasks.engine.released import all_released
from flexmap_tasks.store.store import Store


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    with serve_s3() as found:
        yield {**found, "FLEXMAP_CACHE": str(tmp_path_factory.mktemp("cache"))}


@pytest.fixture
def numbers(tmp_path: Path) -> Path:
    file = tmp_path / "numbers.txt"
    file.write_text("1\n2\n3\n4\n")
    return file


def test_eight_processes_and_gc_on_one_bucket(tmp_path, numbers, environment, monkeypatch):
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    calm = Store.open(tmp_path / "calm")
    for factor in (1.0, 2.0, 3.0):
        run_toy(calm, numbers, factor)
    url, releases = f"s3://{BUCKET}/together", tmp_path / "releases"
    together(url, releases, numbers, processes=8, rounds=2, grace_s=30.0, environment=environment)
    store = Store.open(url, releases)
    check_results(store, calm)
    assert len(list(all_released(store))) == 3
    assert files_of(releases)
