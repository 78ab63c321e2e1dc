"""OSM XML in: the shape that Lanelet2 maps and OpenStreetMap share, read without loss.

The plain form goes through a scanner, anything else through the full XML parser; both give the same document.
Kept is all that means something: elements of any kind and comments at the top level with their order, attributes,
tags, references. White space, and comments inside an element, are not.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats import osm_xml_kernel as kernel
from flexmap_tasks.formats import osm_xml_scan as scanner
from flexmap_tasks.formats.osm_xml_dom import canonical_xml, parse_dom
from flexmap_tasks.formats.osm_xml_rules import lonlat_deg
from flexmap_tasks.model.arrays import Ints, Strings, strings
from flexmap_tasks.model.osm import OsmDocument, OsmNodes, OsmRelations, OsmWays, Tags

_DECLARATION = re.compile(
    rb"""(?:\xef\xbb\xbf)?
    (?:<\?xml[ \t\r\n]+version[ \t\r\n]*=[ \t\r\n]*["']1\.0["']
        (?:[ \t\r\n]+encoding[ \t\r\n]*=[ \t\r\n]*["'](?P<encoding>[A-Za-z0-9._-]+)["'])?
        (?:[ \t\r\n]+standalone[ \t\r\n]*=[ \t\r\n]*["'](?:yes|no)["'])?
    [ \t\r\n]*\?>)?[ \t\r\n]*""",
    re.VERBOSE,
)
_PROLOG = re.compile(rb"(?:\xef\xbb\xbf)?(?:[ \t\r\n]+|<\?.*?\?>|<!--.*?-->)*", re.DOTALL)
_REFERENCE = re.compile(r"&(?:(amp|lt|gt|quot|apos)|#([0-9]{1,7})|#x([0-9a-fA-F]{1,6}));")
_NAMED = {"amp": "&", "lt": "<", "gt": ">", "quot": '"', "apos": "'"}


def read_osm_xml(path: Path, name: str, *, lossless: bool = True) -> OsmDocument:
    """Read a file; `name` stands in errors. See `parse_osm_xml`."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(name, "no such file") from None
    except OSError as error:
        raise InputError(name, f"cannot be read: {error.strerror}") from None
    return parse_osm_xml(data, name, lossless=lossless)


def parse_osm_xml(data: bytes, name: str, *, lossless: bool = True) -> OsmDocument:
    """The document in `data`, UTF-8 XML.

    With `lossless`, what has no place in `OsmDocument` (children other than tag, nd and member, unknown
    attributes on these) is an error; without, it is left out, as for extracts that are only read.
    Raises InputError for anything that is no OSM XML, for a document type (nothing is expanded), ids that
    are no numbers, and lat or lon out of range.
    """
    if not data or data.isspace():
        raise InputError(name, "the file is empty")
    _refuse(data, name)
    document = _parse_plain(data, name)
    return document if document is not None else parse_dom(data, name, lossless=lossless)


def _refuse(data: bytes, name: str) -> None:
    """No other encoding, and no document type: entities could name files, hosts, or grow without bound."""
    if data[:4096].count(b"\0"):
        raise InputError(name, "expected XML in UTF-8, found zero bytes; convert the file to UTF-8", "line 1")
    prolog = _PROLOG.match(data)
    end = prolog.end() if prolog else 0
    if data[end : end + 9].upper() == b"<!DOCTYPE":
        line = data.count(b"\n", 0, end) + 1
        raise InputError(name, "a document type (<!DOCTYPE>) is not allowed; remove it", f"line {line}")


def _parse_plain(data: bytes, name: str) -> OsmDocument | None:
    """The document by the scanner, None where the file is not of the plain form."""
    declaration = _DECLARATION.match(data)
    encoding = (declaration["encoding"] or b"utf-8" if declaration else b"").lower()
    if declaration is None or encoding not in (b"utf-8", b"us-ascii") or not _valid_text(data):
        return None
    found = scanner.scan(np.frombuffer(data + b"\0", dtype=np.uint8), declaration.end())
    if found is None:
        return None
    texts = _texts(data, found.text)
    other = np.flatnonzero(found.element[:, 0] == kernel.OTHER)
    others = [canonical_xml(data[a:b]) for a, b in found.element[other, 5:].tolist()]
    if texts is None or None in others:
        return None
    return _assemble(found, texts, other, strings(others), name)


def _valid_text(data: bytes) -> bool:
    """UTF-8 without the two characters that XML forbids."""
    if data.isascii():
        return True
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return b"\xef\xbf\xbe" not in data and b"\xef\xbf\xbf" not in data


def _texts(data: bytes, span: Ints) -> Strings | None:
    """All texts with references resolved; None where one is no plain reference."""
    spans = zip(span[:, 0].tolist(), span[:, 1].tolist(), strict=True)
    if data.isascii():
        text = data.decode("ascii")
        out = [text[a:b] for a, b in spans]
    else:
        out = [data[a:b].decode() for a, b in spans]
    if b"&" in data:
        for i in [i for i, t in enumerate(out) if "&" in t]:
            resolved = _resolve(out[i])
            if resolved is None:
                return None
            out[i] = resolved
    return strings(out)


def _resolve(text: str) -> str | None:
    """Text with its references replaced; None where an ampersand begins none, or it names no character."""
    parts: list[str] = []
    at = 0
    while (amp := text.find("&", at)) >= 0:
        match = _REFERENCE.match(text, amp)
        if match is None:
            return None
        named, decimal, hexadecimal = match.groups()
        code = ord(_NAMED[named]) if named else int(decimal) if decimal else int(hexadecimal, 16)
        if not (
            code in (9, 10, 13)
            or 32 <= code < 0xD800
            or 0xE000 <= code < 0xFFFE
            or 0x10000 <= code < 0x110000
        ):
            return None
        parts += [text[at:amp], chr(code)]
        at = match.end()
    return "".join([*parts, text[at:]])


def _assemble(found: scanner.Scan, texts: Strings, other: Ints, others: Strings, name: str) -> OsmDocument:
    kind, ids, attribute_end, tag_end, item_end = found.element[:, :5].T.copy()
    nodes, ways, relations = (np.flatnonzero(kind == k) for k in (kernel.NODE, kernel.WAY, kernel.RELATION))
    attributes = [_tags(attribute_end, found.attribute, rows, texts) for rows in (nodes, ways, relations)]
    tags = [_tags(tag_end, found.tag, rows, texts) for rows in (nodes, ways, relations)]
    way_offset, way_items = _share(item_end, ways)
    offset, items = _share(item_end, relations)
    lonlat = lonlat_deg(name, ids[nodes], attributes[0])
    ref, member = found.item[:, 0].copy(), found.item[items, 1:]
    return OsmDocument(
        root={texts[k]: texts[v] for k, v in found.root.tolist()},
        nodes=OsmNodes(ids[nodes], lonlat, attributes[0], tags[0], nodes),
        ways=OsmWays(ids[ways], way_offset, ref[way_items], attributes[1], tags[1], ways),
        relations=OsmRelations(
            ids[relations],
            offset,
            texts[member[:, 0]],
            ref[items],
            texts[member[:, 1]],
            attributes[2],
            tags[2],
            relations,
        ),
        other_xml=others,
        other_position=other,
    )


def _share(end: Ints, rows: Ints) -> tuple[Ints, Ints]:
    """(offset, flat positions) of what belongs to the given elements, where element i ends at end[i]."""
    start = np.concatenate([[0], end[:-1]])[rows] if len(rows) else np.zeros(0, dtype=np.int64)
    size = end[rows] - start
    offset = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
    return offset, np.repeat(start - offset[:-1], size) + np.arange(offset[-1])


def _tags(end: Ints, pairs: NDArray[np.int32], rows: Ints, texts: Strings) -> Tags:
    offset, flat = _share(end, rows)
    return Tags(offset, texts[pairs[flat, 0]], texts[pairs[flat, 1]])
