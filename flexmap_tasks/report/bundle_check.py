"""The finished bundle read back as Autoware's loaders read it, with everything that would stop or mislead them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.osm_xml import parse_osm_xml
from flexmap_tasks.formats.yaml_mapping import yaml_mapping
from flexmap_tasks.geometry import mgrs, utm
from flexmap_tasks.model.arrays import Floats, Ints, Strings, strings
from flexmap_tasks.model.clouds import TileKeys
from flexmap_tasks.model.maps import Findings
from flexmap_tasks.model.osm import OsmDocument

MAP_FILE, PROJECTOR_FILE = "lanelet2_map.osm", "map_projector_info.yaml"
METADATA_FILE = "pointcloud_map_metadata.yaml"
AGREE_M = 0.01
"""How far lat/lon and local_x/local_y of a node may lie apart; both are written to a millimetre or better."""
MOST_PER_CODE = 50
"""Findings of one rule that are told one by one; the rest is counted."""

CODES = (
    "bundle-file-missing", "bundle-file-unreadable", "bundle-file-unexpected", "projector-type-unknown",
    "projector-field-missing", "metainfo-missing", "id-not-positive", "node-without-ele", "node-without-local",
    "node-without-latlon", "coordinates-disagree", "tile-not-listed", "tile-missing", "tile-misplaced",
)  # fmt: skip
"""Every rule that is checked."""

NEEDS = {"Local": (), "MGRS": ("mgrs_grid",), "LocalCartesianUTM": ("map_origin",)}
"""Fields by projector type; all but Local also need vertical_datum."""

Found = tuple[str, str, str, int, str]
"""Code, severity, primitive, id, message."""


@stage("bundle_findings")
def check_bundle(
    bundle: dict[str, bytes], cloud_metadata: dict[str, bytes] | None, tiles: TileKeys | None
) -> Findings:
    """Findings about the files of a release that Autoware loads; none for a good bundle.

    bundle : the vector map and its projector by name
    cloud_metadata, tiles : the list of tiles, and the tiles that are there; None where there is no cloud
    """
    wanted = {MAP_FILE, PROJECTOR_FILE}
    found = [_file("bundle-file-missing", f"{name} is not there") for name in sorted(wanted - set(bundle))]
    found += [
        _file("bundle-file-unexpected", f"{name[:80]} is no file Autoware knows", "warning")
        for name in sorted(set(bundle) - wanted)
    ]
    projector = yaml_mapping(bundle.get(PROJECTOR_FILE, b""))
    found += _projector(projector)
    if MAP_FILE in bundle:
        try:
            document = parse_osm_xml(bundle[MAP_FILE], MAP_FILE)
        except InputError as error:
            found.append(_file("bundle-file-unreadable", str(error)))
        else:
            found += _document(document, projector or {})
    if tiles is not None:
        found += _tiles(tiles, (cloud_metadata or {}).get(METADATA_FILE))
    return _table(found)


def _projector(projector: Mapping[str, Any] | None) -> Iterator[Found]:
    if projector is None:
        yield _file("bundle-file-unreadable", f"{PROJECTOR_FILE} is no YAML mapping")
        return
    kind = projector.get("projector_type")
    if not isinstance(kind, str) or kind not in NEEDS:
        yield _file(
            "projector-type-unknown",
            f"projector_type is {str(kind)[:40]!r}; expected one of {', '.join(NEEDS)}",
        )
        return
    for field in (*NEEDS[kind], *(() if kind == "Local" else ("vertical_datum",))):
        if not projector.get(field):
            yield _file("projector-field-missing", f"{PROJECTOR_FILE}: {kind} needs {field}")


def _document(document: OsmDocument, projector: Mapping[str, Any]) -> Iterator[Found]:
    if not any("<MetaInfo" in str(xml) for xml in document.other_xml):
        yield (
            "metainfo-missing",
            "warning",
            "map",
            0,
            "the map has no MetaInfo with format_version and map_version",
        )
    for primitive, part in (
        ("node", document.nodes),
        ("way", document.ways),
        ("relation", document.relations),
    ):
        for number in part.id[part.id <= 0].tolist():
            yield ("id-not-positive", "error", primitive, number, "Autoware's tools expect positive ids")
    nodes = document.nodes
    ele, x, y = (_numbers(nodes.tags.column(key)) for key in ("ele", "local_x", "local_y"))
    yield from _lacking("node-without-ele", nodes.id[np.isnan(ele)], "it has no usable ele")
    yield from _lacking(
        "node-without-local", nodes.id[np.isnan(x) | np.isnan(y)], "it has no local_x and local_y"
    )
    if projector.get("projector_type") == "Local":
        return
    yield from _lacking(
        "node-without-latlon", nodes.id[np.isnan(nodes.lonlat_deg).any(axis=1)], "it has no lat and lon"
    )
    apart = np.hypot(*(_projected(nodes.lonlat_deg, projector) - np.column_stack([x, y])).T)
    for row in np.flatnonzero(apart > AGREE_M).tolist():
        text = f"lat/lon and local_x/local_y lie {apart[row]:.3f} m apart"
        yield ("coordinates-disagree", "error", "node", int(nodes.id[row]), text)


def _projected(lonlat_deg: Floats, projector: Mapping[str, Any]) -> Floats:
    """(n, 2) where Autoware's projector puts latitude and longitude; NaN where it cannot say."""
    kind, out = projector.get("projector_type"), np.full(lonlat_deg.shape, np.nan)
    known = np.isfinite(lonlat_deg).all(axis=1)
    if kind == "MGRS":
        names, within = mgrs.squares(lonlat_deg[known])
        out[known] = np.where((names == str(projector.get("mgrs_grid")))[:, None], within, np.inf)
    origin = projector.get("map_origin")
    if kind == "LocalCartesianUTM" and isinstance(origin, dict):
        lon, lat = (_number(origin.get(key)) for key in ("longitude", "latitude"))
        if np.isfinite([lon, lat]).all():
            zone = utm.utm_epsg(lon, lat)
            out[known] = utm.to_utm(lonlat_deg[known], zone) - utm.to_utm(np.array([[lon, lat]]), zone)
    return out


def _tiles(tiles: TileKeys, content: bytes | None) -> Iterator[Found]:
    listed = yaml_mapping(content) if content is not None else None
    if listed is None:
        yield _file("bundle-file-missing", f"{METADATA_FILE} is not there or no YAML mapping")
        return
    step = (_number(listed.pop("x_resolution", None)), _number(listed.pop("y_resolution", None)))
    there = {f"{key}.pcd" for key in tiles.key.tolist()}
    for name in sorted(there - set(listed)):
        yield _file("tile-not-listed", f"pointcloud_map/{name} is not in {METADATA_FILE}")
    for name in sorted(set(listed) - there):
        yield _file("tile-missing", f"{METADATA_FILE} lists {name[:80]}, which is not there")
    for name in sorted(there & set(listed)):
        wanted = [float(n) * s for n, s in zip(name.removesuffix(".pcd").split("_"), step, strict=True)]
        if listed[name] != wanted:
            yield _file(
                "tile-misplaced",
                f"{name} is listed at {str(listed[name])[:60]}, by its name it lies at {wanted}",
            )


def _lacking(code: str, ids: Ints, text: str) -> Iterator[Found]:
    for number in ids.tolist():
        yield (code, "error", "node", number, text)


def _file(code: str, message: str, severity: str = "error") -> Found:
    return (code, severity, "map", 0, message)


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")


def _numbers(column: Strings) -> Floats:
    out = np.full(len(column), np.nan)
    for i, text in enumerate(column.tolist()):
        try:
            out[i] = float(text) if text else np.nan
        except ValueError:
            continue
    out[~np.isfinite(out)] = np.nan
    return out


def _table(found: list[Found]) -> Findings:
    """In order of the rules; of many alike, the first ones and how many more."""
    kept: list[Found] = []
    for code in CODES:
        alike = [f for f in found if f[0] == code]
        kept += alike[:MOST_PER_CODE]
        if len(alike) > MOST_PER_CODE:
            text = f"and {len(alike) - MOST_PER_CODE} more like this"
            kept.append((code, alike[0][1], "map", 0, text))
    return Findings(
        strings(f[0] for f in kept),
        strings(f[1] for f in kept),
        strings(f[2] for f in kept),
        np.array([f[3] for f in kept], dtype=np.int64),
        strings(f[4] for f in kept),
    )
