"""Autoware's list of the tiles of a point cloud map."""

from __future__ import annotations

from collections.abc import Mapping

import yaml


def metadata_bytes(tile_size_m: int, corners_m: Mapping[str, tuple[int, int]]) -> bytes:
    """`pointcloud_map_metadata.yaml`: the size of a tile, then file name: [x_min, y_min] in the given order.

    Autoware's loader reads the corners as integers, therefore tiles are whole metres wide.
    """
    document = {
        "x_resolution": float(tile_size_m),
        "y_resolution": float(tile_size_m),
        **{name: list(corner) for name, corner in corners_m.items()},
    }
    return yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=1000).encode("ascii")
