"""OSM XML through the full XML parser: any well-formed file, and one clear line for any other."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from lxml import etree

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.osm_xml_rules import lonlat_deg
from flexmap_tasks.model.arrays import Ints, strings
from flexmap_tasks.model.osm import OsmDocument, OsmNodes, OsmRelations, OsmWays, Tags

INTEGER = re.compile(r"[+-]?[0-9]{1,19}", re.ASCII)
_CHILDREN = {"node": ("tag",), "way": ("nd", "tag"), "relation": ("member", "tag")}
_ATTRIBUTES = {"tag": ("k", "v"), "nd": ("ref",), "member": ("type", "ref", "role")}
_OPTIONAL = {"role": ""}


def parse_dom(data: bytes, name: str, *, lossless: bool) -> OsmDocument:
    """The document, element by element; errors name the line."""
    root = _root(data, name)
    kinds: dict[str, list[etree._Element]] = {"node": [], "way": [], "relation": []}
    position: dict[str, list[int]] = {"node": [], "way": [], "relation": []}
    other: list[str] = []
    other_position: list[int] = []
    for place, element in enumerate(root):
        tag = element.tag if isinstance(element.tag, str) else ""
        if tag in kinds:
            kinds[tag].append(element)
            position[tag].append(place)
        elif tag or isinstance(element, etree._Comment | etree._ProcessingInstruction):
            other.append(_text_of(element))
            other_position.append(place)
    read = _Reader(name, lossless)
    return OsmDocument(
        root={str(k): str(v) for k, v in root.attrib.items() if not str(k).startswith("{")},
        nodes=read.nodes(kinds["node"], position["node"]),
        ways=read.ways(kinds["way"], position["way"]),
        relations=read.relations(kinds["relation"], position["relation"]),
        other_xml=strings(other),
        other_position=np.array(other_position, dtype=np.int64),
    )


def canonical_xml(fragment: bytes) -> str | None:
    """One element alone as this module writes it; None where it is no well-formed XML by itself."""
    try:
        return _text_of(etree.fromstring(fragment, _parser()))
    except etree.XMLSyntaxError:
        return None


def _text_of(element: etree._Element) -> str:
    return etree.tostring(element, encoding="unicode", with_tail=False)


def _parser() -> etree.XMLParser:
    return etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, strip_cdata=True)


def _root(data: bytes, name: str) -> etree._Element:
    try:
        root = etree.fromstring(data, _parser())
    except etree.XMLSyntaxError as error:
        where = f"line {error.lineno}" if error.lineno else None
        found = (error.msg or "nothing to read").split(", line ")[0]
        raise InputError(name, f"no complete XML: {found}; the file is damaged or cut off", where) from None
    if root.tag != "osm":
        raise InputError(
            name, f"expected an OSM file with the root element <osm>, found <{root.tag!s}>", "line 1"
        )
    return root


class _Reader:
    """Reads elements of one file."""

    def __init__(self, name: str, lossless: bool) -> None:
        self.name, self.lossless = name, lossless

    def nodes(self, elements: list[etree._Element], position: list[int]) -> OsmNodes:
        attributes = self.attributes(elements)
        ids = self.ids(elements)
        return OsmNodes(
            id=ids,
            lonlat_deg=lonlat_deg(self.name, ids, attributes),
            attributes=attributes,
            tags=self.tags(elements),
            position=np.array(position, dtype=np.int64),
        )

    def ways(self, elements: list[etree._Element], position: list[int]) -> OsmWays:
        refs = [[c[0] for c in self.children(e, "nd")] for e in elements]
        return OsmWays(
            id=self.ids(elements),
            offset=_offset(refs),
            ref=self.integers([(e, r) for e, row in zip(elements, refs, strict=True) for r in row], "ref"),
            attributes=self.attributes(elements),
            tags=self.tags(elements),
            position=np.array(position, dtype=np.int64),
        )

    def relations(self, elements: list[etree._Element], position: list[int]) -> OsmRelations:
        members = [list(self.children(e, "member")) for e in elements]
        flat = [(e, m) for e, row in zip(elements, members, strict=True) for m in row]
        return OsmRelations(
            id=self.ids(elements),
            offset=_offset(members),
            member_type=strings(m[0] for _, m in flat),
            member_ref=self.integers([(e, m[1]) for e, m in flat], "ref"),
            member_role=strings(m[2] for _, m in flat),
            attributes=self.attributes(elements),
            tags=self.tags(elements),
            position=np.array(position, dtype=np.int64),
        )

    def ids(self, elements: list[etree._Element]) -> Ints:
        return self.integers([(e, e.get("id")) for e in elements], "id")

    def integers(self, values: list[tuple[etree._Element, str | None]], what: str) -> Ints:
        out = np.empty(len(values), dtype=np.int64)
        for i, (element, value) in enumerate(values):
            text = (value or "").strip()
            if not INTEGER.fullmatch(text) or not -(2**63) <= int(text) < 2**63:
                self.fail(element, f"{what} must be a whole number, found {value!r}")
            out[i] = int(text)
        return out

    def attributes(self, elements: list[etree._Element]) -> Tags:
        rows = [{str(k): str(v) for k, v in e.attrib.items() if k != "id"} for e in elements]
        for element, row in zip(elements, rows, strict=True):
            spaced = [k for k in row if k.startswith("{")]
            if spaced and self.lossless:
                self.fail(element, f"the attribute {spaced[0]} has a namespace; remove it")
            for key in spaced:
                del row[key]
        return Tags.of(rows)

    def tags(self, elements: list[etree._Element]) -> Tags:
        pairs = [list(self.children(e, "tag")) for e in elements]
        flat = [p for row in pairs for p in row]
        return Tags(_offset(pairs), strings(p[0] for p in flat), strings(p[1] for p in flat))

    def children(self, element: etree._Element, wanted: str) -> Iterator[tuple[str, ...]]:
        """The wanted attributes of all children of one name; what cannot be kept is an error when lossless."""
        names = _ATTRIBUTES[wanted]
        for child in element:
            if not isinstance(child.tag, str):
                continue
            tag, owner = str(child.tag), str(element.tag)
            if self.lossless and tag not in _CHILDREN[owner]:
                self.fail(child, f"<{tag}> inside <{owner}> is no part of a map file; remove it")
            if child.tag != wanted:
                continue
            values = tuple(child.get(n, _OPTIONAL.get(n)) for n in names)
            if None in values:
                missing = names[values.index(None)]
                self.fail(child, f"<{wanted}> needs the attribute `{missing}`")
            if self.lossless and set(child.attrib) - set(names):
                extra = sorted(str(k) for k in set(child.attrib) - set(names))[0]
                self.fail(child, f"<{wanted}> has the unknown attribute `{extra}`; remove it")
            yield tuple(str(v) for v in values)

    def fail(self, element: etree._Element, rule: str) -> None:
        owner = element if element.tag in _CHILDREN else element.getparent()
        label = f"{owner.tag!s} {owner.get('id')}" if owner is not None else str(element.tag)
        raise InputError(self.name, rule, f"line {element.sourceline} ({label})")


def _offset(rows: list[list[tuple[str, ...]]] | list[list[str]]) -> Ints:
    return np.concatenate([[0], np.cumsum([len(r) for r in rows])]).astype(np.int64)
