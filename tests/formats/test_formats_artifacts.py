"""Values survive the way through files, byte for byte the same each time, and open elsewhere."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from flexmap_tasks.formats.artifacts import decode, encode
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.clouds import PointCloud
from flexmap_tasks.model.maps import RoadNetwork
from flexmap_tasks.model.osm import Tags
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.quality import Measure, Quality
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import GnssFixes, Trajectory


class MemoryFiles:
    """Files of an artifact in memory."""

    def __init__(self, content: dict[str, bytes]) -> None:
        self.content = content

    def names(self) -> list[str]:
        return sorted(self.content)

    def read(self, name: str) -> bytes:
        return self.content[name]

    def local(self, name: str) -> Path:
        return Path(name)

    def sub(self, prefix: str) -> MemoryFiles:
        return MemoryFiles({n[len(prefix) :]: c for n, c in self.content.items() if n.startswith(prefix)})


def round_trip(value, kind=None):
    files = dict(encode(value, "value"))
    assert files == dict(encode(value, "value"))
    back = decode(kind or type(value), MemoryFiles(files), "value")
    assert dict(encode(back, "value")) == files
    return back, files


def same(a, b) -> bool:
    if dataclasses.is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, np.ndarray):
        equal_nan = a.dtype.kind == "f"
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=equal_nan)
    return a == b


def fixes(n: int, stamps: bool) -> GnssFixes:
    column = np.linspace(1, 2, n)
    return GnssFixes(
        column, column + 40, np.full(n, np.nan), column, column, column,
        np.zeros(n, dtype=np.int64), np.arange(n, dtype=np.int64) if stamps else None,
    )  # fmt: skip


@pytest.mark.parametrize("n", [0, 1, 5])
@pytest.mark.parametrize("stamps", [True, False])
def test_a_table_comes_back(n, stamps):
    value = fixes(n, stamps)
    back, files = round_trip(value)
    assert same(value, back)
    assert list(files) == ["value.parquet"]


def test_names_say_units_and_geometry_is_geoparquet():
    _, files = round_trip(fixes(3, stamps=True))
    table = pq.read_table(io.BytesIO(files["value.parquet"]))
    assert {"lon_deg", "lat_deg", "alt_m", "stamp_ns", "geometry"} <= set(table.column_names)
    geo = json.loads(table.schema.metadata[b"geo"])
    assert geo["primary_column"] == "geometry"
    assert shapely.from_wkb(table["geometry"][0].as_py()) == shapely.Point(1, 41)
    _, files = round_trip(Trajectory(np.zeros((2, 3)), np.tile([0, 0, 0, 1.0], (2, 1)), None))
    table = pq.read_table(io.BytesIO(files["value.parquet"]))
    assert {"x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"} <= set(table.column_names)
    assert json.loads(table.schema.metadata[b"geo"])["columns"]["geometry"]["crs"] is None


@given(st.lists(st.dictionaries(st.text(max_size=5), st.text(max_size=8), max_size=4), max_size=5), st.data())
def test_lists_and_tags_come_back(tags, data):
    size = data.draw(st.lists(st.integers(0, 4), min_size=len(tags), max_size=len(tags)))
    offset = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
    m, n = int(offset[-1]), len(tags)
    value = RoadNetwork(
        np.arange(n, dtype=np.int64), np.ones(n, dtype=np.int64), strings([""] * n), offset,
        np.arange(m, dtype=np.int64), np.arange(2.0 * m).reshape(m, 2), Tags.of(tags),
    )  # fmt: skip
    back, _ = round_trip(value)
    assert same(value, back)


def test_json_values_come_back():
    value = Projection(32632, 48.1, 11.2, 1.0, 2.0, 0.1, 0.9997, 0.9996, "WGS84")
    back, files = round_trip(value)
    assert back == value
    assert list(files) == ["value.json"]
    quality = Quality((Measure("a", 1.5, "m", 2.0, passed=True), Measure("b", None, "1")))
    assert round_trip(quality)[0] == quality


@given(st.integers(0, 20), st.sampled_from(["u1", "i2", "u4", "f4", "f8"]))
def test_clouds_keep_all_fields_and_types(n, dtype):
    value = PointCloud(
        np.arange(3.0 * n).reshape(n, 3),
        {"intensity": np.arange(n).astype(dtype), "rgb": np.arange(3 * n).reshape(n, 3).astype(dtype)},
    )
    back, _ = round_trip(value)
    assert list(back.fields) == list(value.fields)
    assert all(same(back.fields[f], value.fields[f]) for f in value.fields)
    assert same(back.xyz_m, value.xyz_m)


def test_collections_are_read_one_at_a_time():
    cloud = PointCloud(np.zeros((2, 3)), {})
    back, files = round_trip({"0_1": cloud, "-1_0": cloud}, dict[str, PointCloud])
    assert sorted(files) == ["value/-1_0.parquet", "value/0_1.parquet"]
    assert sorted(back) == ["-1_0", "0_1"]
    assert len(back["0_1"]) == 2


def test_raw_files_and_sources():
    files = dict(encode({"b.osm": b"1", "a.yaml": b"2"}, "bundle"))
    assert files == {"a.yaml": b"2", "b.osm": b"1"}
    assert decode(dict[str, bytes], MemoryFiles(files), "bundle") == files
    assert decode(Source, MemoryFiles({"extract.osm": b"1"}), "x") == Source(
        "extract.osm", Path("extract.osm")
    )
