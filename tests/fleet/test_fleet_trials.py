"""Reruns with other settings beside each other: what is shared, what is compared, what is published."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from fleet_town import write_town

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.compare import best_of, compare_figures
from flexmap_tasks.engine.gate import published_release
from flexmap_tasks.engine.runs import last_run, read_runs
from flexmap_tasks.errors import ConfigError, InputError
from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.store.store import Store
from flows import commands, release_commands
from flows.running import run_planned, run_trials
from flows.trials import parse_grid, trials_of

GRID = ["conflation.match.method=path,buffer_growing", "georeference.projector=Local,MGRS"]


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("town")
    write_town(folder, 1, map="town")
    return folder


def settings(town: Path) -> FlexMapConfig:
    recording = town / "recordings" / "night1.mcap"
    return load_config(FlexMapConfig, town / "map.yaml", [f"gnss.file={recording}", f"slam.file={recording}"])


def test_trials_share_what_does_not_depend_and_publish_nothing(town: Path, tmp_path: Path, capsys) -> None:
    config, store = settings(town), Store.open(tmp_path / "store")
    published = run_planned(config, store, through_prefect=False).id
    made_by_runs = len(list(read_runs(store, "town")))
    recording = town / "recordings" / "night1.mcap"
    given = [f"gnss.file={recording}", f"slam.file={recording}"]
    commands.run_grid(
        town / "map.yaml", given, GRID, store, tmp_path / "t.parquet", None, through_prefect=False
    )
    rows = pq.read_table(tmp_path / "t.parquet").to_pylist()
    assert [(r["conflation.match.method"], r["georeference.projector"]) for r in rows] == [
        ("path", "Local"), ("path", "MGRS"), ("buffer_growing", "Local"), ("buffer_growing", "MGRS"),
    ]  # fmt: skip
    assert published_release(store, "town") == published
    assert len({row["release"] for row in rows}) == 4
    assert all((store.releases / "town" / row["release"] / "lanelet2_map.osm").is_file() for row in rows)
    for row in rows:
        quality = json.loads((store.releases / "town" / row["release"] / "quality.json").read_text())
        figures = {m["name"]: m["value"] for m in quality["measures"]}
        assert row["match_rate_by_length"] == figures["match_rate_by_length"]
        assert row["deviation_after_all_rmse_m"] == figures["deviation_after_all_rmse"]
    # the last trial takes its matching from the third and its alignment from the very first run
    assert rows[3]["stages_run"] < rows[2]["stages_run"] < rows[3]["stages_cached"]
    assert rows[3]["stages_run"] <= 4
    last = last_run(store, "town")
    assert last is not None
    assert last.release == published, "trials are no runs that a map is judged by"
    assert len(list(read_runs(store, "town"))) > made_by_runs, "but what they are made of is known"

    release_commands.compare(store, "town", [row["release"][:6] for row in rows], tmp_path / "c.md", None)
    page = (tmp_path / "c.md").read_text()
    assert page.count("\n| ") == 6 - 1
    assert "georeference.projector" in page
    assert "match.method" in page
    release_commands.publish(store, "town", rows[1]["release"])
    assert published_release(store, "town") == rows[1]["release"]


def test_a_trial_that_fails_stops_no_other(town: Path, tmp_path: Path) -> None:
    config, store = settings(town), Store.open(tmp_path / "store")
    comparison = run_trials(config, {"gnss.topic": ["nowhere", None]}, store, None, through_prefect=False)
    assert [bool(row["release"]) for row in comparison.facts] == [False, True]
    assert "nowhere" in comparison.facts[0]["gate"]
    assert comparison.best <= {1}


@pytest.mark.parametrize(
    ("grid", "words"),
    [
        (["conflation.match.method"], "expected key.path=value"),
        (["conflation.match.method=path,magic"], "conflation.match.method"),
        (["conflation.match.method="], "no values"),
        (["a=1", "a=2"], "stands twice"),
        (["map=town,city"], "one map"),
        (["conflation.match.method=" + "path," * 40, "gnss.topic=" + "a," * 40], "1000 at most"),
        (["conflation.match.method=[path"], "not valid YAML"),
    ],
)
def test_a_grid_with_a_mistake_runs_nothing(town: Path, grid: list[str], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        trials_of(settings(town), parse_grid(grid))


def test_the_best_is_told_by_errors_on_withheld_gnss_first() -> None:
    def quality(**figures: float | None) -> dict[str, dict[str, object]]:
        return {name: {"name": name, "unit": "1", "value": value} for name, value in figures.items()}

    figures = compare_figures([
        quality(held_out_error_rmse=0.3, match_rate=0.9, deviation_after_valid_rmse=0.1, poses=5.0),
        quality(held_out_error_rmse=0.2, match_rate=0.8, deviation_after_valid_rmse=0.4, poses=6.0),
        quality(held_out_error_rmse=0.2, match_rate=0.7, deviation_after_valid_rmse=0.4, poses=7.0),
        None,
    ])  # fmt: skip
    assert best_of(figures, range(4)) == ({1}, "held_out_error_rmse, then match_rate")
    assert best_of(figures, range(4), "match_rate") == ({0}, "match_rate")
    assert best_of(figures, [0, 2]) == ({2}, "held_out_error_rmse")
    assert best_of(compare_figures([quality(match_rate=0.5)] * 2), range(2)) == (frozenset(), "")
    with pytest.raises(InputError, match="describes"):
        best_of(figures, range(4), "poses")
    with pytest.raises(InputError, match="no figure"):
        best_of(figures, range(4), "beauty")
