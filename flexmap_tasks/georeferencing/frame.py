"""The frame that Autoware's loaders put the map in, as far as a point cloud must follow it."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.config import GeoreferenceParams
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import ConfigError, CoverageError
from flexmap_tasks.formats.projector_info import write_projector_info
from flexmap_tasks.formats.yaml_mapping import yaml_mapping
from flexmap_tasks.geometry import mgrs
from flexmap_tasks.geometry.utm import utm_epsg
from flexmap_tasks.model.clouds import CloudFrame
from flexmap_tasks.model.projection import Projection

PROJECTOR_FILE = "map_projector_info.yaml"


@stage("cloud_frame")
def cloud_frame(
    projection: Projection, bundle: dict[str, bytes] | None, params: GeoreferenceParams
) -> CloudFrame:
    """How far the map frame has to be shifted to be the projector's: into the MGRS square, or not at all.

    bundle : the vector map's files; its square must be the cloud's, since Autoware knows only one.
    Raises CoverageError where the map lies in another square than the origin of the map frame.
    """
    if params.projector != "MGRS":
        return CloudFrame(0.0, 0.0)
    square, within_m = _square(projection)
    listed = yaml_mapping((bundle or {}).get(PROJECTOR_FILE, b"")) or {}
    if listed.get("mgrs_grid", square) != square:
        rule = (
            f"the lanelet map lies in MGRS square {listed['mgrs_grid']}, the origin in {square}: set "
            "projection.origin to a place inside of the map, or georeference.projector to LocalCartesianUTM"
        )
        raise CoverageError("point cloud", rule)
    return CloudFrame(*within_m)


@stage("projector_file")
def projector_file(projection: Projection, params: GeoreferenceParams) -> dict[str, bytes]:
    """`map_projector_info.yaml` of a release that holds a cloud and no lanelet map."""
    check_zone(projection, params)
    if params.projector == "MGRS":
        info = write_projector_info("MGRS", params.vertical_datum, mgrs_grid=_square(projection)[0])
    elif params.projector == "Local":
        info = write_projector_info("Local", params.vertical_datum)
    else:
        info = local_cartesian(projection, params)
    return {PROJECTOR_FILE: info}


def local_cartesian(projection: Projection, params: GeoreferenceParams) -> bytes:
    """The projector that has the map frame's own origin."""
    origin = (projection.origin_lat_deg, projection.origin_lon_deg)
    return write_projector_info("LocalCartesianUTM", params.vertical_datum, origin_lat_lon_deg=origin)


def check_zone(projection: Projection, params: GeoreferenceParams) -> None:
    """Raise ConfigError where Autoware would take another UTM zone than the map frame's."""
    own = utm_epsg(projection.origin_lon_deg, projection.origin_lat_deg)
    if params.projector != "Local" and own != projection.epsg:
        rule = f"{params.projector} always works in the origin's own zone, but zone {projection.zone} was asked for"
        raise ConfigError(
            "projection", rule + "; leave it empty, or set georeference.projector to Local", "zone"
        )


def _square(projection: Projection) -> tuple[str, tuple[float, float]]:
    """The square of the origin, and where in it the origin lies."""
    names, within_m = mgrs.squares(np.array([[projection.origin_lon_deg, projection.origin_lat_deg]]))
    easting_m = projection.origin_easting_m % mgrs.SQUARE_M
    northing_m = projection.origin_northing_m % mgrs.SQUARE_M
    if abs(easting_m - within_m[0, 0]) > 1.0 or abs(northing_m - within_m[0, 1]) > 1.0:  # on a grid line
        easting_m, northing_m = within_m[0].tolist()
    return str(names[0]), (float(easting_m), float(northing_m))
