"""What becomes of a released map that a person has edited, and of roads that OpenStreetMap has changed."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from lxml import etree

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.engine.release import publish_release
from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.geometry.utm import to_utm
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.report.exports import export_layers
from flexmap_tasks.report.report import report
from flexmap_tasks.store.store import Store

PROJECT = Path(__file__).resolve().parents[2]
Rows = list[dict[str, Any]]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return Store.open(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def inputs(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("edits")
    for name in ("osm_2023.osm", "osm_2016.osm", "control_points_peer.csv"):
        shutil.copyfile(shared_data / "garching" / name, folder / name)
    return folder


def update(store: Store, inputs: Path, *more: str, osm: str = "osm_2023.osm") -> Path:
    """A release of Garching, matched by paths."""
    overrides = ["conflation.match.method=path", f"osm.file={inputs / osm}", *more]
    config = load_config(FlexMapConfig, PROJECT / "configs" / "garching.yaml", overrides)
    graph = map_update(config)
    graph.leave_out(report, export_layers)
    outcomes = run_local(store, graph)
    artifacts = {name: o.artifact for name, o in outcomes.items()}
    actions = {name: o.key for name, o in outcomes.items()}
    return publish_release(store, graph, artifacts, actions, store.releases, config.map).folder


@pytest.fixture(scope="module")
def first(store: Store, inputs: Path) -> Path:
    return update(store, inputs)


def edits(first: Path, edited: Path) -> list[str]:
    return [f"lanelet_map.edits.released={first / 'lanelet2_map.osm'}", f"lanelet_map.edits.edited={edited}"]


def rows(release: Path, table: str) -> Rows:
    return pq.read_table(release / f"{table}.parquet").to_pylist()


def tree(file: Path) -> Any:
    return etree.parse(file, etree.XMLParser(remove_blank_text=False)).getroot()


def element(root: Any, kind: str, of: int | str) -> Any:
    return root.find(f"{kind}[@id='{of}']")


def tags(found: Any) -> dict[str, str]:
    return {t.get("k"): t.get("v") for t in found.findall("tag")}


def set_tag(found: Any, key: str, value: str) -> None:
    tag = found.find(f"tag[@k='{key}']")
    tag = etree.SubElement(found, "tag", k=key) if tag is None else tag
    tag.set("v", value)


def save(root: Any, file: Path) -> Path:
    file.write_bytes(etree.tostring(root, xml_declaration=True, encoding="UTF-8"))
    return file


COORDINATES = ("lat", "lon", "local_x", "local_y")


def said(root: Any) -> dict[tuple[str, str], Any]:
    """Everything but coordinates, by element."""
    return {
        (e.tag, e.get("id")): (
            {k: v for k, v in tags(e).items() if k not in COORDINATES},
            [dict(c.attrib) for c in e if c.tag != "tag"],
        )
        for e in root
    }


def places_m(file: Path) -> dict[str, np.ndarray]:
    found = {n.get("id"): (float(n.get("lon")), float(n.get("lat"))) for n in tree(file).findall("node")}
    return dict(zip(found, to_utm(np.array(list(found.values())), 32632), strict=True))


def farthest_m(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> float:
    return max(float(np.abs(a[k] - b[k]).max()) for k in a.keys() & b.keys())


def test_a_released_map_that_nobody_edited_comes_out_as_it_was(
    store: Store, inputs: Path, first: Path
) -> None:
    again = update(store, inputs, *edits(first, first / "lanelet2_map.osm"))
    before, after = (tree(r / "lanelet2_map.osm") for r in (first, again))
    assert said(before) == said(after)
    assert farthest_m(*(places_m(r / "lanelet2_map.osm") for r in (first, again))) < 1e-5
    assert {r["action"] for r in rows(again, "transfer")} <= {"keep", "review"}


def changed_speeds(release: Path) -> dict[int, tuple[int, str]]:
    """Way and speed by lanelet, where OpenStreetMap's speed was written."""
    return {
        r["lanelet_id"]: (r["way_id"], r["new"])
        for r in rows(release, "transfer")
        if r["key"] == "speed_limit" and r["action"] == "set"
    }


def test_edits_stay_and_only_what_osm_changed_changes(
    store: Store, inputs: Path, first: Path, tmp_path: Path
) -> None:
    speeds = changed_speeds(first)
    by_way: dict[int, list[int]] = {}
    for lanelet, (way, _) in speeds.items():
        by_way.setdefault(way, []).append(lanelet)
    way = max(by_way, key=lambda w: len(by_way[w]))
    mine, theirs = by_way[way][0], by_way[way][1]
    other = next(k for w, k in ((w, k[0]) for w, k in by_way.items()) if w != way)
    root = tree(first / "lanelet2_map.osm")
    set_tag(element(root, "relation", mine), "speed_limit", "20")
    set_tag(element(root, "relation", other), "speed_limit", "15")
    set_tag(element(root, "relation", other), "note", "seen <by> a person")
    node = root.find("node")
    moved = node.get("id")
    node.set("lat", f"{float(node.get('lat')) + 2e-6:.7f}")  # as JOSM does: degrees only, seven decimals
    later = root.findall("node")[1]
    raised = later.get("id")
    set_tag(later, "ele", f"{float(tags(later)['ele']) + 0.5}")
    gone = next(
        r for r in root.findall("relation")
        if tags(r).get("type") == "lanelet" and int(r.get("id")) not in (mine, theirs, other)
        and not any(m.get("ref") == r.get("id") for m in root.iter("member"))
    )  # fmt: skip
    gone.set("action", "delete")
    drawn = etree.SubElement(root, "relation", id="-77")
    for member in element(root, "relation", other).findall("member"):
        if member.get("role") in ("left", "right"):
            drawn.append(etree.fromstring(etree.tostring(member)))
    for key, value in {"type": "lanelet", "subtype": "road", "speed_limit": "5"}.items():
        set_tag(drawn, key, value)
    edited = save(root, tmp_path / "edited.osm")
    news = tree(inputs / "osm_2023.osm")
    set_tag(element(news, "way", way), "maxspeed", "70")
    save(news, inputs / "osm_new.osm")

    release = update(store, inputs, *edits(first, edited), osm="osm_new.osm")
    before, after = said(tree(edited)), said(tree(release / "lanelet2_map.osm"))
    gone_id = ("relation", gone.get("id"))
    assert before.keys() - after.keys() == {gone_id}
    changed = {k: after[k][0] for k in after.keys() & before.keys() if after[k] != before[k]}
    told = changed_speeds(release)
    assert theirs in told
    cut = {r["source_lanelet_id"] for r in rows(release, "transfer") if r["action"] == "split"}
    relations = {int(i) for kind, i in changed if kind == "relation"}
    here = {int(i) for kind, i in before if kind == "relation"}
    assert set(told) & here | {-77} <= relations <= set(told) | cut | {-77}
    for i in relations - {-77}:
        was, now = before["relation", str(i)][0], after["relation", str(i)][0]
        assert {k: v for k, v in now.items() if k != "speed_limit"} == {
            k: v for k, v in was.items() if k != "speed_limit"
        }
    assert {s for _, s in told.values()} == {"70"}
    assert after["relation", str(mine)][0]["speed_limit"] == "20"
    assert after["relation", str(other)][0]["speed_limit"] == "15"
    assert after["relation", str(other)][0]["note"] == "seen <by> a person"
    assert after["relation", "-77"][0]["speed_limit"] == "5"
    asked = [r for r in rows(release, "transfer") if r["lanelet_id"] == mine and r["key"] == "speed_limit"]
    assert [(r["action"], r["old"], r["new"]) for r in asked] == [("review", "20", "70")]
    old, new = places_m(first / "lanelet2_map.osm"), places_m(release / "lanelet2_map.osm")
    assert new[moved] - old[moved] == pytest.approx([0.0, 0.222], abs=0.02)
    assert farthest_m({k: v for k, v in old.items() if k != moved}, new) < 1e-5
    heights = [tags(element(tree(r / "lanelet2_map.osm"), "node", raised))["ele"] for r in (first, release)]
    assert float(heights[1]) - float(heights[0]) == pytest.approx(0.5)
    found = tags(element(tree(release / "lanelet2_map.osm"), "node", moved))
    assert float(found["local_y"]) - float(tags(node)["local_y"]) == pytest.approx(0.222, abs=0.02)


def test_edits_move_with_a_new_alignment(store: Store, inputs: Path, first: Path, tmp_path: Path) -> None:
    points = (inputs / "control_points_peer.csv").read_text()
    moved_points = tmp_path / "points.csv"
    moved_points.write_text(points.replace("48.264158129", "48.264162129"))
    assert moved_points.read_text() != points
    control = f"alignment.control_points_file={moved_points}"
    root = tree(first / "lanelet2_map.osm")
    node = root.findall("node")[40]
    node.set("lon", f"{float(node.get('lon')) + 5e-6:.7f}")
    edited = save(root, tmp_path / "edited.osm")
    plain = places_m(update(store, inputs, control) / "lanelet2_map.osm")
    both = places_m(update(store, inputs, control, *edits(first, edited)) / "lanelet2_map.osm")
    then = places_m(first / "lanelet2_map.osm")
    assert farthest_m(plain, then) > 0.1
    step = both.pop(node.get("id")) - plain[node.get("id")]
    assert step == pytest.approx([0.371, 0.0], abs=0.02)
    recorded = {n.get("id") for n in tree(shared_map()).findall("node")}
    assert farthest_m({k: v for k, v in plain.items() if k in recorded}, both) < 0.02
    cuts = {k: v for k, v in both.items() if k not in recorded}
    assert cuts  # moved with what lies around them; those that today would make lie where today's roads do
    assert farthest_m(plain, cuts) < 0.1


def shared_map() -> Path:
    return PROJECT.parent / "shared" / "data" / "garching" / "lanelet2_route_1.osm"


@pytest.mark.parametrize("osm", ["osm_2023.osm", "osm_2016.osm"])
def test_neither_date_of_osm_harms_the_map(store: Store, inputs: Path, judge: Path, osm: str) -> None:
    pytest.importorskip("lanelet2", reason="the lanelet2 wheel has no build for this platform")
    release = update(store, inputs, osm=osm)
    command = [sys.executable, str(judge), "--moved", str(shared_map()), str(release / "lanelet2_map.osm")]
    said = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    assert said.strip().splitlines()[-1] == "total harm: 0", said


def test_edits_of_another_map_are_refused(store: Store, inputs: Path, shared_data: Path) -> None:
    other = shared_data / "lanelet2" / "mapping_example.osm"
    with pytest.raises(Exception, match=r"holds no node of lanelet_map.file"):
        update(store, inputs, f"lanelet_map.edits.released={other}", f"lanelet_map.edits.edited={other}")


def test_what_became_of_the_matched_roads_since_2016(store: Store, inputs: Path) -> None:
    release = update(store, inputs, f"osm.previous={inputs / 'osm_2016.osm'}")
    found = rows(release, "road_changes")
    kinds = {kind: [r for r in found if r["kind"] == kind] for kind in ("new", "gone", "tag", "geometry")}
    assert all(kinds.values())
    matched = {r["way_id"] for r in rows(release, "matches")}
    assert {r["way_id"] for r in kinds["new"]} <= matched
    for row in found:
        assert row["lanelets"]
        assert 11.6 < row["lon_deg"] < 11.8
        assert 48.2 < row["lat_deg"] < 48.3
    for row in kinds["tag"]:
        assert 0 < row["version_old"] < row["version_new"]
        assert row["timestamp_old"] < "2017" < row["timestamp_new"]
        assert row["old"] != row["new"]
    assert all(r["version_old"] == 0 and r["version_new"] > 0 for r in kinds["new"])
    assert all(r["version_old"] > 0 and r["version_new"] == 0 for r in kinds["gone"])


def test_the_same_extract_twice_shows_no_change(store: Store, inputs: Path) -> None:
    release = update(store, inputs, f"osm.previous={inputs / 'osm_2023.osm'}")
    assert rows(release, "road_changes") == []
