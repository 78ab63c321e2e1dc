"""The finished map, judged from outside."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from flexmap_tasks.config import GeoreferenceParams
from flexmap_tasks.errors import ConfigError, CoverageError
from flexmap_tasks.formats.osm_xml import parse_osm_xml, read_osm_xml
from flexmap_tasks.formats.osm_xml_write import write_osm_xml
from flexmap_tasks.geometry.utm import to_utm, utm_epsg
from flexmap_tasks.georeferencing.bundle import georeference
from flexmap_tasks.georeferencing.map import georeference_map
from flexmap_tasks.ingest.lanelet_map import ingest_lanelet_map
from flexmap_tasks.model.alignment import RigidMotion, Warp
from flexmap_tasks.model.maps import LaneletMap
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.source import Source

MAPS = ("garching/lanelet2_route_1.osm", "lanelet2/mapping_example.osm", "lanelet2/sample_map_planning.osm")
LON, LAT = 11.55, 48.264367644601826


def projection_at(lon: float, lat: float, epsg: int | None = None) -> Projection:
    epsg = epsg or utm_epsg(lon, lat)
    ((east, north),) = to_utm(np.array([[lon, lat]]), epsg)
    return Projection(epsg, lat, lon, float(east), float(north), 0.0, 1.0, 1.0, "WGS84")


def centred(lanelet_map: LaneletMap) -> LaneletMap:
    """The map around the origin, as a warp would leave it."""
    shift = np.append(lanelet_map.xyz_m[:, :2].mean(axis=0), 0.0)
    return replace(lanelet_map, xyz_m=lanelet_map.xyz_m - shift)


def judged(judge: Path, before: Path, after: Path, *options: str) -> str:
    run = subprocess.run(
        [sys.executable, str(judge), str(before), str(after), *options],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode in (0, 1), run.stderr
    return "\n".join(line for line in run.stdout.splitlines() if line.startswith(("HARM", "total")))


@pytest.mark.parametrize("name", MAPS)
def test_a_round_trip_does_no_harm(shared_data: Path, judge: Path, tmp_path: Path, name: str) -> None:
    pytest.importorskip("lanelet2")
    after = tmp_path / "after.osm"
    after.write_bytes(write_osm_xml(read_osm_xml(shared_data / name, name)))
    assert judged(judge, shared_data / name, after) == "total harm: 0"


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("projector", ["LocalCartesianUTM", "MGRS", "Local"])
def test_a_move_does_no_harm(
    shared_data: Path, judge: Path, tmp_path: Path, name: str, projector: str
) -> None:
    pytest.importorskip("lanelet2")
    before = ingest_lanelet_map(Source(name, shared_data / name))
    files = georeference(centred(before), projection_at(LON, LAT), GeoreferenceParams(projector=projector))
    after = tmp_path / "lanelet2_map.osm"
    after.write_bytes(files["lanelet2_map.osm"])
    assert judged(judge, shared_data / name, after, "--moved") == "total harm: 0"


def test_the_warp_moves_every_node_and_nothing_else(shared_data: Path) -> None:
    before = ingest_lanelet_map(Source("map.osm", shared_data / MAPS[0]))
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    after = georeference_map(before, Warp(RigidMotion(turn, np.array([5.0, -7.0]), 1.0, 1.0, 0.0), None))
    x, y, z = before.xyz_m.T
    assert after.xyz_m == pytest.approx(np.column_stack([5.0 - y, x - 7.0, z]))
    assert after.document is before.document


@pytest.mark.parametrize("name", MAPS)
def test_without_projection_nothing_moves(shared_data: Path, judge: Path, tmp_path: Path, name: str) -> None:
    pytest.importorskip("lanelet2")
    before = ingest_lanelet_map(Source(name, shared_data / name))
    files = georeference(before, None, GeoreferenceParams())
    after = tmp_path / "lanelet2_map.osm"
    after.write_bytes(files["lanelet2_map.osm"])
    assert judged(judge, shared_data / name, after) == "total harm: 0"
    assert yaml.safe_load(files["map_projector_info.yaml"]) == {"projector_type": "Local"}


def test_all_coordinates_agree(shared_data: Path, tmp_path: Path) -> None:
    moved = centred(ingest_lanelet_map(Source("map.osm", shared_data / MAPS[0])))
    origin = projection_at(LON, LAT)
    files = georeference(moved, origin, GeoreferenceParams())
    after = tmp_path / "after.osm"
    after.write_bytes(files["lanelet2_map.osm"])
    again = ingest_lanelet_map(Source("after.osm", after))
    nodes = again.document.nodes
    assert np.abs(again.xyz_m - moved.xyz_m).max() < 1e-4
    utm = to_utm(nodes.lonlat_deg, origin.epsg) - (origin.origin_easting_m, origin.origin_northing_m)
    assert np.abs(utm - moved.xyz_m[:, :2]).max() < 2e-6
    assert {code[:5] for code in nodes.tags.column("mgrs_code")} == {"32UPU"}
    assert {len(code) for code in nodes.tags.column("mgrs_code")} == {11}
    assert nodes.tags.column("ele").tolist() == moved.document.nodes.tags.column("ele").tolist()
    assert all(len(text.split(".")[1]) == 11 for text in nodes.attributes.column("lat"))
    assert again.document.root == {"version": "0.6", "generator": "VMB"}
    assert yaml.safe_load(files["map_projector_info.yaml"]) == {
        "projector_type": "LocalCartesianUTM",
        "vertical_datum": "WGS84",
        "map_origin": {"latitude": LAT, "longitude": LON, "altitude": 0.0},
    }
    second = georeference(again, origin, GeoreferenceParams())
    assert georeference(again, origin, GeoreferenceParams()) == second


def test_mgrs_frame(shared_data: Path) -> None:
    moved = centred(ingest_lanelet_map(Source("map.osm", shared_data / MAPS[2])))
    origin = projection_at(LON, LAT)
    files = georeference(moved, origin, GeoreferenceParams(projector="MGRS", vertical_datum="EGM2008"))
    assert yaml.safe_load(files["map_projector_info.yaml"]) == {
        "projector_type": "MGRS", "vertical_datum": "EGM2008", "mgrs_grid": "32UPU",
    }  # fmt: skip
    nodes = parse_osm_xml(files["lanelet2_map.osm"], "after").nodes
    local = np.column_stack([nodes.tags.column(k).astype(np.float64) for k in ("local_x", "local_y")])
    wanted = (moved.xyz_m[:, :2] + (origin.origin_easting_m, origin.origin_northing_m)) % 1e5
    assert np.abs(local - wanted).max() < 1e-4


SMALL = (
    '<osm><node id="1" lat="" lon=""><tag k="local_x" v="0"/><tag k="local_y" v="3"/></node>'
    '<node id="2"><tag k="local_x" v="9"/><tag k="local_y" v="3"/><tag k="mgrs_code" v="32UPU0010000200"/></node>'
    '<way id="1"><nd ref="1"/><nd ref="2"/></way><way id="2"><nd ref="1"/><nd ref="2"/></way>'
    '<relation id="5"><member type="way" ref="1" role="left"/><member type="way" ref="2" role="right"/>'
    '<tag k="type" v="lanelet"/></relation></osm>'
)


@pytest.fixture
def small(tmp_path: Path) -> LaneletMap:
    path = tmp_path / "small.osm"
    path.write_text(SMALL)
    return ingest_lanelet_map(Source("small.osm", path))


def test_blank_coordinates_are_filled(small: LaneletMap) -> None:
    nodes = parse_osm_xml(
        georeference(small, projection_at(LON, LAT), GeoreferenceParams())["lanelet2_map.osm"], "x"
    ).nodes
    assert np.isfinite(nodes.lonlat_deg).all()
    assert nodes.tags.column("ele").tolist() == ["0.0000", "0.0000"]
    assert [len(code) for code in nodes.tags.column("mgrs_code")] == [15, 15]
    assert list(nodes.tags.of_element(1)) == ["local_x", "local_y", "mgrs_code", "ele"]


def test_a_map_over_two_squares_is_refused_for_mgrs_only(small: LaneletMap) -> None:
    wide = replace(small, xyz_m=small.xyz_m + np.array([[0, 0, 0], [60_000.0, 0, 0]]))
    origin = projection_at(LON, LAT)
    assert georeference(wide, origin, GeoreferenceParams())
    with pytest.raises(CoverageError, match="spans 2 squares"):
        georeference(wide, origin, GeoreferenceParams(projector="MGRS"))


def test_a_foreign_zone_is_refused_where_autoware_cannot_know_it(small: LaneletMap) -> None:
    foreign = projection_at(LON, LAT, 32633)
    assert georeference(small, foreign, GeoreferenceParams(projector="Local"))
    with pytest.raises(ConfigError, match="33N"):
        georeference(small, foreign, GeoreferenceParams())


def test_far_off_the_earth_is_one_line(small: LaneletMap) -> None:
    far = replace(small, xyz_m=small.xyz_m + 5e7)
    with pytest.raises(CoverageError, match="node 1: lies outside"):
        georeference(far, projection_at(LON, LAT), GeoreferenceParams())


def test_new_nodes_without_projection_get_local_coordinates(small: LaneletMap) -> None:
    nodes = small.document.nodes
    bare = replace(nodes, tags=nodes.tags.take(np.array([0, 1])).with_values(np.array([0]), ["a"], ["b"]))
    keep = np.array([bare.tags.key[i] == "a" for i in range(len(bare.tags.key))])
    owner = bare.tags.owner()
    tags = type(bare.tags)(
        np.concatenate([[0], np.cumsum([np.count_nonzero(keep[owner == i]) for i in (0, 1)])]),
        bare.tags.key[keep],
        bare.tags.value[keep],
    )
    naked = replace(small, document=replace(small.document, nodes=replace(bare, tags=tags)))
    found = parse_osm_xml(georeference(naked, None, GeoreferenceParams())["lanelet2_map.osm"], "x").nodes
    assert found.tags.column("local_x").tolist() == ["0.0000", "9.0000"]
    assert found.attributes.column("lat").tolist() == ["", ""]
