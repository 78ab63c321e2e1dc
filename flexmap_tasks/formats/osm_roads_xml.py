"""Roads from OpenStreetMap XML: one pass with expat, in pieces, nothing of the file expanded.

A document type declaration is refused where it begins, so no entity is ever defined.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable
from xml.parsers import expat

import numpy as np

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.osm_roads_elements import (
    NO_NODE,
    NewestWays,
    RoadElements,
    RoadWay,
    city_limit,
    land_use,
    newest_nodes,
    utc_timestamp,
)

MAX_REMARK = 500
SIGN_KEYS = ("traffic_sign", "traffic_sign:forward", "traffic_sign:backward", "direction", "city_limit")


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
    except (LookupError, ValueError) as error:
        raise InputError(name, f"expected OpenStreetMap XML in UTF-8, found: {error}") from None
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
        self._relation: list[int] | None = None
        self._signs: dict[int, dict[str, str]] = {}
        self._remark: list[str] = []
        parser.StartElementHandler = self._root
        parser.StartDoctypeDeclHandler = self._refuse

    def _refuse(self, *_: object) -> None:
        rule = "document type declarations and entities are refused; remove the <!DOCTYPE ...>"
        raise InputError(self._name, rule, f"line {self._parser.CurrentLineNumber}")

    def _root(self, tag: str, _: dict[str, str]) -> None:
        if tag != "osm":
            rule = (
                f"expected an OpenStreetMap document <osm>, found <{tag[:40]}>; give an .osm or .osm.pbf file"
            )
            raise InputError(self._name, rule, f"line {self._parser.CurrentLineNumber}")
        self._parser.StartElementHandler = self._start

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        if tag == "node":
            self._node(attributes)
        elif tag == "nd":
            if self._way is not None:
                self._refs.append(attributes.get("ref", ""))
        elif tag == "tag":
            if self._way is not None or self._relation is not None:
                self._tags[attributes.get("k", "")] = attributes.get("v", "")
            elif attributes.get("k") in SIGN_KEYS and self._id:
                self._signs.setdefault(self._id[-1], {})[attributes["k"]] = attributes.get("v", "")
        elif tag == "way":
            self._way, self._refs, self._tags = attributes, [], {}
            self._parser.EndElementHandler = self._end
        elif tag == "member":
            if (
                self._relation is not None
                and attributes.get("type") == "way"
                and attributes.get("role") != "inner"
            ):
                self._relation.append(_reference(attributes.get("ref", "")))
        elif tag == "relation":
            self._relation, self._tags = [], {}
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
        elif tag == "relation" and self._relation is not None:
            use = land_use(self._tags)
            if use is not None:
                self._newest.groups.append((use, tuple(self._relation)))
            self._relation = None
        elif tag == "remark":
            self._parser.CharacterDataHandler = None
        else:
            return
        self._parser.EndElementHandler = None

    def _node(self, attributes: dict[str, str]) -> None:
        try:
            node = int(attributes["id"])
        except (KeyError, ValueError):
            return
        if not NO_NODE < node < -NO_NODE:
            return
        try:
            lat, lon = float(attributes["lat"]), float(attributes["lon"])
        except (KeyError, ValueError):
            lat = lon = math.nan
        if _deleted(attributes):
            lat = lon = math.nan
        self._id.append(node)
        self._lat.append(lat)
        self._lon.append(lon)
        self._version.append(_version(attributes))

    def _finish_way(self, attributes: dict[str, str]) -> None:
        way_id = _reference(attributes.get("id", ""))
        if way_id == NO_NODE:
            return
        version = _version(attributes)
        if not _deleted(attributes) and self._newest.is_road(self._tags):
            stamp = utc_timestamp(attributes.get("timestamp", ""))
            refs, tags = tuple(map(_reference, self._refs)), tuple(sorted(self._tags.items()))
            self._newest.add(way_id, RoadWay(version, stamp, True, refs, tags))
            return
        bounds = not _deleted(attributes) and self._newest.bounds_land(self._tags)
        refs = tuple(map(_reference, self._refs)) if bounds else ()
        use = land_use(self._tags)
        if bounds and use is not None:
            self._newest.uses[way_id] = use
        self._newest.add(way_id, RoadWay(version, "", False, refs))

    def finish(self) -> RoadElements:
        """All that was read."""
        ids = np.frombuffer(self._id, dtype=np.int64)
        versions = np.frombuffer(self._version, dtype=np.int64)
        lonlat = np.column_stack([np.frombuffer(self._lon), np.frombuffer(self._lat)])
        node_id, lonlat = newest_nodes(ids, versions, lonlat)
        limits = {node: city_limit(tags) for node, tags in self._signs.items()}
        return RoadElements(
            self._newest.ways,
            node_id,
            lonlat,
            " ".join("".join(self._remark).split()),
            self._newest.lands(),
            {node: sense for node, sense in limits.items() if sense},
        )


def _deleted(attributes: dict[str, str]) -> bool:
    return attributes.get("visible") == "false" or attributes.get("action") == "delete"


def _reference(text: str) -> int:
    """The id in the text, NO_NODE where it is no number of 64 bits."""
    try:
        number = int(text)
    except ValueError:
        return NO_NODE
    return number if NO_NODE < number < -NO_NODE else NO_NODE


def _version(attributes: dict[str, str]) -> int:
    """The version, 0 where there is none."""
    number = _reference(attributes.get("version", "0"))
    return number if 0 < number < 2**31 else 0
