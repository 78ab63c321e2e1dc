"""Open3D's statistical outlier removal, the filter that point cloud people know; and whether Open3D is there."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexmap_tasks.errors import InputError
from flexmap_tasks.model.arrays import Floats, Ints


def check_open3d() -> Any:
    """The open3d module.

    Raises InputError that says what to install when it cannot be imported: its wheel needs system libraries.
    """
    try:
        import open3d  # noqa: PLC0415 - takes seconds and hundreds of megabytes; few runs need it
    except (ImportError, OSError) as error:
        reason = str(error).strip().splitlines()[0][:200] if str(error).strip() else type(error).__name__
        raise InputError(
            "open3d", f"cannot be imported ({reason}); run: apt-get install libusb-1.0-0 libgomp1"
        ) from None
    return open3d


def inlier_rows(xyz_m: Floats, neighbours: int, deviations: float) -> Ints:
    """Rows whose mean distance to their `neighbours` nearest points does not stand out.

    A point stands out when that distance is over the mean of all points by more than `deviations` standard
    deviations (statistical outlier removal, Rusu 2009). A cloud of no more points than neighbours is kept whole.
    """
    if len(xyz_m) <= neighbours:
        return np.arange(len(xyz_m), dtype=np.int64)
    o3d = check_open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.ascontiguousarray(xyz_m)))
    _, rows = cloud.remove_statistical_outlier(nb_neighbors=neighbours, std_ratio=deviations)
    return np.sort(np.asarray(rows, dtype=np.int64))
