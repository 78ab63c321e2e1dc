"""Lineage and differences of a real map."""

from __future__ import annotations

from pathlib import Path

import pytest

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.diff import diff_releases
from flexmap_tasks.engine.finished import watch
from flexmap_tasks.engine.lineage import file_lineage, settings_behind, value_lineage
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.engine.released import Released, find_release
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.store.store import Store
from flows.finish import finish_run

CONFIG = Path(__file__).parents[2] / "configs" / "garching.yaml"


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Store:
    return Store.open(tmp_path_factory.mktemp("store"))


def run(store: Store, *overrides: str) -> Released:
    config = load_config(FlexMapConfig, CONFIG, overrides)
    graph = map_update(config)
    watched = watch(graph)
    finish_run(store, graph, run_local(store, graph), config, watched)
    return find_release(
        store,
        max(store.releases.glob("*/[!.]*/manifest.json"), key=lambda p: p.stat().st_mtime_ns).as_posix(),
    )


@pytest.fixture(scope="module")
def first(store, shared_data) -> Released:
    return run(store)


def test_a_value_is_followed_back_to_its_way(store, first):
    lines = [value for lanelet in range(100, 140) for value in _values(first, lanelet)]
    assert lines
    for value in lines:
        assert value.transfer["key"] == "speed_limit"
        if value.transfer["action"] == "set":
            assert value.transfer["way_id"] > 0
            assert value.transfer["way_version"] > 0
            assert value.transfer["way_timestamp"].startswith("20")
            assert all(match["way_id"] == value.transfer["way_id"] for match in value.matches)
            assert value.matches
    assert set(settings_behind(first)) == {"match", "transfer"}
    with pytest.raises(InputError, match="no lanelet 1 "):
        value_lineage(first, 1)


def _values(release: Released, lanelet: int):
    try:
        return value_lineage(release, lanelet, "speed_limit")
    except InputError:
        return []


def test_a_file_is_followed_back_to_the_recording(store, first):
    origin = file_lineage(store, first, "lanelet2_map.osm")
    assert {"ingest_gnss", "ingest_osm_roads", "transfer", "georeference"} <= set(origin.stages)
    assert origin.sources["ingest_gnss.source"]["path"].endswith("route_1_GPS.txt")
    assert "ingest_osm_roads.source" not in file_lineage(store, first, "slam_track_after.parquet").sources


def test_the_difference_of_two_releases_is_told_in_metres(store, first):
    moved = run(store, "alignment.rubber_sheet.margin_share=0.3")
    found = diff_releases(store, first, moved)
    why = {change.stage: change.why for change in found.stages}
    assert why["rubber_sheet"] == ("margin_share: 0.1 -> 0.3",)
    assert "ingest_osm_roads" not in why
    assert found.map.moved > 0
    assert 0 < found.map.moved_mean_m < found.map.moved_max_m < 20
    same = diff_releases(store, first, first)
    assert (same.stages, same.sources, same.figures) == ((), (), ())
    assert (same.map.moved, same.map.added, same.map.tags) == (0, (), ())
