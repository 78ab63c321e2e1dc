"""OpenStreetMap's roads: the same table whatever the file looks like, one clear line for what is no extract."""

from __future__ import annotations

import gzip
import random
import tracemalloc
from dataclasses import fields
from pathlib import Path

import numpy as np
import osmium
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lxml import etree

from flexmap_tasks.config import OsmRoadsParams
from flexmap_tasks.errors import InputError
from flexmap_tasks.ingest.osm_roads import ingest_osm_roads
from flexmap_tasks.model.maps import RoadNetwork
from flexmap_tasks.model.osm import Tags
from flexmap_tasks.model.source import Source

PARAMS = OsmRoadsParams()


def node(i: int, lat: object = None, lon: object = None, **more: object) -> str:
    attributes = {
        "id": i,
        "lat": 48 + i * 1e-4 if lat is None else lat,
        "lon": 11.5 if lon is None else lon,
        **more,
    }
    return "<node " + " ".join(f'{k}="{v}"' for k, v in attributes.items()) + "/>"


def way(i: object, refs: list[object], tags: dict[str, str] | None = None, **more: object) -> str:
    attributes = " ".join(f'{k}="{v}"' for k, v in {"id": i, **more}.items())
    tags = {"highway": "residential"} if tags is None else tags
    body = "".join(f'<nd ref="{r}"/>' for r in refs) + "".join(
        f'<tag k="{k}" v="{v}"/>' for k, v in tags.items()
    )
    return f"<way {attributes}>{body}</way>"


def document(*elements: str) -> bytes:
    return (
        "<?xml version='1.0' encoding='UTF-8'?>\n<osm version='0.6'>" + "\n".join(elements) + "</osm>\n"
    ).encode()


def read(tmp_path: Path, content: bytes, name: str = "x.osm") -> RoadNetwork:
    path = tmp_path / name
    path.write_bytes(content)
    return ingest_osm_roads(Source(name, path), PARAMS)


def same(a: RoadNetwork, b: RoadNetwork) -> bool:
    def columns(network: RoadNetwork) -> list[list[object]]:
        values = [getattr(network, f.name) for f in fields(network)]
        flat = [v for x in values for v in ((x.offset, x.key, x.value) if isinstance(x, Tags) else (x,))]
        return [v.tolist() for v in flat]

    return columns(a) == columns(b)


NODES = [node(i) for i in range(1, 9)]


def test_a_plain_road(tmp_path: Path) -> None:
    roads = read(
        tmp_path,
        document(*NODES, way(7, [3, 1, 2], {"name": "Ü & <b>".replace("&", "&amp;").replace("<", "&lt;"),
                 "highway": "living_street"}, version=4, timestamp="2023-08-17T15:15:37+02:00")),
    )  # fmt: skip
    assert roads.way_id.tolist() == [7]
    assert roads.version.tolist() == [4]
    assert roads.timestamp.tolist() == ["2023-08-17T13:15:37Z"]
    assert roads.node_id.tolist() == [3, 1, 2]
    assert roads.lonlat_deg.tolist() == [[11.5, 48 + i * 1e-4] for i in (3, 1, 2)]
    assert roads.tags.of_element(0) == {"highway": "living_street", "name": "Ü & <b>"}
    assert roads.note is not None
    assert roads.note.tolist() == [""]


def test_only_what_vehicles_drive_on(tmp_path: Path) -> None:
    others = [{"highway": "footway"}, {"highway": "service", "area": "yes"}, {"building": "yes"}, {}]
    roads = read(tmp_path, document(*NODES, *(way(i, [1, 2], t) for i, t in enumerate(others))))
    assert len(roads) == 0
    assert roads.lonlat_deg.shape == (0, 2)


@settings(max_examples=25, deadline=None)
@given(st.randoms(use_true_random=False))
def test_order_in_the_file_does_not_matter(
    tmp_path_factory: pytest.TempPathFactory, chance: random.Random
) -> None:
    elements = [
        *NODES, node(3, 48.9, version=7), node(3, 48.8, version=6), way(5, [1, 2, 3], version=2),
        way(5, [1, 2], version=1), way(-4, [4, 4, 5, 99, 6, 7]), way(9, [8], version=2), way(12, [3, 8, 1]),
        way(30, [1, 2], {"highway": "footway"}, version=3), way(30, [1, 2], version=2),
        '<relation id="1"><member type="relation" ref="2" role=""/></relation>',
        '<relation id="2"><member type="relation" ref="1" role=""/></relation>',
    ]  # fmt: skip
    tmp_path = tmp_path_factory.mktemp("order")
    expected = read(tmp_path, document(*elements))
    assert expected.way_id.tolist() == [-4, 5, 12]
    chance.shuffle(elements)
    assert same(expected, read(tmp_path, document(*elements)))


def test_an_edit_that_touches_no_road_changes_nothing(tmp_path: Path) -> None:
    before = document(*NODES, way(5, [1, 2, 3]), way(6, [7, 8], {"building": "yes"}))
    after = document(
        node(70), node(8, 48.5, version=2), *NODES[:7], way(5, [1, 2, 3]), way(80, [7, 8, 7], {"a": "b"})
    )
    assert same(read(tmp_path, before), read(tmp_path, after))


@pytest.mark.parametrize(
    ("refs", "kept"),
    [
        ([1, 2, 99, 3, 4, 5], [3, 4, 5]),
        ([99, 1, 2], [1, 2]),
        ([1, 2, 99, 4, 5], [1, 2]),
        ([1, 1, 2, 2, 2, 3], [1, 2, 3]),
        ([1, 2, 1], [1, 2, 1]),
        (["x", 1, 2], [1, 2]),
        ([1, 2, 10**30], [1, 2]),
        ([99, 98], None),
        ([1], None),
        ([1, 1, 1], None),
        ([], None),
    ],
)
def test_broken_courses(tmp_path: Path, refs: list[object], kept: list[int] | None) -> None:
    roads = read(tmp_path, document(*NODES, way(5, refs), way(6, [1, 2])))
    assert roads.way_id.tolist() == ([5, 6] if kept else [6])
    if kept:
        assert roads.node_id[: roads.offset[1]].tolist() == kept
        assert roads.note is not None
        assert ("missing" in roads.note[0]) == (99 in refs or "x" in refs or 10**30 in refs)


def test_two_nodes_at_one_place_keep_the_ends(tmp_path: Path) -> None:
    twins = [node(20, 48.0001), node(21, 48.0003), node(22, 48.0003)]
    roads = read(tmp_path, document(*NODES, *twins, way(5, [1, 20, 2, 3, 21, 22])))
    assert roads.node_id.tolist() == [1, 2, 22]
    steps = np.diff(roads.lonlat_deg, axis=0)
    assert (steps != 0).any(axis=1).all()


@pytest.mark.parametrize(
    "bad",
    [
        node(2, "nan"), node(2, "91"), node(2, ""), node(2, "x"), node(2, 48, 181), node(2, "inf"),
        node(2, visible="false"), node(2, action="delete"), '<node lat="1" lon="2"/>', node(10**25), "",
    ],
)  # fmt: skip
def test_a_node_without_a_place_is_a_missing_node(tmp_path: Path, bad: str) -> None:
    roads = read(tmp_path, document(node(1), bad, node(3), node(4), way(5, [1, 2, 3, 4])))
    assert roads.node_id.tolist() == [3, 4]


def test_deleted_and_nameless_ways(tmp_path: Path) -> None:
    roads = read(
        tmp_path,
        document(*NODES, way(1, [1, 2], visible="false", version=3), way(1, [1, 2], version=2),
                 way(2, [1, 2], action="delete"), way("x", [1, 2]), way(10**30, [1, 2]), way(3, [1, 2], version="x")),
    )  # fmt: skip
    assert roads.way_id.tolist() == [3]
    assert roads.version.tolist() == [0]


@pytest.mark.parametrize(
    "stamp", ["1969-12-31T23:59:59Z", "x", "", "2023-99-01T00:00:00Z", "0001-01-01T00:00:00+14:00"]
)
def test_no_time_is_no_time(tmp_path: Path, stamp: str) -> None:
    roads = read(tmp_path, document(*NODES, way(1, [1, 2], timestamp=stamp, version=-1)))
    assert roads.timestamp.tolist() == [""]
    assert roads.version.tolist() == [0]


LAUGHS = b'<?xml version="1.0"?>\n<!DOCTYPE osm [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><osm><tag k="&b;" v=""/></osm>'


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"   \n", "holds nothing"),
        (b"lat lon\n1 2\n", "begins with"),
        (b"PK\x03\x04 zip", "begins with"),
        (b"<html><body>busy</body></html>", "<html>"),
        (b"<osm>", "line 1"),
        (document(*NODES, way(1, [1, 2]))[:-30], "line"),
        (LAUGHS, "refused"),
        (LAUGHS.decode().encode("utf-16"), "refused"),
        (b'<!DOCTYPE osm SYSTEM "file:///etc/passwd"><osm/>', "refused"),
        (b'<?xml version="1.0" encoding="nonsense"?><osm/>', "UTF-8"),
        (b"<osm><node id='1' lat='\xff'/></osm>", "line 1"),
        (gzip.compress(document(*NODES))[:-12], "gzip"),
        (gzip.compress(document(*NODES))[:40] + b"garbage" * 20, "gzip"),
        (gzip.compress(b"", mtime=0), "nothing"),
        (b"\0\0\0\x0d\n\tOSMHeader\x18\x80", "PBF"),
        (document("<remark>runtime error: Query timed out</remark>"), "did not finish"),
    ],
)
def test_no_extract_is_one_clear_line(tmp_path: Path, content: bytes, words: str) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, content)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("x.osm")


def test_an_absent_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        ingest_osm_roads(Source("x.osm", tmp_path / "x.osm"), PARAMS)


def test_a_bomb_is_refused_before_it_fills_the_memory(tmp_path: Path) -> None:
    bomb = gzip.compress(b"<osm>" + b" " * (200 << 20) + b"</osm>")
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="inflates"):
            read(tmp_path, bomb)
        assert tracemalloc.get_traced_memory()[1] < 30 << 20
    finally:
        tracemalloc.stop()


def test_gzip_in_members_and_padded(tmp_path: Path) -> None:
    content = document(*NODES, way(1, [1, 2]))
    members = gzip.compress(content[:100], mtime=0) + gzip.compress(content[100:], mtime=0) + b"\0" * 100
    assert same(read(tmp_path, content), read(tmp_path, members))


@pytest.fixture(scope="module")
def small_pbf(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("pbf")
    elements = [*(node(i, version=1, timestamp="2020-01-01T00:00:00Z") for i in range(1, 9)),
                way(3, [1, 2, 99, 3], version=2, timestamp="2021-02-03T04:05:06Z"),
                way(4, [5, 6, 7], {"highway": "primary", "name": "ß"}, version=1, timestamp="2021-02-03T04:05:06Z"),
                way(5, [5, 6, 7], {"highway": "path"}, version=1, timestamp="2021-02-03T04:05:06Z")]  # fmt: skip
    xml, pbf = folder / "a.osm", folder / "a.osm.pbf"
    xml.write_bytes(document(*elements))
    with osmium.SimpleWriter(str(pbf)) as writer:
        for element in osmium.FileProcessor(str(xml)):
            writer.add(element)
    return xml, pbf


def test_pbf_says_the_same_as_xml(small_pbf: tuple[Path, Path], tmp_path: Path) -> None:
    xml, pbf = small_pbf
    roads = read(tmp_path, pbf.read_bytes(), "named-otherwise")
    assert roads.way_id.tolist() == [3, 4]
    assert same(roads, read(tmp_path, xml.read_bytes()))


def test_damaged_pbf_never_ends_otherwise_than_in_one_line(
    small_pbf: tuple[Path, Path], tmp_path: Path
) -> None:
    good = small_pbf[1].read_bytes()
    chance = random.Random(5)
    refused = 0
    for _ in range(150):
        bad = bytearray(good[: chance.randrange(20, len(good) + 1)])
        for _ in range(chance.randrange(1, 6)):
            bad[chance.randrange(14, len(bad))] = chance.randrange(256)
        try:
            read(tmp_path, bytes(bad))
        except InputError:
            refused += 1
    assert refused > 100


def test_real_extracts_against_libosmium(shared_data: Path) -> None:
    for name in ("garching/osm_2023.osm", "garching/osm_2016.osm", "osm/liechtenstein.osm.pbf"):
        path = shared_data / name
        roads = ingest_osm_roads(Source(path.name, path), PARAMS)
        lengths = {
            w.id: len(w.nodes)
            for w in osmium.FileProcessor(str(path), osmium.osm.WAY).with_filter(
                osmium.filter.KeyFilter("highway")
            )
            if w.tags["highway"] in PARAMS.highways and w.tags.get("area") != "yes"
        }
        assert roads.way_id.tolist() == sorted(lengths)
        assert roads.note is not None
        whole = roads.note == ""
        assert (
            np.diff(roads.offset)[whole] == [lengths[i] for i in roads.way_id[whole].tolist()]
        ).mean() > 0.99
        assert (roads.version > 0).all()
        assert all(t.endswith("Z") for t in roads.timestamp)


def test_a_real_road_to_the_digit(shared_data: Path) -> None:
    path = shared_data / "garching/osm_2023.osm"
    roads = ingest_osm_roads(Source(path.name, path), PARAMS)
    root = etree.parse(path).getroot()
    place = {n.get("id"): (float(n.get("lon")), float(n.get("lat"))) for n in root.iter("node")}
    for i in (0, 100, len(roads) - 1):
        element = root.find(f"way[@id='{roads.way_id[i]}']")
        refs = [nd.get("ref") for nd in element.iter("nd")]
        part = slice(int(roads.offset[i]), int(roads.offset[i + 1]))
        assert roads.node_id[part].tolist() == [int(r) for r in refs]
        assert [tuple(p) for p in roads.lonlat_deg[part].tolist()] == [place[r] for r in refs]
        assert roads.tags.of_element(i) == {t.get("k"): t.get("v") for t in element.iter("tag")}


def test_a_real_gzip(shared_data: Path) -> None:
    path = shared_data / "osm/kaiserslautern.osm.gz"
    roads = ingest_osm_roads(Source(path.name, path), PARAMS)
    assert len(roads) > 2000
    assert set(roads.timestamp) == {""}
    assert (np.abs(roads.lonlat_deg - (7.77, 49.44)) < 1).all()


def test_a_pbf_that_claims_more_than_it_can_hold(
    tmp_path: Path,
) -> None:
    ways = [way(i, [1, 2] * 900, version=1, timestamp="2021-02-03T04:05:06Z") for i in range(1, 700)]
    xml, pbf = tmp_path / "b.osm", tmp_path / "b.osm.pbf"
    xml.write_bytes(document(node(1), node(2), *ways))
    with osmium.SimpleWriter(str(pbf)) as writer:
        for element in osmium.FileProcessor(str(xml)):
            writer.add(element)
    assert pbf.stat().st_size < 60_000
    with pytest.raises(InputError, match="more ways and nodes than its size"):
        ingest_osm_roads(Source("b.osm.pbf", pbf), PARAMS)
