"""KML 2.2 (OGC 07-147r2) for Google Earth and its kin: a folder per layer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from lxml import etree

from flexmap_tasks.formats.clean_text import clean
from flexmap_tasks.model.layers import VectorLayer

NAMESPACE = "http://www.opengis.net/kml/2.2"
COLOURS = {"Point": "ff00a0f0", "LineString": "ffb27200", "Polygon": "80739e00"}
"""aabbggrr."""


def kml(title: str, layers: Sequence[VectorLayer], name_columns: dict[str, str]) -> bytes:
    """The document; `name_columns` says by layer which column names its features."""
    root = etree.Element("kml", nsmap={None: NAMESPACE})
    document = etree.SubElement(root, "Document")
    _text(document, "name", title)
    for kind, colour in COLOURS.items():
        style = etree.SubElement(document, "Style", id=kind)
        _text(etree.SubElement(style, "LineStyle"), "color", colour)
        _text(etree.SubElement(style, "PolyStyle"), "color", colour)
    for layer in layers:
        folder = etree.SubElement(document, "Folder")
        _text(folder, "name", layer.name)
        names = layer.columns[name_columns[layer.name]] if layer.name in name_columns else None
        for i in range(len(layer)):
            _placemark(folder, layer, i, layer.name if names is None else str(names[i]))
    content: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return content


def _placemark(folder: Any, layer: VectorLayer, i: int, name: str) -> None:
    mark = etree.SubElement(folder, "Placemark")
    _text(mark, "name", name)
    _text(mark, "styleUrl", f"#{layer.kind}")
    data = etree.SubElement(mark, "ExtendedData")
    for key, column in layer.columns.items():
        value = column[i]
        if value is not None and value != "" and not (column.dtype.kind == "f" and np.isnan(value)):
            _text(etree.SubElement(data, "Data", name=key), "value", str(value))
    holder = etree.SubElement(mark, layer.kind)
    if layer.kind == "Polygon":
        holder = etree.SubElement(etree.SubElement(holder, "outerBoundaryIs"), "LinearRing")
    places = shapely.get_coordinates(layer.geometry[i])
    template = " ".join(["%.8f,%.8f"] * len(places))
    _text(holder, "coordinates", template % tuple(places.ravel().tolist()))


def _text(parent: Any, name: str, text: str) -> None:
    etree.SubElement(parent, name).text = clean(text)
