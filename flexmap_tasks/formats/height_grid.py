"""Height models as files: GeoTIFF, ESRI ASCII grid, and lines "x y z" of a regular grid."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, UnidentifiedImageError

from flexmap_tasks.errors import InputError
from flexmap_tasks.model.arrays import Floats

_SCALE, _TIEPOINT, _MATRIX, _KEYS, _NODATA = 33550, 33922, 34264, 34735, 42113
"""Tags of GeoTIFF (OGC 19-008r4), and GDAL's for cells without data."""

_RASTER_TYPE, _GEOGRAPHIC, _PROJECTED, _VERTICAL, _POINT, _USER = 1025, 2048, 3072, 4096, 2, 32767
"""Keys of GeoTIFF, the value of cells that are points, and of systems without a code."""

_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")

MAX_CELLS = 1 << 28
"""Cells of one model: 16 km squared at 1 m; a larger one has to be cut first."""

_EVEN = 1e-3
"""Lines of a grid leave their places by no more than this share of a cell."""

LOWEST_M, HIGHEST_M = -12_000.0, 9_000.0
"""There is no ground beyond: such values are codes for no data."""


class Grid(NamedTuple):
    """height_m : (rows, columns) from the north, NaN without data; first_x, first_y : centre of the first cell

    step_x, step_y : to the next cell, step_y < 0; epsg, vertical_epsg : as the file states them, None where not
    """

    height_m: Floats
    first_x: float
    first_y: float
    step_x: float
    step_y: float
    epsg: int | None
    vertical_epsg: int | None


def read_height_grid(name: str, path: Path) -> Grid:
    """The grid of a file, which is told by its content. Raises InputError for a file that is none of the three."""
    with path.open("rb") as file:
        head = file.read(512)
    if head[:4] in _TIFF:
        return _known(name, _geotiff(name, path))
    if head.lstrip()[:5].lower() == b"ncols":
        return _known(name, _esri(name, path))
    return _known(name, _lines(name, path))


def _known(name: str, grid: Grid) -> Grid:
    height = np.where((grid.height_m > LOWEST_M) & (grid.height_m < HIGHEST_M), grid.height_m, np.nan)
    if min(height.shape) < 2 or not np.isfinite(height).any():
        raise InputError(name, "holds no heights: a grid of at least two by two cells with data is needed")
    return grid._replace(height_m=height)


def _geotiff(name: str, path: Path) -> Grid:
    Image.MAX_IMAGE_PIXELS = None  # the size is checked before pixels are read
    try:
        with warnings.catch_warnings(), Image.open(path, formats=("TIFF",)) as image:
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            if image.width * image.height > MAX_CELLS:
                raise InputError(
                    name, f"{image.width} x {image.height} cells; cut it to {MAX_CELLS:,} at most"
                )
            if len(image.getbands()) != 1 or image.mode in ("1", "P"):
                raise InputError(name, f"a single band of heights is needed, found {image.mode}")
            tags: dict[int, Any] = dict(image.tag_v2)  # type: ignore[attr-defined]
            height = np.asarray(image, dtype=np.float64)
    except (OSError, UnidentifiedImageError, ValueError, SyntaxError, TypeError, KeyError) as error:
        raise InputError(
            name,
            f"is no TIFF of heights that can be read; 64-bit floats and LERC become Float32 first: {error}",
        ) from None
    keys = _geo_keys(tags)
    step_x, step_y, x, y = _placed(name, tags)
    if keys.get(_RASTER_TYPE) != _POINT:  # cells are areas, and x, y the corner of the first
        x, y = x + step_x / 2, y + step_y / 2
    try:
        nodata = float(str(tags.get(_NODATA, "nan")).strip("\0 "))
    except ValueError:
        nodata = float("nan")
    height[height == nodata] = np.nan
    epsg = keys.get(_PROJECTED, keys.get(_GEOGRAPHIC))
    return Grid(height, x, y, step_x, step_y, _code(epsg), _code(keys.get(_VERTICAL)))


def _geo_keys(tags: dict[int, Any]) -> dict[int, int]:
    """Short values of the key directory; those stored elsewhere are texts and numbers that nothing here needs."""
    flat = np.array(tags.get(_KEYS, ()), dtype=np.int64)
    if len(flat) % 4 or len(flat) < 4:
        return {}
    entries = flat.reshape(-1, 4)[1:]
    return {int(key): int(value) for key, where, _, value in entries.tolist() if where == 0}


def _placed(name: str, tags: dict[int, Any]) -> tuple[float, float, float, float]:
    """Step x, step y, and x, y of the first cell's corner or centre."""
    if _MATRIX in tags:
        a, b, _, x, c, d, _, y = (float(v) for v in tags[_MATRIX][:8])
        if b or c:
            raise InputError(name, "is turned against its axes: resample it to north up")
        return _north_up(name, a, d, x, y)
    if _SCALE not in tags or _TIEPOINT not in tags:
        raise InputError(name, "does not say where it lies: a GeoTIFF with a scale and a tie point is needed")
    step_x, step_y = (float(v) for v in tags[_SCALE][:2])
    i, j, _, x, y = (float(v) for v in tags[_TIEPOINT][:5])
    return _north_up(name, step_x, -step_y, x - i * step_x, y + j * step_y)


def _north_up(
    name: str, step_x: float, step_y: float, x: float, y: float
) -> tuple[float, float, float, float]:
    if not (step_x > 0 and step_y < 0 and np.isfinite([x, y, step_x, step_y]).all()):
        raise InputError(name, f"rows must go from north to south; its cells are {step_x:g} by {step_y:g}")
    return step_x, step_y, x, y


def _code(epsg: int | None) -> int | None:
    return None if epsg is None or not 0 < epsg < _USER else epsg


def _esri(name: str, path: Path) -> Grid:
    header: dict[str, float] = {}
    with path.open("r", encoding="ascii", errors="replace") as file:
        for count in range(7):
            words = file.readline().split()
            if len(words) != 2 or not words[0][0].isalpha():
                break
            try:
                header[words[0].lower()] = float(words[1].replace(",", "."))
            except ValueError:
                raise InputError(name, f'expected "{words[0]} number"', f"line {count + 1}") from None
            skip = count + 1
    try:
        columns, rows, cell = int(header["ncols"]), int(header["nrows"]), header["cellsize"]
        half = 0.0 if "xllcenter" in header else cell / 2
        x = (header["xllcenter"] if "xllcenter" in header else header["xllcorner"]) + half
        y = (header["yllcenter"] if "yllcenter" in header else header["yllcorner"]) + half
    except KeyError as missing:
        raise InputError(name, f"the header lacks {missing}: an ESRI ASCII grid is expected") from None
    if not (0 < columns * rows <= MAX_CELLS and cell > 0):
        raise InputError(name, f"{columns} x {rows} cells of {cell:g}; at most {MAX_CELLS:,} can be read")
    values = _numbers(name, path, skip).ravel()
    if len(values) != columns * rows:
        raise InputError(name, f"{columns} x {rows} heights are announced, {len(values)} found")
    values[values == header.get("nodata_value", -9999.0)] = np.nan
    return Grid(values.reshape(rows, columns), x, y + (rows - 1) * cell, cell, -cell, None, None)


def _lines(name: str, path: Path) -> Grid:
    xyz = _numbers(name, path, 0)
    if xyz.ndim != 2 or xyz.shape[1] != 3 or len(xyz) < 4:
        raise InputError(name, 'expected a GeoTIFF, an ESRI ASCII grid, or lines "x y height"')
    (x, step_x, i), (y, step_y, j) = (_axis(name, column) for column in xyz.T[:2])
    columns, rows = int(i.max()) + 1, int(j.max()) + 1
    if columns * rows > MAX_CELLS:
        raise InputError(name, f"{columns} x {rows} cells; cut it to {MAX_CELLS:,} at most")
    height = np.full((rows, columns), np.nan)
    height[rows - 1 - j, i] = xyz[:, 2]
    return Grid(height, x, y + (rows - 1) * step_y, step_x, -step_y, None, None)


def _axis(name: str, values: Floats) -> tuple[float, float, np.ndarray]:
    """First value, step, and the number of each along it."""
    different = np.unique(values)
    if len(different) < 2:
        raise InputError(name, "all points lie on one line; a grid is needed")
    first, step = float(different[0]), float(np.diff(different).min())
    place = (values - first) / step
    number = np.rint(place).astype(np.int64)
    if np.abs(place - number).max() > _EVEN * max(1.0, float(number.max()) ** 0.5):
        raise InputError(name, "points do not lie on a regular grid")
    return first, step, number


def _numbers(name: str, path: Path, skip: int) -> Floats:
    """All numbers of a text file; a comma or semicolon may part them."""
    text = path.read_text(encoding="ascii", errors="replace")
    if ";" in text[:4096] or "," in text[:4096]:
        text = text.replace(";", " ").replace(",", " ")
    lines = text.splitlines()[skip:]
    width = len(lines[0].split()) if lines else 0
    try:
        values = np.array(" ".join(lines).split(), dtype=np.float64)
    except ValueError as error:
        raise InputError(name, f"expected numbers only: {error}") from None
    return values.reshape(-1, width) if width and len(values) % width == 0 else values
