"""OSM XML in and out."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats import osm_xml
from flexmap_tasks.formats.osm_xml import parse_osm_xml, read_osm_xml
from flexmap_tasks.formats.osm_xml_dom import parse_dom
from flexmap_tasks.formats.osm_xml_rules import check_references, check_unique
from flexmap_tasks.formats.osm_xml_write import write_osm_xml
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.osm import OsmDocument, OsmNodes, OsmRelations, OsmWays, Tags

MAPS = ("garching/lanelet2_route_1.osm", "lanelet2/mapping_example.osm", "lanelet2/sample_map_planning.osm")

HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'
SMALL = HEAD + (
    '<osm generator="VMB">\n'
    '  <MetaInfo format_version="1" map_version="7"/>\n'
    '  <node id="1" lat="48.1" lon="11.5">\n'
    '    <tag k="ele" v="1.50"/>\n'
    "  </node>\n"
    '  <node id="-2" lat="" lon=""/>\n'
    '  <way id="1">\n'
    '    <nd ref="1"/>\n'
    '    <nd ref="-2"/>\n'
    "  </way>\n"
    '  <relation id="7" visible="true">\n'
    '    <member type="way" ref="1" role="left"/>\n'
    '    <tag k="type" v="lanelet"/>\n'
    "  </relation>\n"
    "</osm>\n"
)


def plain(value: Any) -> Any:
    """A document as nested lists, to compare and to show."""
    if dataclasses.is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return [None if v != v else v for v in value.ravel().tolist()]
    return value


TEXT = st.text(
    st.characters(exclude_categories=["Cs"], exclude_characters=[*map(chr, range(32)), "\ufffe", "\uffff"])
    | st.sampled_from("\t\n\r&<>\"'=]/"),
    max_size=8,
)
NAME = st.from_regex(r"[a-zA-Z_][a-zA-Z0-9_.-]{0,5}", fullmatch=True).filter(
    lambda n: n not in ("id", "lat", "lon", "xmlns")
)
IDS = st.integers(-(2**63) + 1, 2**63 - 1)


@st.composite
def tags_of(draw: st.DrawFn, n: int, keys: st.SearchStrategy[str]) -> Tags:
    return Tags.of(draw(st.lists(st.dictionaries(keys, TEXT, max_size=3), min_size=n, max_size=n)))


@st.composite
def documents(draw: st.DrawFn) -> OsmDocument:
    counts = [draw(st.integers(0, 4)) for _ in range(4)]
    position = iter(
        np.split(np.array(draw(st.permutations(range(sum(counts)))), dtype=np.int64), np.cumsum(counts))
    )
    ids = [
        np.array(draw(st.lists(IDS, min_size=c, max_size=c, unique=True)), dtype=np.int64) for c in counts[:3]
    ]
    n, w, r, o = counts

    def pieces(k: int) -> np.ndarray:
        sizes = draw(st.lists(st.integers(0, 3), min_size=k, max_size=k))
        return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)

    def numbers(k: int) -> np.ndarray:
        return np.array(draw(st.lists(IDS, min_size=k, max_size=k)), dtype=np.int64)

    way_offset, relation_offset = pieces(w), pieces(r)
    members = int(relation_offset[-1])
    nodes = OsmNodes(
        ids[0], np.full((n, 2), np.nan), draw(tags_of(n, NAME)), draw(tags_of(n, TEXT)), next(position)
    )
    ways = OsmWays(
        ids[1],
        way_offset,
        numbers(int(way_offset[-1])),
        draw(tags_of(w, NAME)),
        draw(tags_of(w, TEXT)),
        next(position),
    )
    relations = OsmRelations(
        ids[2], relation_offset, strings(draw(st.lists(TEXT, min_size=members, max_size=members))), numbers(members),
        strings(draw(st.lists(TEXT, min_size=members, max_size=members))), draw(tags_of(r, NAME)), draw(tags_of(r, TEXT)),
        next(position),
    )  # fmt: skip
    other = draw(
        st.lists(
            st.sampled_from(['<MetaInfo map_version="7"/>', "<note>a b</note>", "<!-- c -->"]),
            min_size=o,
            max_size=o,
        )
    )
    return in_file_order(
        OsmDocument(
            draw(st.dictionaries(NAME, TEXT, max_size=3)),
            nodes,
            ways,
            relations,
            strings(other),
            next(position),
        )
    )


def in_file_order(document: OsmDocument) -> OsmDocument:
    """Rows sorted by position, as a reader finds them."""

    def element(part: Any) -> Any:
        order = np.argsort(part.position)
        fields = {"id": part.id[order], "position": part.position[order]}
        fields |= {"attributes": part.attributes.take(order), "tags": part.tags.take(order)}
        if isinstance(part, OsmWays | OsmRelations):
            rows = [np.arange(part.offset[i], part.offset[i + 1]) for i in order]
            flat = np.concatenate(rows) if rows else np.zeros(0, dtype=np.int64)
            fields["offset"] = np.concatenate([[0], np.cumsum([len(x) for x in rows])]).astype(np.int64)
            flat_names = (
                ("ref",) if isinstance(part, OsmWays) else ("member_type", "member_ref", "member_role")
            )
            fields |= {name: getattr(part, name)[flat.astype(np.int64)] for name in flat_names}
        return dataclasses.replace(part, **fields)

    order = np.argsort(document.other_position)
    return dataclasses.replace(
        document,
        nodes=element(document.nodes),
        ways=element(document.ways),
        relations=element(document.relations),
        other_xml=document.other_xml[order],
        other_position=document.other_position[order],
    )


@given(documents())
@settings(deadline=None, max_examples=150)
def test_what_is_written_is_read_again(document: OsmDocument) -> None:
    data = write_osm_xml(document)
    assert plain(parse_dom(data, "x.osm", lossless=True)) == plain(document)
    assert plain(parse_osm_xml(data, "x.osm")) == plain(document)
    assert write_osm_xml(parse_osm_xml(data, "x.osm")) == data


def test_small_map_byte_for_byte() -> None:
    assert write_osm_xml(parse_osm_xml(SMALL.encode(), "x.osm")).decode() == SMALL


@pytest.mark.parametrize("name", MAPS)
def test_scanner_and_full_parser_agree_on_real_maps(shared_data: Path, name: str) -> None:
    data = (shared_data / name).read_bytes()
    scanned = osm_xml._parse_plain(data, name)
    assert scanned is not None
    assert plain(scanned) == plain(parse_dom(data, name, lossless=True))
    written = write_osm_xml(scanned)
    assert plain(parse_osm_xml(written, name)) == plain(scanned)
    assert write_osm_xml(parse_osm_xml(written, name)) == written


PIECES = [
    "<", ">", "/>", "</", "=", '"', "'", " ", "\n", "\t", "\r", "&amp;", "&#10;", "&#x41;", "&lt", "&", "&nope;", "&#0;",
    "<!-- c -->", "<?p i?>", "<![CDATA[x]]>", "]]>", "id", "ref", "k", "xmlns", "a:b", "0", "-", "+", "é", "\x00", "\x0b",
    "9223372036854775807", "9223372036854775808", ' id="3"', "<tag k='a' v='b'/>", "<x/>", "<x>t</x>", "</osm>", "\ufffe",
    "<!DOCTYPE osm>", "lat", "nan", " x='1'",
]  # fmt: skip


def outcome(read: Callable[[], OsmDocument | None]) -> Any:
    """The document, or the line a person would read."""
    try:
        document = read()
    except InputError as error:
        return str(error)
    return None if document is None else plain(document)


@given(
    st.lists(st.tuples(st.integers(0, len(SMALL)), st.integers(0, 6), st.sampled_from(PIECES)), max_size=4)
)
@settings(deadline=None, max_examples=600)
def test_the_scanner_never_says_other_than_the_full_parser(edits: list[tuple[int, int, str]]) -> None:
    text = SMALL
    for at, cut, piece in edits:
        text = text[:at] + piece + text[at + cut :]
    data = text.encode()
    scanned = outcome(lambda: osm_xml._parse_plain(data, "x.osm"))
    if scanned is not None:
        assert scanned == outcome(lambda: parse_dom(data, "x.osm", lossless=True))


def test_variants_of_writing_mean_the_same() -> None:
    variant = (
        "\ufeff<?xml version='1.0'?><!-- c --><osm generator='VMB'><MetaInfo format_version=\"1\" map_version='7' ></MetaInfo>"
        "<node lon = '11.5' id='1' lat='48.1'><tag v='1.5&#48;' k='&#x65;le'></tag></node><node id='-2' lat='' lon=''/>"
        "<way id='1'><nd ref='1' /><?p?><nd ref='-2'/></way>"
        "<relation id='7' visible='true'><member role='left' type='way' ref='1'/><tag k='type' v='lanelet'/></relation></osm>"
    )
    found, wanted = (
        plain(parse_osm_xml(variant.encode(), "x.osm")),
        plain(parse_osm_xml(SMALL.encode(), "x.osm")),
    )
    assert found["nodes"]["attributes"].pop("key")[:2] == ["lon", "lat"]
    for document in (found, wanted):
        document["nodes"].pop("attributes")
    assert found == wanted


def body(inner: str) -> bytes:
    return f'{HEAD}<osm version="0.6">\n{inner}\n</osm>\n'.encode()


BILLION = '<!DOCTYPE osm [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>\n<osm><node id="1" lat="&b;" lon="1"/></osm>'


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "empty"),
        (b"  \n", "empty"),
        (b"not xml at all", "no complete XML"),
        (b"\x89PNG\r\n\x1a\n" + bytes(40), "UTF-8"),
        (SMALL.encode("utf-16"), "UTF-8"),
        (SMALL.encode()[:300], "line 12: no complete XML: "),
        ((HEAD + BILLION).encode(), "line 2: a document type"),
        (b"<!-- c -->\n<!DOCTYPE osm SYSTEM 'http://localhost/x.dtd'><osm/>", "line 2: a document type"),
        (body('<node id="1" lat="&boom;" lon="1"/>'), "line 3: no complete XML"),
        (b"<gpx></gpx>", "<osm>"),
        (
            body('<node id="1.5" lat="1" lon="1"/>'),
            "line 3 (node 1.5): id must be a whole number, found '1.5'",
        ),
        (body('<node lat="1" lon="1"/>'), "id must be a whole number"),
        (body('<node id="9223372036854775808" lat="1" lon="1"/>'), "whole number"),
        (body('<way id="3">\n<nd ref="x"/></way>'), "(way 3): ref must be a whole number"),
        (body('<node id="1" lat="1,5" lon="1"/>'), "node 1: lat must be a number of degrees"),
        (body('<node id="1" lat="nan" lon="1"/>'), "node 1: lat"),
        (body('<node id="1" lat="1_0" lon="1"/>'), "node 1: lat"),
        (
            body('<node id="1" lat="1" lon="180.5"/>'),
            "node 1: lon must be a number of degrees from -180 to 180",
        ),
        (body('<node id="1" lat="91" lon="1"/>'), "node 1: lat"),
        (body('<node id="1" lat="1"/>'), "node 1: has only one of lat and lon"),
        (body('<node id="1" lat="1" lon="1"><foo/></node>'), "<foo> inside <node>"),
        (body('<way id="1"><nd ref="1" lat="3"/></way>'), "unknown attribute `lat`"),
        (body('<way id="1"><tag k="a"/></way>'), "<tag> needs the attribute `v`"),
        (("<a>" * 100_000).encode(), "no complete XML"),
        (body("<MetaInfo>" + "<a>" * 5000 + "</a>" * 5000 + "</MetaInfo>"), "no complete XML"),
    ],
)
def test_bad_files_get_one_clear_line(data: bytes, words: str) -> None:
    with pytest.raises(InputError) as error:
        parse_osm_xml(data, "map.osm")
    line = str(error.value)
    assert line.startswith("map.osm")
    assert words in line
    assert "\n" not in line


@pytest.mark.parametrize(
    ("inner", "words"),
    [
        ('<node id="1" lat="1" lon="1"/><node id="1" lat="1" lon="1"/>', "node 1: the id stands 2 times"),
        ('<way id="4"/><way id="4"/>', "way 4: the id stands 2 times"),
        ('<way id="4"><nd ref="9"/></way>', "way 4: refers to node 9"),
        ('<relation id="4"><member type="way" ref="9" role=""/></relation>', "relation 4: refers to way 9"),
        (
            '<relation id="4"><member type="lane" ref="9" role=""/></relation>',
            "relation 4: member type must be",
        ),
    ],
)
def test_ids_and_references(inner: str, words: str) -> None:
    document = parse_osm_xml(body(inner), "map.osm")
    check = check_unique if "times" in words else check_references
    with pytest.raises(InputError) as error:
        check(document, "map.osm")
    assert words in str(error.value)


def test_extracts_may_be_read_with_loss() -> None:
    document = parse_osm_xml(
        body('<way id="1"><bounds a="1"/><nd ref="1" lat="3" lon="4"/></way>'), "x", lossless=False
    )
    assert document.ways.ref.tolist() == [1]


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"map\.osm: no such file"):
        read_osm_xml(tmp_path / "nothing.osm", "map.osm")
    with pytest.raises(InputError, match=r"map\.osm: cannot be read"):
        read_osm_xml(tmp_path, "map.osm")


def test_texts_that_xml_cannot_carry_are_named() -> None:
    document = parse_osm_xml(SMALL.encode(), "x.osm")
    nodes = dataclasses.replace(
        document.nodes, tags=document.nodes.tags.with_values(np.array([0]), ["note"], ["a\x01b"])
    )
    with pytest.raises(InputError, match="cannot carry"):
        write_osm_xml(dataclasses.replace(document, nodes=nodes))
