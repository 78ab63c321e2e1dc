"""Where the nodes of a map lie, and what is reported about it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flexmap_tasks.errors import InputError
from flexmap_tasks.ingest.lanelet_map import ingest_lanelet_map
from flexmap_tasks.model.lanelets import lanelets_of
from flexmap_tasks.model.maps import LaneletMap
from flexmap_tasks.model.source import Source

LANELET = (
    '<way id="1"><nd ref="1"/><nd ref="2"/></way><way id="2"><nd ref="3"/><nd ref="4"/></way>'
    '<relation id="5"><member type="way" ref="1" role="left"/><member type="way" ref="2" role="right"/>'
    '<tag k="type" v="lanelet"/><tag k="subtype" v="road"/></relation>'
)


def node(number: int, lat: str = "", lon: str = "", **tags: str) -> str:
    inner = "".join(f'<tag k="{k}" v="{v}"/>' for k, v in tags.items())
    return f'<node id="{number}" lat="{lat}" lon="{lon}">{inner}</node>'


def local(number: int, x: float, y: float, **tags: str) -> str:
    return node(number, local_x=str(x), local_y=str(y), **tags)


SQUARE = [local(1, 0, 3), local(2, 10, 3), local(3, 10, 0), local(4, 0, 0)]
GEO = [
    node(1, "48.0", "11.0"),
    node(2, "48.0", "11.001"),
    node(3, "48.001", "11.0"),
    node(4, "48.001", "11.001"),
]


def read(tmp_path: Path, nodes: list[str], rest: str = LANELET) -> LaneletMap:
    path = tmp_path / "map.osm"
    path.write_text(f"<osm>{''.join(nodes)}{rest}</osm>")
    return ingest_lanelet_map(Source("map.osm", path))


def test_local_coordinates_are_the_frame(tmp_path: Path) -> None:
    found = read(tmp_path, [*SQUARE[:3], node(4, "48.0", "11.0", local_x="0", local_y="0", ele="2.5")])
    assert found.xyz_m.tolist() == [[0, 3, 0], [10, 3, 0], [10, 0, 0], [0, 0, 2.5]]
    assert found.findings.code.tolist() == ["nodes-without-ele"]
    lanelets = lanelets_of(found)
    assert (lanelets.left_inverted.tolist(), lanelets.right_inverted.tolist()) == ([False], [True])
    assert lanelets.one_way.tolist() == [True]


def test_lat_and_lon_are_projected_as_lanelet2_does(tmp_path: Path) -> None:
    lanelet2 = pytest.importorskip("lanelet2")
    found = read(tmp_path, GEO)
    projector = lanelet2.projection.UtmProjector(lanelet2.io.Origin(48.0, 11.0))
    for (lon, lat), xyz in zip(found.document.nodes.lonlat_deg.tolist(), found.xyz_m, strict=True):
        point = projector.forward(lanelet2.core.GPSPoint(lat, lon, 0.0))
        assert xyz == pytest.approx([point.x, point.y, 0.0], abs=1e-6)


def test_mixed_coordinates_are_joined_and_reported(tmp_path: Path) -> None:
    utm = read(tmp_path, GEO).xyz_m
    shift = np.array([100.0, -50.0, 0.0])
    mixed = list(GEO)
    for i in (0, 2):
        x, y, _ = utm[i] + shift
        lon, lat = [("11.0", "48.0"), ("", ""), ("11.0", "48.001")][i]
        mixed[i] = node(i + 1, lat, lon, local_x=repr(float(x)), local_y=repr(float(y)))
    found = read(tmp_path, mixed)
    assert found.xyz_m == pytest.approx(utm + shift, abs=1e-9)
    assert "mixed-coordinates" in found.findings.code.tolist()


@pytest.mark.parametrize(
    ("nodes", "words"),
    [
        ([*SQUARE[:3], node(4)], "node 4: has no position"),
        ([*SQUARE[:3], node(4, local_x="1")], "node 4: has only one of local_x and local_y"),
        ([*SQUARE[:3], node(4, local_x="1", local_y="north")], "node 4: local_y must be a number of metres"),
        ([*SQUARE[:3], local(4, 1, 1, ele="nan")], "node 4: ele must be a number"),
        ([*SQUARE[:3], local(4, 1e300, 1)], "node 4: local_x must be a number"),
        ([*SQUARE[:3], GEO[3]], "none has both"),
        ([*GEO[:3], node(4, "48.0", "-120.0")], "node 4: lies more than 300 km"),
        ([*GEO[:3], GEO[0]], "node 1: the id stands 2 times"),
        (GEO[:3], "way 2: refers to node 4"),
    ],
)
def test_positions_that_cannot_be_used(tmp_path: Path, nodes: list[str], words: str) -> None:
    with pytest.raises(InputError) as error:
        read(tmp_path, nodes)
    assert words in str(error.value)


def test_a_file_without_lanelets(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no relation with type=lanelet"):
        read(tmp_path, SQUARE, "")


@pytest.mark.parametrize(
    ("rest", "codes"),
    [
        (LANELET.replace('role="left"', 'role="middle"'), ["lanelet-without-bound"]),
        (LANELET.replace('role="left"', 'role="right"'), ["lanelet-without-bound"] * 2),
        (LANELET.replace('<nd ref="2"/>', '<nd ref="1"/>'), ["lanelet-bound-too-short"]),
        (LANELET.replace('<nd ref="1"/><nd ref="2"/>', ""), ["lanelet-bound-too-short"]),
    ],
)
def test_odd_lanelets_are_kept_and_reported(tmp_path: Path, rest: str, codes: list[str]) -> None:
    found = read(tmp_path, SQUARE, rest)
    broken = [c for c in found.findings.code if c.startswith("lanelet")]
    assert broken == codes
    assert set(found.findings.id[found.findings.primitive == "lanelet"].tolist()) == {5}
    assert len(found.document.relations.id) == 1
    assert len(lanelets_of(found)) == 0


@pytest.mark.parametrize(
    ("tags", "one_way"),
    [
        ("", True),
        ('<tag k="one_way" v="no"/>', False),
        ('<tag k="one_way" v=""/>', True),
        ('<tag k="one_way:vehicle" v="no"/>', False),
        ('<tag k="one_way:bicycle" v="no"/>', True),
    ],
)
def test_one_way(tmp_path: Path, tags: str, one_way: bool) -> None:
    found = lanelets_of(read(tmp_path, SQUARE, LANELET.replace("</relation>", tags + "</relation>")))
    assert found.one_way.tolist() == [one_way]


def test_walkways_go_both_ways_and_deleted_lanelets_are_none(tmp_path: Path) -> None:
    walk = LANELET.replace('"road"', '"crosswalk"')
    gone = '<relation id="6" action="delete"><tag k="type" v="lanelet"/></relation>'
    found = read(tmp_path, SQUARE, walk + gone)
    assert lanelets_of(found).one_way.tolist() == [False]
    assert lanelets_of(found).id.tolist() == [5]
    assert [c for c in found.findings.code if c.startswith("lanelet")] == []
