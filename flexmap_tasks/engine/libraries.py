"""Versions of the libraries that can change a result."""

from __future__ import annotations

import functools
from importlib.metadata import version

LIBRARIES = (
    "numpy",
    "scipy",
    "pyproj",
    "shapely",
    "numba",
    "pyarrow",
    "lxml",
    "osmium",
    "mcap",
    "orjson",
    "PyYAML",
)
"""Libraries that can change the numbers or the bytes of a result."""


@functools.cache
def library_versions() -> dict[str, str]:
    """Installed versions of the libraries that matter."""
    return {name: version(name) for name in LIBRARIES}
