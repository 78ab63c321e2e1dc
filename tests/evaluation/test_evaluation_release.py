"""A whole update against the truth of its world: nothing is found where nothing is, every planted error is."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from evaluation_run import TRUTH_TABLES, Run

from flexmap_tasks.config import TruthEvaluationParams
from flexmap_tasks.errors import InputError
from flexmap_tasks.evaluation.lineage import lineage
from flexmap_tasks.evaluation.matching_truth import judge_matches, prediction_of
from flexmap_tasks.formats.artifacts import encode
from flexmap_tasks.formats.release_files import read_released
from flexmap_tasks.ingest.truth import ingest_truth
from flexmap_tasks.model.lanelets import lanelets_of
from flexmap_tasks.model.maps import LaneletMap
from flexmap_tasks.model.source import Source


def figures(files: dict[str, bytes]) -> dict[str, float | None]:
    return {m["name"]: m["value"] for m in json.loads(files["evaluation.json"])["measures"]}


@pytest.fixture(scope="module")
def found(noiseless: Run) -> dict[str, Any]:
    return json.loads(noiseless.evaluate()["evaluation.json"])


@pytest.fixture(scope="module")
def base(noiseless: Run) -> dict[str, float | None]:
    return figures(noiseless.evaluate())


def test_without_noise_there_is_no_error(base: dict[str, float | None], found: dict[str, Any]) -> None:
    for name, most in {
        "trajectory_planar_rmse": 0.005, "map_planar_rmse": 0.005, "map_planar_max": 0.02, "trajectory_height_std": 0.01,
        "width_change_max": 0.002, "lanelets_folded": 0, "map_nodes_lost": 0, "rpe_10_translation_rmse": 0.005,
    }.items():  # fmt: skip
        figure = base[name]
        assert figure is not None
        assert figure <= most, name
    nearest = found["matching"]["nearest_way"]["link"]
    assert nearest["precision"] > 0.999
    assert nearest["recall"] > 0.999
    assert base["match_link_precision"] == pytest.approx(1.0, abs=1e-3)


def test_output_is_whole_and_the_same_twice(noiseless: Run) -> None:
    first, second = noiseless.evaluate(), noiseless.evaluate(baseline=noiseless.matches)
    assert set(first) == {
        "evaluation.json", "evaluation.md", "error_along_route.svg", "error_map.svg", "width_change.svg", "reliability.svg",
    }  # fmt: skip
    assert first == noiseless.evaluate()
    tables = json.loads(second["evaluation.json"])["matching"]
    assert tables["buffer_growing"] == tables["release"]
    assert b"self-scored precision" in first["evaluation.md"]
    assert b"| match_f1 |" in first["evaluation.md"]
    assert all(content.startswith(b"<?xml") for name, content in first.items() if name.endswith(".svg"))


def test_a_cloud_only_run_is_judged_by_its_trajectory(noiseless: Run) -> None:
    nothing = dict.fromkeys(("before", "finished", "matches", "transfers", "lane_check", "roads", "quality"))
    names = set(figures(noiseless.evaluate(**nothing)))
    assert "trajectory_planar_rmse" in names
    assert not any(name.startswith(("map_", "match_", "harm")) for name in names)


def test_limits_are_judged(noiseless: Run) -> None:
    params = TruthEvaluationParams(map_error_p95_max_m=1e-9, match_f1_min=0.5, trajectory_rmse_max_m=1.0)
    measures = json.loads(noiseless.evaluate(params=params)["evaluation.json"])["measures"]
    verdicts = {m["name"]: m["passed"] for m in measures if m["passed"] is not None}
    assert verdicts["map_planar_p95"] is False
    assert verdicts["match_f1"] is True
    assert verdicts["trajectory_planar_gnss_rmse"] is True


def shifted(lanelet_map: LaneletMap, node_id: int, shift: tuple[float, float, float]) -> LaneletMap:
    xyz = lanelet_map.xyz_m.copy()
    xyz[np.flatnonzero(lanelet_map.document.nodes.id == node_id)] += shift
    return replace(lanelet_map, xyz_m=xyz)


def test_a_shifted_node_is_found(noiseless: Run, base: dict[str, float | None]) -> None:
    node = int(noiseless.finished.document.ways.ref[3])
    after = figures(noiseless.evaluate(finished=shifted(noiseless.finished, node, (0.6, -0.8, 2.0))))
    assert after["map_planar_max"] == pytest.approx(1.0, abs=0.02)
    assert after["map_planar_median"] == pytest.approx(base["map_planar_median"], abs=1e-5)
    width, before = after["width_change_max"], base["width_change_max"]
    assert width is not None
    assert before is not None
    assert width > before + 0.1


def test_a_swapped_match_is_found(noiseless: Run, base: dict[str, float | None]) -> None:
    matches = noiseless.matches
    judged = judge_matches(prediction_of(matches), noiseless.truth.matches)
    link = np.unique(noiseless.truth.matches.lanelet_id[noiseless.truth.matches.kind == "link"])
    rows = np.flatnonzero(np.isin(matches.lanelet_id, link) & (matches.decision == "match"))
    row = rows[np.argmax((matches.s_to_m - matches.s_from_m)[rows])]
    way = matches.way_id.copy()
    way[row] = 424242
    metres = float((matches.s_to_m - matches.s_from_m)[row])
    after = json.loads(noiseless.evaluate(matches=replace(matches, way_id=way))["evaluation.json"])[
        "matching"
    ]["release"]
    assert after["all"]["wrong_m"] == pytest.approx(
        float(judged.length_m[judged.matched & ~judged.right].sum()) + metres, rel=0.02
    )
    assert after["link"]["f1"] < 0.999


def test_a_lost_way_is_found(noiseless: Run, base: dict[str, float | None]) -> None:
    matches = noiseless.matches
    sure = matches.decision == "match"
    lost = int(
        np.bincount(matches.way_id[sure] - matches.way_id[sure].min()).argmax() + matches.way_id[sure].min()
    )
    hit = matches.way_id == lost
    without = replace(
        matches, way_id=np.where(hit, 0, matches.way_id), direction=np.where(hit, 0, matches.direction),
        decision=np.where(hit, "none", matches.decision).astype(object),
    )  # fmt: skip
    after = figures(noiseless.evaluate(matches=without))
    assert after["match_recall"] < (base["match_recall"] or 0) - 0.01
    assert after["match_precision"] == pytest.approx(base["match_precision"], abs=0.01)


def test_a_wrong_tag_is_found(noiseless: Run, found: dict[str, Any]) -> None:
    finished, tags = noiseless.finished, noiseless.truth.tags
    known = tags.lanelet_id[(tags.key == "speed_limit") & (tags.osm_value != "")]
    junction = np.unique(noiseless.truth.matches.lanelet_id[noiseless.truth.matches.kind == "junction"])
    cut = np.unique(noiseless.transfers.source_lanelet_id[noiseless.transfers.action == "split"])
    lanelet = int(np.setdiff1d(np.setdiff1d(known, junction), cut)[0])
    length = float(tags.lanelet_length_m[tags.lanelet_id == lanelet][0])
    relations = finished.document.relations
    row = np.flatnonzero(relations.id == lanelet)
    wrong = replace(relations, tags=relations.tags.with_values(row, ["speed_limit"], ["77"]))
    document = replace(finished.document, relations=wrong)
    after = json.loads(noiseless.evaluate(finished=replace(finished, document=document))["evaluation.json"])
    before_m = found["attributes"]["speed_limit"]["wrong_m"]
    assert after["attributes"]["speed_limit"]["wrong_m"] == pytest.approx(before_m + length, abs=1e-6)
    assert after["attributes"]["road_name"] == found["attributes"]["road_name"]


def test_a_lost_lanelet_is_harm(noiseless: Run, found: dict[str, Any]) -> None:
    relations = noiseless.finished.document.relations
    row = int(np.flatnonzero(relations.tags.column("type") == "lanelet")[5])
    tags = relations.tags.with_values(np.array([row]), ["type"], ["lost"])
    document = replace(noiseless.finished.document, relations=replace(relations, tags=tags))
    after = json.loads(
        noiseless.evaluate(finished=replace(noiseless.finished, document=document))["evaluation.json"]
    )
    assert after["harm_info"]["lanelets after"] == found["harm_info"]["lanelets after"] - 1
    assert sum(after["harm"].values()) > sum(found["harm"].values())


def test_a_wrong_trajectory_is_found(noiseless: Run) -> None:
    aligned = noiseless.aligned
    after = figures(
        noiseless.evaluate(aligned=replace(aligned, xyz_m=aligned.xyz_m + np.array([3.0, 4.0, 0.0])))
    )
    assert after["trajectory_planar_mean"] == pytest.approx(5.0, abs=0.01)


def test_cut_lanelets_cover_their_source(noiseless: Run) -> None:
    lanelets = lanelets_of(noiseless.finished)
    origin = lineage(noiseless.finished, lanelets, noiseless.transfers)
    ids, group = np.unique(origin.source_id, return_inverse=True)
    assert np.bincount(group, origin.stop - origin.start) == pytest.approx(1.0)
    assert set(ids.tolist()) == set(lanelets_of(noiseless.before).id.tolist())
    assert len(ids) < len(lanelets)


def test_a_released_folder_reads_back(noiseless: Run, tmp_path: Path) -> None:
    values = {"slam_track_after": noiseless.aligned, "projection": noiseless.projection, "matches": noiseless.matches,
              "transfer": noiseless.transfers, "quality": noiseless.quality}  # fmt: skip
    for name, value in values.items():
        for file, content in encode(value, name):
            (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / file).write_bytes(content)
    released = read_released(tmp_path)
    assert released.lane_check is None
    assert released.matches is not None
    assert released.transfers is not None
    again = noiseless.evaluate(aligned=released.aligned, projection=released.projection, matches=released.matches,
                               transfers=released.transfers, quality=released.quality)  # fmt: skip
    assert again == noiseless.evaluate()
    (tmp_path / "matches.parquet").write_bytes(b"nonsense")
    with pytest.raises(InputError, match="run the update again"):
        read_released(tmp_path)
    with pytest.raises(InputError, match="release folder"):
        read_released(tmp_path / "nowhere")


def test_truth_that_is_none_is_refused(noiseless: Run, noiseless_folder: Path, tmp_path: Path) -> None:
    def read(**other: Path) -> None:
        paths = {name: noiseless_folder / "truth" / f"{name}.parquet" for name in TRUTH_TABLES} | other
        ingest_truth(*(Source(path.name, path) for path in paths.values()))

    read()
    bad = tmp_path / "bad.parquet"
    with pytest.raises(InputError, match="cannot be read"):
        read(poses=bad)
    bad.write_bytes(b"PAR1 nonsense")
    with pytest.raises(InputError, match="Parquet"):
        read(tags=bad)
    table = pq.read_table(noiseless_folder / "truth" / "matches.parquet")
    for broken, words in (
        (table.drop_columns(["way_id"]), "way_id"),
        (table.set_column(0, "lanelet_id", pa.array(["x"] * len(table))), "lanelet_id"),
        (table.set_column(0, "lanelet_id", pa.array([None] * len(table), pa.int64())), "gaps"),
        (table.set_column(1, "s_from_m", pa.array([1e9] * len(table))), "lie on its lanelet"),
        (table.set_column(1, "s_from_m", pa.array([float("nan")] * len(table))), "no number"),
    ):
        pq.write_table(broken, bad)
        with pytest.raises(InputError, match=words):
            read(matches=bad)
