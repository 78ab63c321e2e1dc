"""OSM XML out: the same document gives the same bytes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

import numpy as np

from flexmap_tasks.errors import InputError
from flexmap_tasks.model.arrays import Ints
from flexmap_tasks.model.osm import OsmDocument, OsmRelations, OsmWays, Tags

_SPECIAL = re.compile('[&<>"\t\n\r]')
_ILLEGAL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")
# Tabs and line ends are written as references: a reader turns bare ones in attributes into spaces.
_ESCAPE = str.maketrans(
    {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\t": "&#9;", "\n": "&#10;", "\r": "&#13;"}
)


def write_osm_xml(document: OsmDocument) -> bytes:
    """The document as UTF-8 XML: elements by `position`, attributes in their order, the id first; of the
    root, version and generator first.

    Raises InputError where a text holds a character that XML cannot carry.
    """
    nodes, ways, relations = document.nodes, document.ways, document.relations
    none = np.zeros(len(nodes.id) + 1, dtype=np.int64)
    elements = [
        *_elements("node", nodes.id, nodes.attributes, none, [], nodes.tags),
        *_elements("way", ways.id, ways.attributes, ways.offset, _refs(ways), ways.tags),
        *_elements(
            "relation",
            relations.id,
            relations.attributes,
            relations.offset,
            _members(relations),
            relations.tags,
        ),
        *(f"  {xml}\n" for xml in document.other_xml),
    ]
    position = np.concatenate([nodes.position, ways.position, relations.position, document.other_position])
    order = np.argsort(position, kind="stable")
    # The root's attributes have no order of their own: they travel through the store as a mapping.
    keys = sorted(document.root, key=lambda key: (key != "version", key != "generator", key))
    root = "".join(_attributes(keys, [document.root[key] for key in keys]))
    body = "".join([elements[i] for i in order])
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<osm{root}>\n{body}</osm>\n'.encode()


def _elements(
    name: str, ids: Ints, attributes: Tags, item_offset: Ints, items: list[str], tags: Tags
) -> Iterator[str]:
    attribute = _attributes(attributes.key, attributes.value)
    tag = [
        f'    <tag k="{k}" v="{v}"/>\n' for k, v in zip(_escaped(tags.key), _escaped(tags.value), strict=True)
    ]
    a, i, t = attributes.offset.tolist(), item_offset.tolist(), tags.offset.tolist()
    for n, number in enumerate(ids.tolist()):
        head = f'  <{name} id="{number}"{"".join(attribute[a[n] : a[n + 1]])}'
        inner = "".join(items[i[n] : i[n + 1]]) + "".join(tag[t[n] : t[n + 1]])
        yield f"{head}>\n{inner}  </{name}>\n" if inner else f"{head}/>\n"


def _refs(ways: OsmWays) -> list[str]:
    return [f'    <nd ref="{ref}"/>\n' for ref in ways.ref.tolist()]


def _members(relations: OsmRelations) -> list[str]:
    columns = (
        _escaped(relations.member_type),
        relations.member_ref.tolist(),
        _escaped(relations.member_role),
    )
    return [f'    <member type="{t}" ref="{ref}" role="{r}"/>\n' for t, ref, r in zip(*columns, strict=True)]


def _attributes(keys: Iterable[str], values: Iterable[str]) -> list[str]:
    return [f' {k}="{v}"' for k, v in zip(keys, _escaped(values), strict=True)]


def _escaped(values: Iterable[str]) -> list[str]:
    texts = list(values)
    everything = "".join(texts)
    illegal = _ILLEGAL.search(everything)
    if illegal:
        text = next(t for t in texts if illegal[0] in t)
        raise InputError(
            "lanelet2_map.osm", f"XML cannot carry the character {illegal[0]!r} of {text[:40]!r}"
        )
    if not _SPECIAL.search(everything):
        return texts
    return [t.translate(_ESCAPE) if _SPECIAL.search(t) else t for t in texts]
