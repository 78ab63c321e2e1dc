"""Roads from OpenStreetMap XML: one pass with expat, in pieces, nothing of the file expanded.

A document type declaration is refused where it begins, so no entity is ever defined.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from typing import cast
from xml.parsers import expat

import numpy as np

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.osm_roads_elements import NewestWays, RoadElements, utc_timestamp
from flexmap_tasks.model.arrays import Floats, Ints

MAX_REMARK = 500


def read_xml_roads(name: str, pieces: Iterable[bytes], highways: frozenset[str]) -> RoadElements:
    """The roads of an XML document given in pieces.

    Raises InputError for anything that is no well-formed <osm> document, with the line.
    """
    parser = expat.ParserCreate()
    reader = _Reader(name, parser, highways)
    try:
        for piece in pieces:
            parser.Parse(piece, False)
        parser.Parse(b"", True)
    except expat.ExpatError as error:
        reason = expat.errors.messages[error.code]
        rule = f"expected OpenStreetMap XML, found {reason}; the file is damaged or cut off, fetch it again"
        raise InputError(name, rule, f"line {error.lineno}") from None
    return reader.finish()


class _Reader:
    """Handlers of one document. Broken nodes are missing nodes; broken ways are no ways."""

    def __init__(self, name: str, parser: expat.XMLParserType, highways: frozenset[str]) -> None:
        self._name, self._parser = name, parser
        self._newest = NewestWays(highways)
        self._id, self._version = array("q"), array("q")
        self._lat, self._lon = array("d"), array("d")
        self._way: dict[str, str] | None = None
        self._refs: list[str] = []
        self._tags: dict[str, str] = {}
        self._remark: list[str] = []
        parser.StartElementHandler = self._root
        parser.StartDoctypeDeclHandler = self._refuse
        parser.buffer_text = True

    def _refuse(self, *_: object) -> None:
        rule = "document type declarations and entities are refused; remove the <!DOCTYPE ...>"
        raise InputError(self._name, rule, f"line {self._parser.CurrentLineNumber}")

    def _root(self, tag: str, _: dict[str, str]) -> None:
        if tag != "osm":
            rule = f"expected an OpenStreetMap document <osm>, found <{tag[:40]}>; give an .osm or .osm.pbf file"
            raise InputError(self._name, rule, f"line {self._parser.CurrentLineNumber}")
        self._parser.StartElementHandler = self._start

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        if tag == "node":
            self._node(attributes)
        elif tag == "nd":
            if self._way is not None:
                self._refs.append(attributes.get("ref", ""))
        elif tag == "tag":
            if self._way is not None:
                self._tags[attributes.get("k", "")] = attributes.get("v", "")
        elif tag == "way":
            self._way, self._refs, self._tags = attributes, [], {}
            self._parser.EndElementHandler = self._end
        elif tag == "remark":
            self._parser.CharacterDataHandler = self._text
            self._parser.EndElementHandler = self._end

    def _text(self, text: str) -> None:
        if sum(map(len, self._remark)) < MAX_REMARK:
            self._remark.append(text[:MAX_REMARK])

    def _end(self, tag: str) -> None:
        if tag == "way" and self._way is not None:
            self._finish_way(self._way)
            self._way = None
        elif tag == "remark":
            self._parser.CharacterDataHandler = None
        else:
            return
        self._parser.EndElementHandler = None

    def _node(self, attributes: dict[str, str]) -> None:
        try:
            node = int(attributes["id"])
            lat, lon = float(attributes["lat"]), float(attributes["lon"])
        except (KeyError, ValueError):
            if not _deleted(attributes):
                return
            lat = lon = float("nan")
            node = _whole(attributes.get("id", ""))
        if _deleted(attributes):
            lat = lon = float("nan")
        if -(2**63) <= node < 2**63:
            self._id.append(node)
            self._lat.append(lat)
            self._lon.append(lon)
            self._version.append(_whole(attributes.get("version", "")))

    def _finish_way(self, way: dict[str, str]) -> None:
        try:
            way_id = int(way["id"])
            refs = tuple(map(int, self._refs))
        except (KeyError, ValueError):
            return
        if not -(2**63) <= way_id < 2**63:
            return
        stamp = utc_timestamp(way.get("timestamp", ""))
        version = _whole(way.get("version", ""))
        self._newest.add(way_id, version, stamp, not _deleted(way), refs, self._tags)

    def finish(self) -> RoadElements:
        """All that was read."""
        ids = np.frombuffer(self._id, dtype=np.int64)
        versions = np.frombuffer(self._version, dtype=np.int64)
        lonlat = np.column_stack([np.frombuffer(self._lon), np.frombuffer(self._lat)])
        node_id, lonlat = newest_nodes(ids, versions, lonlat)
        return RoadElements(self._newest.ways, node_id, lonlat, " ".join("".join(self._remark).split()))


def newest_nodes(ids: Ints, versions: Ints, lonlat_deg: Floats) -> tuple[Ints, Floats]:
    """Of every node the newest state, by id, unless that has no usable position.

    ids, versions : (n,) in any order; lonlat_deg : (n, 2), NaN for a deleted node
    """
    order = np.lexsort((lonlat_deg[:, 1], lonlat_deg[:, 0], versions, ids))
    ids, lonlat_deg = ids[order], lonlat_deg[order]
    newest = np.append(ids[1:] != ids[:-1], [True] * bool(len(ids))).astype(bool)
    usable = (np.abs(lonlat_deg) <= (180.0, 90.0)).all(axis=1)
    keep = newest & usable
    return ids[keep], lonlat_deg[keep]


def _deleted(attributes: dict[str, str]) -> bool:
    return attributes.get("visible") == "false" or attributes.get("action") == "delete"


def _whole(text: str) -> int:
    """The number in the text if it fits 32 bits, else 0."""
    try:
        number = int(text)
    except ValueError:
        return 0
    return cast("int", number) if abs(number) < 2**31 else 0
