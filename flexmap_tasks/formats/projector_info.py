"""`map_projector_info.yaml` as Autoware's map loader reads it."""

from __future__ import annotations

import yaml


def write_projector_info(
    projector_type: str,
    vertical_datum: str,
    *,
    origin_lat_lon_deg: tuple[float, float] | None = None,
    mgrs_grid: str | None = None,
) -> bytes:
    """The file's bytes.

    `Local` (the spelling matters) has neither datum nor origin. The altitude of the origin is always 0: the map
    loader does not subtract it from `ele`, but the GNSS path does, so that any other value would tear them apart.
    """
    info: dict[str, object] = {"projector_type": projector_type}
    if projector_type != "Local":
        info["vertical_datum"] = vertical_datum
    if mgrs_grid is not None:
        info["mgrs_grid"] = mgrs_grid
    if origin_lat_lon_deg is not None:
        latitude, longitude = origin_lat_lon_deg
        info["map_origin"] = {"latitude": latitude, "longitude": longitude, "altitude": 0.0}
    return yaml.safe_dump(info, sort_keys=False, allow_unicode=True).encode()
