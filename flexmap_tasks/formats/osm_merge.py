"""Several OpenStreetMap XML extracts as one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lxml import etree

from flexmap_tasks.errors import InputError

KINDS = ("node", "way", "relation")


def merge_extracts(name: str, extracts: Sequence[bytes]) -> bytes:
    """Each element once, its newest version, nodes before ways before relations, by id.

    Raises InputError when a part is no OpenStreetMap XML.
    """
    newest: dict[tuple[int, int], tuple[int, Any]] = {}
    attributes: dict[str, str] = {"version": "0.6"}
    for extract in extracts:
        root = _parse(name, extract)
        attributes |= {k: v for k, v in root.attrib.items() if k in {"generator", "copyright", "license"}}
        for element in root.iterchildren(*KINDS):
            try:
                key = KINDS.index(element.tag), int(element.get("id", ""))
                version = int(element.get("version", "0"))
            except ValueError:
                continue
            if key not in newest or newest[key][0] < version:
                newest[key] = version, element
    merged = etree.Element("osm", attributes)
    for key in sorted(newest):
        merged.append(newest[key][1])
    return etree.tostring(merged, xml_declaration=True, encoding="UTF-8")


def _parse(name: str, content: bytes) -> Any:
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, remove_blank_text=True)
    try:
        root = etree.fromstring(content, parser)
    except etree.XMLSyntaxError as error:
        raise InputError(name, f"expected OpenStreetMap XML ({error.msg})") from None
    if root.tag != "osm" or root.getroottree().docinfo.doctype:
        raise InputError(name, "expected OpenStreetMap XML without a document type declaration")
    return root
