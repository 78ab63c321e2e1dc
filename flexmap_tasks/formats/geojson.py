"""GeoJSON (RFC 7946): longitude and latitude, polygons counter-clockwise."""

from __future__ import annotations

import json
from itertools import pairwise

import numpy as np
import shapely

from flexmap_tasks.formats.json_text import SLOT, json_rows, json_texts
from flexmap_tasks.model.layers import VectorLayer

DECIMALS = 8
"""Of a degree: a millimetre."""


def geojson(layer: VectorLayer) -> bytes:
    """One feature per line, so that two versions can be compared by eye."""
    named = ",".join(f"{json.dumps(name)}:{SLOT}" for name in layer.columns)
    geometry = f'{{"type":"{layer.kind}","coordinates":{SLOT}}}'
    properties = (json_texts(column, missing=True) for column in layer.columns.values())
    rows = json_rows(
        f'{{"type":"Feature","geometry":{geometry},"properties":{{{named}}}}}',
        _coordinates(layer),
        *properties,
    )
    name, body = json.dumps(layer.name), ",\n".join(rows)
    return f'{{"type":"FeatureCollection","name":{name},"features":[\n{body}\n]}}\n'.encode()


def _coordinates(layer: VectorLayer) -> list[str]:
    """The coordinates of every feature as JSON."""
    geometry = shapely.orient_polygons(layer.geometry) if layer.kind == "Polygon" else layer.geometry
    flat, row = shapely.get_coordinates(geometry, return_index=True)
    flat = np.round(flat, DECIMALS)
    places = json_rows(f"[{SLOT},{SLOT}]", json_texts(flat[:, 0]), json_texts(flat[:, 1]))
    if layer.kind == "Point":
        return places
    starts = np.searchsorted(row, np.arange(len(layer) + 1)).tolist()
    lines = [f"[{','.join(places[a:b])}]" for a, b in pairwise(starts)]
    return [f"[{line}]" for line in lines] if layer.kind == "Polygon" else lines
