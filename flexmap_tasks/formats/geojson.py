"""GeoJSON (RFC 7946): longitude and latitude, polygons counter-clockwise."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import Any

import numpy as np
import shapely

from flexmap_tasks.formats.clean_text import clean
from flexmap_tasks.model.layers import VectorLayer

DECIMALS = 8
"""Of a degree: a millimetre."""


def geojson(layer: VectorLayer) -> bytes:
    """One feature per line, so that two versions can be compared by eye."""
    columns = {name: column.tolist() for name, column in layer.columns.items()}
    rows = [
        json.dumps(
            {
                "type": "Feature",
                "geometry": shape,
                "properties": {k: _plain(v[i]) for k, v in columns.items()},
            },
            ensure_ascii=False,
            separators=(",", ":"),
            allow_nan=False,
        )
        for i, shape in enumerate(_shapes(layer))
    ]
    name = json.dumps(layer.name)
    body = ",\n".join(rows)
    return f'{{"type":"FeatureCollection","name":{name},"features":[\n{body}\n]}}\n'.encode()


def _shapes(layer: VectorLayer) -> list[dict[str, Any]]:
    geometry = shapely.orient_polygons(layer.geometry) if layer.kind == "Polygon" else layer.geometry
    flat, row = shapely.get_coordinates(geometry, return_index=True)
    places = np.round(flat, DECIMALS).tolist()
    starts = np.searchsorted(row, np.arange(len(layer) + 1)).tolist()
    lines = [places[a:b] for a, b in pairwise(starts)]
    return [{"type": layer.kind, "coordinates": _nested(layer.kind, line)} for line in lines]


def _nested(kind: str, line: list[list[float]]) -> Any:
    return line[0] if kind == "Point" else [line] if kind == "Polygon" else line


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return None if np.isnan(value) else value
    return clean(value) if isinstance(value, str) else value
