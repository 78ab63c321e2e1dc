"""The finished map as Autoware loads it: `lanelet2_map.osm` and `map_projector_info.yaml`."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from flexmap_tasks.config import GeoreferenceParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import CoverageError
from flexmap_tasks.formats.osm_xml_write import write_osm_xml
from flexmap_tasks.formats.projector_info import write_projector_info
from flexmap_tasks.geometry import mgrs
from flexmap_tasks.geometry.utm import NORTH_LIMIT_DEG, SOUTH_LIMIT_DEG, to_lonlat
from flexmap_tasks.georeferencing.frame import PROJECTOR_FILE, check_zone, local_cartesian
from flexmap_tasks.model.arrays import Floats, Ints, Strings, strings
from flexmap_tasks.model.maps import LaneletMap
from flexmap_tasks.model.osm import OsmDocument, OsmNodes, Tags
from flexmap_tasks.model.projection import Projection

MAP_FILE = "lanelet2_map.osm"
MGRS_DIGITS = 3
"""Vector Map Builder writes `mgrs_code` to 100 m; a map that carries codes of another length keeps it."""
_MGRS_CODE = re.compile(r"[0-9]{1,2}[A-Z]{3}((?:[0-9]{2}){0,5})")


@stage("bundle")
def georeference(
    lanelet_map: LaneletMap, projection: Projection | None, params: GeoreferenceParams
) -> dict[str, bytes]:
    """Both files by name.

    With a projection, every node gets lat, lon, ele, local_x, local_y and mgrs_code from its position, all in
    agreement; local_x and local_y are in the frame that Autoware makes of lat and lon with this projector.
    Without one the map is in no frame of the earth: coordinates stay as they were read, nodes that have none get
    local_x, local_y and ele, and Autoware is told to read these (`Local`).
    Raises ConfigError where Autoware could not find the frame again, CoverageError where the map is too wide.
    """
    document = _with_version(lanelet_map.document)
    if projection is None:
        document = replace(document, nodes=_local_nodes(document.nodes, lanelet_map.xyz_m))
        return {MAP_FILE: write_osm_xml(document), PROJECTOR_FILE: write_projector_info("Local", "")}
    lonlat_deg = _lonlat(lanelet_map, projection)
    local_m, info = _projector_frame(lanelet_map.xyz_m, lonlat_deg, projection, params)
    xyz_m = np.column_stack([local_m, lanelet_map.xyz_m[:, 2]])
    document = replace(document, nodes=_placed_nodes(document.nodes, lonlat_deg, xyz_m))
    return {MAP_FILE: write_osm_xml(document), PROJECTOR_FILE: info}


def _with_version(document: OsmDocument) -> OsmDocument:
    """OSM readers refuse a file that does not state its version; Vector Map Builder leaves it out."""
    return (
        document if "version" in document.root else replace(document, root={"version": "0.6"} | document.root)
    )


def _lonlat(lanelet_map: LaneletMap, projection: Projection) -> Floats:
    origin = (projection.origin_easting_m, projection.origin_northing_m)
    lonlat_deg = to_lonlat(lanelet_map.xyz_m[:, :2] + origin, projection.epsg)
    inside = (lonlat_deg[:, 1] >= SOUTH_LIMIT_DEG) & (lonlat_deg[:, 1] <= NORTH_LIMIT_DEG)
    if not inside.all():
        node = lanelet_map.document.nodes.id[np.flatnonzero(~inside)[0]]
        raise CoverageError("lanelet map", f"lies outside of UTM zone {projection.zone}", f"node {node}")
    return lonlat_deg


def _projector_frame(
    xyz_m: Floats, lonlat_deg: Floats, projection: Projection, params: GeoreferenceParams
) -> tuple[Floats, bytes]:
    """Positions in the plane as the projector sees them, and the projector's file."""
    check_zone(projection, params)
    if params.projector == "MGRS":
        names, within = mgrs.squares(lonlat_deg)
        found = sorted(set(names))
        if len(found) > 1:
            rule = (
                f"MGRS cannot hold a map that spans {len(found)} squares of 100 km ({', '.join(found[:4])})"
            )
            raise CoverageError("lanelet map", rule + "; set georeference.projector to LocalCartesianUTM")
        return within, write_projector_info("MGRS", params.vertical_datum, mgrs_grid="".join(found[:1]))
    if params.projector == "Local":
        return xyz_m[:, :2], write_projector_info("Local", params.vertical_datum)
    return xyz_m[:, :2], local_cartesian(projection, params)


def _placed_nodes(nodes: OsmNodes, lonlat_deg: Floats, xyz_m: Floats) -> OsmNodes:
    """Nodes whose every coordinate says the same."""
    rows = np.arange(len(nodes.id))
    lat, lon = (_decimals(lonlat_deg[:, i], 11) for i in (1, 0))
    attributes = nodes.attributes.with_values(
        np.tile(rows, 2), ["lat"] * len(rows) + ["lon"] * len(rows), [*lat, *lon]
    )
    columns: dict[str, Iterable[str]] = {
        "mgrs_code": mgrs.codes(lonlat_deg, _mgrs_digits(nodes)),
        "local_x": _decimals(xyz_m[:, 0], 4),
        "local_y": _decimals(xyz_m[:, 1], 4),
        "ele": _heights(nodes, xyz_m[:, 2]),
    }
    keys = [key for key in columns for _ in rows]
    values = [value for column in columns.values() for value in column]
    tags = nodes.tags.with_values(np.tile(rows, len(columns)), keys, values)
    return replace(nodes, lonlat_deg=lonlat_deg, attributes=attributes, tags=tags)


def _local_nodes(nodes: OsmNodes, xyz_m: Floats) -> OsmNodes:
    """Nodes as they are; those that have no coordinates yet get local ones."""
    local = nodes.tags.column("local_x")
    rows = np.flatnonzero(np.isnan(nodes.lonlat_deg[:, 0]) & (local == None))  # noqa: E711  (an array of objects)
    keys = [key for key in ("local_x", "local_y", "ele") for _ in rows]
    values = [value for i in range(3) for value in _decimals(xyz_m[rows, i], 4)]
    tags = nodes.tags.with_values(np.tile(rows, 3), keys, values)
    return replace(nodes, attributes=_with_blanks(nodes, rows), tags=tags)


def _with_blanks(nodes: OsmNodes, rows: Ints) -> Tags:
    """Blank lat and lon where a node has no such attribute: readers of OSM XML look for both."""
    attributes = nodes.attributes
    for key in ("lat", "lon"):
        bare = rows[attributes.column(key)[rows] == None]  # noqa: E711  (an array of objects)
        attributes = attributes.with_values(bare, [key] * len(bare), [""] * len(bare))
    return attributes


def _decimals(values: Floats, digits: int) -> list[str]:
    # Adding 0.0 turns a negative zero into zero.
    return [f"{v:.{digits}f}" for v in (np.round(values, digits) + 0.0).tolist()]


def _heights(nodes: OsmNodes, z_m: Floats) -> Strings:
    """`ele`: the text of the file where it still says the height."""
    text = nodes.tags.column("ele")
    blank = (text == None) | (text == "")  # noqa: E711  (an array of objects)
    same = np.where(blank, "nan", text).astype(np.float64) == z_m
    return np.where(same, text, strings(_decimals(z_m, 4)))


def _mgrs_digits(nodes: OsmNodes) -> int:
    """Digits for east and for north of the codes the map carries already."""
    for code in nodes.tags.column("mgrs_code"):
        if code is not None and (match := _MGRS_CODE.fullmatch(code)):
            return len(match[1]) // 2
    return MGRS_DIGITS
