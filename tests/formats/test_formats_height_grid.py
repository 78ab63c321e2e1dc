"""Height models as people have them: GeoTIFF, ESRI ASCII grid, lines of a grid; and what is none of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.height_grid import Grid, read_height_grid

HEIGHTS = (500 + np.add.outer(0.5 * np.arange(5), 0.25 * np.arange(7))).astype(np.float32)
KEYS = (1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 25832)


def tiff(
    path: Path, heights: np.ndarray = HEIGHTS, *, keys: tuple = KEYS, matrix: tuple | None = None,
    placed: bool = True, nodata: str | None = "-9999", **options: object,
) -> Path:  # fmt: skip
    tags = ImageFileDirectory_v2()
    doubles, shorts, text = 12, 3, 2
    if matrix is not None:
        tags[34264], tags.tagtype[34264] = matrix, doubles
    elif placed:
        tags[33550], tags.tagtype[33550] = (2.0, 2.0, 0.0), doubles
        tags[33922], tags.tagtype[33922] = (0.0, 0.0, 0.0, 691_000.0, 5_337_000.0, 0.0), doubles
    if keys:
        tags[34735], tags.tagtype[34735] = keys, shorts
    if nodata is not None:
        tags[42113], tags.tagtype[42113] = nodata, text
    Image.fromarray(heights).save(path, format="TIFF", tiffinfo=tags, **options)
    return path


def read(path: Path) -> Grid:
    return read_height_grid("model", path)


@pytest.mark.parametrize("compression", [None, "tiff_lzw", "tiff_adobe_deflate"])
@pytest.mark.parametrize("kind", ["float32", "int16", "uint16", "int32"])
def test_geotiff(tmp_path: Path, compression: str | None, kind: str) -> None:
    heights = HEIGHTS.astype(kind)
    grid = read(tiff(tmp_path / "a", heights, compression=compression))
    assert np.array_equal(grid.height_m, heights)
    assert grid[1:] == (691_001.0, 5_336_999.0, 2.0, -2.0, 25832, None)


def test_geotiff_of_points_without_a_code(tmp_path: Path) -> None:
    keys = (1, 1, 0, 3, 1025, 0, 1, 2, 3072, 0, 1, 32767, 4096, 0, 1, 7837)
    grid = read(tiff(tmp_path / "a", keys=keys))
    assert grid[1:] == (691_000.0, 5_337_000.0, 2.0, -2.0, None, 7837)
    turned = (2.0, 0.0, 0.0, 691_000.0, 0.0, -2.0, 0.0, 5_337_000.0) + (0.0,) * 8
    assert read(tiff(tmp_path / "b", keys=keys, matrix=turned))[1:5] == grid[1:5]


def test_cells_without_data(tmp_path: Path) -> None:
    heights = HEIGHTS.copy()
    heights[1, 2], heights[3, 3], heights[0, 0] = -9999, 3.4e38, np.nan
    grid = read(tiff(tmp_path / "a", heights))
    assert np.argwhere(np.isnan(grid.height_m)).tolist() == [[0, 0], [1, 2], [3, 3]]


def test_esri_ascii_grid(tmp_path: Path) -> None:
    rows = "\n".join(" ".join(f"{v:.2f}" for v in row) for row in HEIGHTS)
    header = "ncols 7\nnrows 5\nxllcorner 691000\nyllcorner 5336990\ncellsize 2\n"
    (tmp_path / "a").write_text(header + "NODATA_value -9999\n" + rows.replace("500.25", "-9999", 1))
    grid = read(tmp_path / "a")
    assert np.isnan(grid.height_m[0, 1])
    assert np.nanmax(np.abs(grid.height_m - HEIGHTS)) < 1e-6
    assert grid[1:] == (691_001.0, 5_336_999.0, 2.0, -2.0, None, None)
    (tmp_path / "b").write_text(header.replace("corner", "center") + rows)
    assert read(tmp_path / "b")[1:3] == (691_000.0, 5_336_998.0)


@pytest.mark.parametrize("comma", [" ", ",", ";"])
def test_lines_in_any_order_with_holes(tmp_path: Path, comma: str) -> None:
    order = np.random.default_rng(0).permutation(35)[:-1]
    lines = [
        comma.join(
            [f"{691_000 + 2 * (k % 7)}.0", f"{5_337_000 - 2 * (k // 7)}.0", f"{HEIGHTS.ravel()[k]:.2f}"]
        )
        for k in order
    ]
    (tmp_path / "a").write_text("\n".join(lines))
    grid = read(tmp_path / "a")
    assert grid.height_m.shape == (5, 7)
    assert np.isnan(grid.height_m).sum() == 1
    assert np.nanmax(np.abs(grid.height_m - HEIGHTS)) < 1e-6
    assert grid[1:] == (691_000.0, 5_337_000.0, 2.0, -2.0, None, None)


TEXTS = {
    "empty": ("", "expected a GeoTIFF"),
    "words": ("a b c\nd e f", "numbers only"),
    "two columns": ("1 2\n3 4\n5 6\n7 8", "expected a GeoTIFF"),
    "no grid": ("0 0 1\n1 0 1\n0 1 1\n1.37 1 1\n2 2 2", "regular grid"),
    "one line": ("0 0 1\n1 0 1\n2 0 1\n3 0 1", "one line"),
    "grid without cells": ("ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3", "4|announced"),
    "grid without size": ("ncols 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3 4", "lacks 'nrows'"),
    "too large a grid": ("ncols 100000\nnrows 100000\nxllcorner 0\nyllcorner 0\ncellsize 1\n1", "at most"),
    "header of words": ("ncols two\nnrows 2\n", "line 1"),
    "no data": ("ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n" + "-9999 " * 4, "no heights"),
}


@pytest.mark.parametrize("what", TEXTS)
def test_texts_that_are_no_model(tmp_path: Path, what: str) -> None:
    text, rule = TEXTS[what]
    (tmp_path / "a").write_text(text)
    with pytest.raises(InputError, match=rule):
        read(tmp_path / "a")


def test_pictures_that_are_no_model(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="where it lies"):
        read(tiff(tmp_path / "a", placed=False))
    with pytest.raises(InputError, match="single band"):
        read(tiff(tmp_path / "b", np.zeros((4, 4, 3), np.uint8)))
    with pytest.raises(InputError, match="turned"):
        read(tiff(tmp_path / "c", matrix=(2.0, 0.1, 0, 1, 0.1, -2.0, 0, 1) + (0.0,) * 8))
    with pytest.raises(InputError, match="north to south"):
        read(tiff(tmp_path / "d", matrix=(2.0, 0.0, 0, 1, 0.0, 2.0, 0, 1) + (0.0,) * 8))
    whole = tiff(tmp_path / "e").read_bytes()
    for size in (6, 40, len(whole) // 2):
        (tmp_path / "f").write_bytes(whole[:size])
        with pytest.raises(InputError):
            read(tmp_path / "f")
