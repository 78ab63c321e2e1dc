"""A QGIS 3 project that shows the layers of a GeoPackage beside it, styled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lxml import etree

from flexmap_tasks.formats.clean_text import clean
from flexmap_tasks.model.layers import VectorLayer

PROJECT_VERSION = "3.34.0"


@dataclass(frozen=True, slots=True)
class Look:
    """How a layer is drawn.

    colour, outline : "r,g,b,a"; width_mm : of lines and outlines, or the size of points
    column, classes : a colour per value of a column instead of one for all
    shown : switched on when the project opens
    """

    colour: str
    outline: str
    width_mm: float
    shown: bool = True
    column: str | None = None
    classes: Mapping[str, str] | None = None


def qgis_project(
    title: str,
    package: str,
    layers: Sequence[VectorLayer],
    looks: Mapping[str, Look],
    extent: Sequence[float],
) -> bytes:
    """The project; `package` is the file name of the GeoPackage, layers from top to bottom; extent in degrees."""
    root = etree.Element("qgis", version=PROJECT_VERSION, projectname=clean(title))
    _text(root, "title", title)
    etree.SubElement(root, "projectCrs").append(_reference())
    tree = etree.SubElement(root, "layer-tree-group")
    canvas = etree.SubElement(root, "mapcanvas", name="theMapCanvas")
    _text(canvas, "units", "degrees")
    box = etree.SubElement(canvas, "extent")
    for name, value in zip(("xmin", "ymin", "xmax", "ymax"), extent, strict=True):
        _text(box, name, f"{value:.9f}")
    etree.SubElement(canvas, "destinationsrs").append(_reference())
    held = etree.SubElement(root, "projectlayers")
    order = etree.SubElement(root, "layerorder")
    for layer in layers:
        look, key = looks[layer.name], f"{layer.name}_flexmap"
        source = f"./{package}|layername={layer.name}"
        etree.SubElement(
            tree,
            "layer-tree-layer",
            id=key,
            name=layer.name,
            source=source,
            providerKey="ogr",
            checked="Qt::Checked" if look.shown else "Qt::Unchecked",
            expanded="0",
        )
        etree.SubElement(order, "layer", id=key)
        held.append(_layer(layer, look, key, source))
    content: bytes = etree.tostring(
        root, xml_declaration=True, encoding="UTF-8", pretty_print=True, doctype="<!DOCTYPE qgis>"
    )
    return content


def _layer(layer: VectorLayer, look: Look, key: str, source: str) -> Any:
    geometry = {"Point": "Point", "LineString": "Line", "Polygon": "Polygon"}[layer.kind]
    node = etree.Element("maplayer", type="vector", geometry=geometry, wkbType=layer.kind)
    _text(node, "id", key)
    _text(node, "datasource", source)
    _text(node, "layername", layer.name)
    etree.SubElement(node, "srs").append(_reference())
    provider = etree.SubElement(node, "provider", encoding="UTF-8")
    provider.text = "ogr"
    node.append(_renderer(layer, look))
    return node


def _renderer(layer: VectorLayer, look: Look) -> Any:
    if look.column is None or look.classes is None:
        node = etree.Element("renderer-v2", type="singleSymbol", enableorderby="0")
        etree.SubElement(node, "symbols").append(_symbol(layer.kind, "0", look.colour, look))
        return node
    node = etree.Element("renderer-v2", type="categorizedSymbol", attr=look.column, enableorderby="0")
    categories, symbols = etree.SubElement(node, "categories"), etree.SubElement(node, "symbols")
    for i, (value, colour) in enumerate(look.classes.items()):
        etree.SubElement(categories, "category", value=value, label=value, symbol=str(i), render="true")
        symbols.append(_symbol(layer.kind, str(i), colour, look))
    return node


def _symbol(kind: str, name: str, colour: str, look: Look) -> Any:
    word, painter = {
        "Point": ("marker", "SimpleMarker"),
        "LineString": ("line", "SimpleLine"),
        "Polygon": ("fill", "SimpleFill"),
    }[kind]
    options = {
        "marker": {
            "color": colour,
            "outline_color": look.outline,
            "size": f"{look.width_mm:g}",
            "name": "circle",
        },
        "line": {"line_color": colour, "line_width": f"{look.width_mm:g}", "capstyle": "round"},
        "fill": {"color": colour, "outline_color": look.outline, "outline_width": f"{look.width_mm:g}"},
    }[word]
    symbol = etree.Element("symbol", type=word, name=name, alpha="1", clip_to_extent="1")
    layer = etree.SubElement(
        symbol, "layer", attrib={"class": painter, "enabled": "1", "locked": "0", "pass": "0"}
    )
    held = etree.SubElement(layer, "Option", type="Map")
    for key, value in options.items():
        etree.SubElement(held, "Option", type="QString", name=key, value=value)
    return symbol


def _reference() -> Any:
    node = etree.Element("spatialrefsys", nativeFormat="Wkt")
    for name, text in (
        ("proj4", "+proj=longlat +datum=WGS84 +no_defs"),
        ("srid", "4326"),
        ("authid", "EPSG:4326"),
        ("description", "WGS 84"),
        ("ellipsoidacronym", "EPSG:7030"),
        ("geographicflag", "true"),
    ):
        _text(node, name, text)
    return node


def _text(parent: Any, name: str, text: str) -> None:
    etree.SubElement(parent, name).text = clean(text)
