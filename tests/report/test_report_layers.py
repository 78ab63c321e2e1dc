"""The layers of a release, read by the tools of others."""

from __future__ import annotations

import dataclasses
import io
import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import osmium
import pyarrow.parquet as pq
import pytest
import shapely
from mcap.reader import make_reader
from report_runs import garching as garching_config
from report_runs import inputs_of, made
from test_report_browser import poisoned

from flexmap_tasks.formats.geojson import geojson
from flexmap_tasks.formats.geoparquet import geoparquet
from flexmap_tasks.formats.osm_xml import parse_osm_xml
from flexmap_tasks.model.layers import VectorLayer
from flexmap_tasks.report.exports import LOOKS, export_layers

pyogrio = pytest.importorskip("pyogrio", reason="pyogrio is not installed: pip install pyogrio")
KML = "{http://www.opengis.net/kml/2.2}"


@pytest.fixture(scope="module")
def inputs(shared_data: Path) -> dict[str, Any]:
    return inputs_of(garching_config(shared_data / "garching"), "export_layers")["export_layers"]


@pytest.fixture(scope="module")
def files(inputs: dict[str, Any]) -> dict[str, bytes]:
    return made(export_layers, inputs)


@pytest.fixture(scope="module")
def folder(files: dict[str, bytes], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("layers")
    for name, content in files.items():
        (path / name).write_bytes(content)
    return path


def read(path: Path, layer: str | None = None) -> tuple[dict[str, Any], np.ndarray, dict[str, np.ndarray]]:
    meta, _, wkb, columns = pyogrio.raw.read(path, layer=layer)
    return meta, shapely.from_wkb(wkb), dict(zip(meta["fields"], columns, strict=True))


def test_gdal_reads_every_layer_of_the_geopackage(folder: Path, inputs: dict[str, Any]) -> None:
    found = dict(pyogrio.list_layers(folder / "flexmap.gpkg").tolist())
    assert set(found) == set(LOOKS)
    for name, kind in found.items():
        meta, shapes, _ = read(folder / "flexmap.gpkg", name)
        assert meta["crs"] == "EPSG:4326"
        assert set(shapely.get_type_id(shapes)) == {{"Point": 0, "LineString": 1, "Polygon": 3}[kind]}
        box = shapely.total_bounds(shapes)
        assert 11.6 < box[0] <= box[2] < 11.75
        assert 48.2 < box[1] <= box[3] < 48.3
    info = pyogrio.read_info(folder / "flexmap.gpkg", layer="gnss_fixes")
    assert info["features"] == len(inputs["gnss"])


def test_lanelets_lie_where_the_map_has_them(folder: Path, inputs: dict[str, Any]) -> None:
    _, shapes, columns = read(folder / "flexmap.gpkg", "lanelets")
    xy = inputs["projection"].to_xy_m(shapely.get_coordinates(shapes))
    nodes = inputs["final_map"].xyz_m[:, :2]
    nearest = shapely.STRtree(shapely.points(nodes)).query_nearest(shapely.points(xy), all_matches=False)[1]
    assert np.abs(nodes[nearest] - xy).max() < 1e-4
    check = inputs["lane_check"]
    verdicts = dict(zip(check.lanelet_id.tolist(), check.verdict.tolist(), strict=True))
    assert [verdicts[i] for i in columns["id"].tolist()] == columns["lane_verdict"].tolist()
    counted = sum(inputs["transfers"].action == "set")
    assert columns["values_set"].sum() == counted


def test_geojson_says_the_same_as_the_geopackage(folder: Path) -> None:
    for name in LOOKS:
        _, shapes, columns = read(folder / "flexmap.gpkg", name)
        _, same, others = read(folder / f"{name}.geojson")
        assert shapely.equals_exact(shapely.normalize(shapes), shapely.normalize(same), tolerance=1e-8).all()
        assert set(columns) == set(others) - {"name"} | (set(columns) & {"name"})


def test_geoparquet_says_the_same_as_the_geopackage(folder: Path) -> None:
    for name in LOOKS:
        _, shapes, columns = read(folder / "flexmap.gpkg", name)
        table = pq.read_table(folder / f"{name}.parquet")
        geo = json.loads(table.schema.metadata[b"geo"])
        assert (geo["version"], geo["primary_column"]) == ("1.1.0", "geometry")
        assert "crs" not in geo["columns"]["geometry"]
        same = shapely.from_wkb(table["geometry"].to_numpy(zero_copy_only=False))
        assert shapely.equals_exact(shapely.normalize(shapes), shapely.normalize(same), tolerance=1e-9).all()
        assert geo["columns"]["geometry"]["bbox"] == pytest.approx(shapely.total_bounds(shapes))
        assert set(table.column_names) == set(columns) | {"geometry"}


def test_the_qgis_project_points_to_layers_that_exist(folder: Path) -> None:
    root = ET.fromstring((folder / "flexmap.qgs").read_bytes())
    sources = [node.text or "" for node in root.iter("datasource")]
    assert len(sources) == len(LOOKS)
    for source in sources:
        file, _, layer = source.partition("|layername=")
        assert pyogrio.read_info(folder / file, layer=layer)["features"] > 0
    ids = {node.text for node in root.findall("projectlayers/maplayer/id")}
    assert ids == {node.get("id") for node in root.iter("layer-tree-layer")}
    symbols = root.findall("projectlayers/maplayer/renderer-v2/symbols/symbol")
    assert len(symbols) == sum(len(look.classes or (1,)) for look in LOOKS.values())


def test_the_public_reader_reads_the_recording(files: dict[str, bytes], inputs: dict[str, Any]) -> None:
    reader = make_reader(io.BytesIO(files["flexmap.mcap"]))
    messages: dict[str, list[dict[str, Any]]] = {}
    for schema, channel, message in reader.iter_messages():
        assert schema is not None
        assert json.loads(schema.data)["title"] == schema.name
        messages.setdefault(channel.topic, []).append(json.loads(message.data))
    assert len(messages["/gnss"]) == len(inputs["gnss"])
    assert len(messages["/slam/aligned"]) == len(inputs["slam"])
    last = messages["/slam/aligned"][-1]["pose"]["position"]
    assert [last[axis] for axis in "xyz"] == inputs["aligned"].xyz_m[-1].tolist()
    lines = [line for e in messages["/map/lanelets"][0]["entities"] for line in e["lines"]]
    assert all(len(line["points"]) % 2 == 0 for line in lines)
    assert len(json.loads(messages["/map/geojson"][0]["geojson"])["features"]) == len(
        inputs["lane_check"].lanelet_id
    )


def test_evo_reads_the_trajectory(folder: Path, inputs: dict[str, Any]) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface", reason="evo is not installed")
    path = file_interface.read_kitti_poses_file(folder / "slam_aligned_kitti.txt")
    assert np.allclose(path.positions_xyz, inputs["aligned"].xyz_m, atol=1e-5)


def test_a_recording_with_time_gives_a_tum_file(inputs: dict[str, Any], tmp_path: Path) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface", reason="evo is not installed")
    stamps = 1_700_000_000_000_000_000 + np.arange(len(inputs["aligned"])) * 100_000_000
    timed = dataclasses.replace(inputs["aligned"], stamp_ns=stamps)
    content = made(export_layers, inputs | {"aligned": timed})["slam_aligned_tum.txt"]
    (tmp_path / "tum.txt").write_bytes(content)
    path = file_interface.read_tum_trajectory_file(tmp_path / "tum.txt")
    assert np.allclose(path.timestamps, stamps / 1e9)
    assert np.allclose(path.positions_xyz, timed.xyz_m, atol=1e-8)


def test_josm_layer_holds_every_lanelet_with_an_open_question(folder: Path, inputs: dict[str, Any]) -> None:
    document = parse_osm_xml((folder / "review.osm").read_bytes(), "review.osm")
    assert document.root["upload"] == "never"
    _, _, review = read(folder / "flexmap.gpkg", "review")
    wanted = {str(i) for i in review["lanelet_id"].tolist()}
    assert set(document.ways.tags.column("flexmap:lanelet")) == wanted
    assert (
        document.ways.ref[document.ways.offset[:-1]] == document.ways.ref[document.ways.offset[1:] - 1]
    ).all()
    seen = [element.id for element in osmium.FileProcessor(str(folder / "review.osm"))]
    assert len(seen) == len(document.nodes.id) + len(document.ways.id)
    assert max(seen) < 0
    assert all(len(value) <= 255 for value in document.ways.tags.value)


def test_kml_is_well_formed_and_complete(files: dict[str, bytes], inputs: dict[str, Any]) -> None:
    root = ET.fromstring(files["flexmap.kml"])
    folders = {f.findtext(f"{KML}name"): len(f.findall(f"{KML}Placemark")) for f in root.iter(f"{KML}Folder")}
    assert folders["lanelets"] == len(inputs["lane_check"].lanelet_id)
    assert folders["tracks"] == 3


def test_issues_have_the_validators_shape(files: dict[str, bytes], inputs: dict[str, Any]) -> None:
    found = json.loads(files["issues.json"])["requirements"]
    assert {r["id"] for r in found} == {"flexmap-map", "flexmap-conflation", "flexmap-bundle"}
    issues = [i for r in found for v in r["validators"] for i in v.get("issues", [])]
    assert len(issues) == len(inputs["transfer_findings"]) + len(inputs["map_findings"])
    assert {frozenset(i) for i in issues} == {
        frozenset({"severity", "primitive", "id", "issue_code", "message"})
    }
    for requirement in found:
        assert requirement["passed"] == all(v["passed"] for v in requirement["validators"])


def test_hostile_text_passes_through_every_format(inputs: dict[str, Any], tmp_path: Path) -> None:
    files = made(export_layers, poisoned(inputs))
    for name in ("flexmap.kml", "flexmap.qgs", "review.osm"):
        ET.fromstring(files[name])
    (tmp_path / "p.gpkg").write_bytes(files["flexmap.gpkg"])
    _, _, columns = read(tmp_path / "p.gpkg", "review")
    assert any("</script>" in reason for reason in columns["reason"])
    for name, content in files.items():
        if name.endswith(".geojson"):
            json.loads(content)


def test_the_same_run_gives_the_same_bytes(inputs: dict[str, Any], files: dict[str, bytes]) -> None:
    assert made(export_layers, inputs) == files


def test_a_drive_without_maps_still_gives_its_tracks(inputs: dict[str, Any]) -> None:
    names = ("control_points", "source_map", "final_map", "roads", "matches", "transfers", "lane_check",
             "map_findings", "transfer_findings", "bundle_findings")  # fmt: skip
    files = made(export_layers, inputs | dict.fromkeys(names))
    assert {"flexmap.gpkg", "flexmap.qgs", "flexmap.mcap", "tracks.geojson", "tracks.parquet"} <= set(files)
    assert "review.osm" not in files
    assert "ATTRIBUTION.txt" not in files


def test_layers_with_roads_name_openstreetmap_and_its_licence(files: dict[str, bytes]) -> None:
    text = files["ATTRIBUTION.txt"].decode()
    assert "© OpenStreetMap contributors" in text
    assert "Open Database License" in text


def test_a_layer_without_features_is_a_file_without_rows() -> None:
    none = np.zeros(0, dtype=object)
    layer = VectorLayer("review", "Point", none, {"reason": none, "row": np.zeros(0, np.int64)})
    table = pq.read_table(io.BytesIO(geoparquet(layer)))
    assert table.num_rows == 0
    assert table.column_names == ["reason", "row", "geometry"]
    assert json.loads(geojson(layer))["features"] == []


def test_geojson_is_what_a_json_library_writes() -> None:
    words = np.array(['say "50 %s"', None, "a\x07\ud800b\n"], dtype=object)
    columns = {
        "100 % \"sure\"": words, "m": np.array([0.1, np.nan, 1e-7]), "n": np.array([1, -2, 1 << 60]),
        "used": np.array([True, False, True]),
    }  # fmt: skip
    rings = [
        shapely.box(1, 2, 3, 4),
        shapely.box(0, 0, 1e-9, 1e-5),
        shapely.Polygon([(0, 0), (9, 0), (0, 9)]),
    ]
    for kind, shapes in {
        "Polygon": rings,
        "LineString": [ring.exterior for ring in rings],
        "Point": [ring.centroid for ring in rings],
    }.items():
        text = geojson(VectorLayer("%s", kind, np.array(shapes), columns)).decode()
        read = json.loads(text)
        assert read["name"] == "%s"
        for i, row in enumerate(text.split("\n")[1:-2]):
            feature = read["features"][i]
            assert json.loads(row.rstrip(",")) == feature  # a line each
            assert feature["properties"] == {
                '100 % "sure"': [words[0], None, "a\ufffd\ufffdb\n"][i],
                "m": [0.1, None, 1e-7][i],
                "n": [1, -2, 1 << 60][i],
                "used": [True, False, True][i],
            }
            places = shapely.get_coordinates(shapely.from_geojson(json.dumps(feature["geometry"])))
            given = shapely.orient_polygons(shapes[i]) if kind == "Polygon" else shapes[i]
            assert np.abs(places - shapely.get_coordinates(given)).max() < 1e-8


def test_a_number_that_json_does_not_know_is_no_feature() -> None:
    layer = VectorLayer("x", "Point", shapely.points([[1.0, 2.0]]), {"m": np.array([np.inf])})
    with pytest.raises(ValueError, match="no infinite numbers"):
        geojson(layer)
    nowhere = VectorLayer("x", "Point", shapely.points([[np.nan, 2.0]]), {})
    with pytest.raises(ValueError, match="only finite numbers"):
        geojson(nowhere)
