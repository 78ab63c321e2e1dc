"""Trajectories and fixes as text files: KITTI, TUM, and plain `lat lon`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.model.arrays import Floats, Ints

NS_PER_S = 1_000_000_000


def kitti_text(xyz_m: Floats, rotation: NDArray[np.float64]) -> str:
    """Rows of the upper 3 x 4 of each pose; xyz_m (n, 3), rotation (n, 3, 3)."""
    rows = np.concatenate([rotation, xyz_m[:, :, None]], axis=2).reshape(-1, 12)
    template = " ".join(["%.9e"] * 12) + "\n"
    return "".join(template % tuple(row) for row in rows.tolist())


def tum_text(stamp_ns: Ints, xyz_m: Floats, quaternion: Floats) -> str:
    """Rows of seconds, x y z, quaternion x y z w."""
    seconds, nanoseconds = (stamp_ns // NS_PER_S).tolist(), (stamp_ns % NS_PER_S).tolist()
    template = "%d.%09d " + " ".join(["%.9f"] * 7) + "\n"
    rows = zip(seconds, nanoseconds, *xyz_m.T.tolist(), *quaternion.T.tolist(), strict=True)
    return "".join(template % row for row in rows)


def csv_text(columns: dict[str, list[object]]) -> str:
    """Comma-separated rows under a header; numbers as Python writes them, no quoting."""
    rows = zip(*columns.values(), strict=True)
    return ",".join(columns) + "\n" + "".join(",".join(str(v) for v in row) + "\n" for row in rows)
