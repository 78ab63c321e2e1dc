"""Tiles: every point once, in order, with all its fields, in bounded memory."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pcd_writer import pcd, source
from scipy.spatial import cKDTree

from flexmap_tasks.config import PointCloudParams
from flexmap_tasks.errors import InputError, StoreError
from flexmap_tasks.formats.pcd_open3d import check_open3d, inlier_rows
from flexmap_tasks.formats.pcd_spill import Spill
from flexmap_tasks.geometry.tiles import group_by_tile, nearest_per_voxel
from flexmap_tasks.ingest.point_cloud import ingest_point_cloud
from flexmap_tasks.model.clouds import Tiles, tile_key, tile_numbers
from flexmap_tasks.model.source import Source

PARAMS = PointCloudParams()


def records_of(xyz_m: np.ndarray, axis: str = "<f8") -> np.ndarray:
    """Points that carry their own row number, twice, and a wide field."""
    out = np.zeros(len(xyz_m), [("x", axis), ("y", axis), ("z", axis), ("row", "<u4"), ("wide", "<i2", (2,))])
    for i, a in enumerate("xyz"):
        out[a] = xyz_m[:, i]
    out["row"] = np.arange(len(xyz_m))
    out["wide"] = np.arange(len(xyz_m))[:, None] + [0, 1]
    return out


def ingest(
    records: np.ndarray, params: PointCloudParams = PARAMS, encoding: str = "binary", **changes: str
) -> Tiles:
    with tempfile.TemporaryDirectory() as folder:
        return ingest_point_cloud(source(Path(folder), pcd(records, encoding, **changes)), params)


COORDINATES = st.floats(-5e4, 5e4) | st.sampled_from(
    [0.0, -0.0, 20.0, -20.0, 39.999999999999993, np.nan, np.inf]
)


@settings(max_examples=80, deadline=None)
@given(
    hnp.arrays("f8", st.tuples(st.integers(1, 60), st.just(3)), elements=COORDINATES),
    st.integers(1, 300),
    st.sampled_from([64, 200, 1 << 20]),
)
def test_every_usable_point_is_in_exactly_one_tile(xyz_m: np.ndarray, size: int, block_bytes: int) -> None:
    usable = np.isfinite(xyz_m).all(axis=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("flexmap_tasks.formats.pcd.BLOCK_BYTES", block_bytes)
        if not usable.any():
            with pytest.raises(InputError, match="no point with finite"):
                ingest(records_of(xyz_m), PointCloudParams(tile_size_m=size))
            return
        tiles = ingest(records_of(xyz_m), PointCloudParams(tile_size_m=size))
    seen = []
    for i, (key, tile) in enumerate(tiles.tiles.items()):
        rows = tile.fields["row"]
        assert (np.diff(rows.astype(int)) > 0).all(), "file order"
        np.testing.assert_array_equal(tile.xyz_m, xyz_m[rows])
        np.testing.assert_array_equal(tile.fields["wide"], rows[:, None].astype(int) + np.arange(2))
        np.testing.assert_array_equal(np.floor(tile.xyz_m[:, :2] / size), [tile_numbers(key)] * len(rows))
        assert tiles.index.key[i] == key
        assert tiles.index.count[i] == len(rows)
        box = [getattr(tiles.index, f"{a}_{end}_m")[i] for end in ("min", "max") for a in "xyz"]
        np.testing.assert_array_equal(box, [*tile.xyz_m.min(axis=0), *tile.xyz_m.max(axis=0)])
        seen.append(rows)
    assert list(tiles.tiles) == sorted(tiles.tiles, key=tile_numbers)
    np.testing.assert_array_equal(np.sort(np.concatenate(seen)), np.flatnonzero(usable))
    codes = list(tiles.findings.code)
    assert codes == ([] if usable.all() else ["cloud-point-without-position"])


@given(st.integers(-(10**8), 10**8), st.integers(-(10**8), 10**8))
def test_tile_keys_read_back(ix: int, iy: int) -> None:
    assert tile_numbers(tile_key(ix, iy)) == (ix, iy)


def test_grouping_far_apart_points_needs_no_room() -> None:
    xy_m = np.array([[1e8, -1e8], [-1e8, 1e8], [0, 0], [1e8, -1e8]])
    order, starts, cells = group_by_tile(xy_m, 1)
    assert order.tolist() == [1, 2, 0, 3]
    assert starts.tolist() == [0, 1, 2, 4]
    assert cells.tolist() == [[-(10**8), 10**8], [0, 0], [10**8, -(10**8)]]


@settings(max_examples=100)
@given(
    hnp.arrays("f8", st.tuples(st.integers(0, 50), st.just(3)), elements=st.floats(-3, 3)),
    st.sampled_from([0.5, 1.0, 3.7]),
    st.sampled_from([1.0, 1e7]),
)
def test_the_point_nearest_the_middle_of_every_voxel_stays(
    xyz_m: np.ndarray, size_m: float, spread: float
) -> None:
    xyz_m = xyz_m * spread  # so far apart that the voxels' numbers do not fit 62 bits
    best: dict[tuple[float, ...], tuple[float, ...]] = {}
    for row, point in enumerate(xyz_m):
        cell = np.floor(point / size_m)
        away = float((((point / size_m - cell) - 0.5) ** 2).sum())
        mine = (away, *point.tolist(), row)
        best[tuple(cell.tolist())] = min(best.get(tuple(cell.tolist()), mine), mine)
    assert nearest_per_voxel(xyz_m, size_m).tolist() == sorted(int(b[-1]) for b in best.values())


def test_the_same_points_stay_in_whatever_order_they_come() -> None:
    rng = np.random.default_rng(9)
    records = records_of(rng.integers(-40, 40, (3000, 3)) / 4)  # on a raster: ties and points at one place
    kept = []
    for order in (np.arange(3000), rng.permutation(3000)):
        tiles = ingest(records[order], PointCloudParams(voxel_size_m=1.0))
        kept.append({int(r) for t in tiles.tiles.values() for r in t.fields["row"]})
    assert kept[0] == kept[1]
    assert len(kept[0]) < 3000


def test_thinning_keeps_fields_and_counts() -> None:
    rng = np.random.default_rng(3)
    xyz_m = rng.uniform(-30, 30, (5000, 3)) * [1, 1, 0.05]
    tiles = ingest(records_of(xyz_m), PointCloudParams(voxel_size_m=2.5))
    rows = np.sort(np.concatenate([t.fields["row"] for t in tiles.tiles.values()]))
    assert rows.tolist() == nearest_per_voxel(xyz_m, 2.5).tolist()  # 2.5 m voxels do not cross 20 m tiles
    assert tiles.index.count.sum() == len(rows)
    for key, tile in tiles.tiles.items():
        np.testing.assert_array_equal(tile.xyz_m, xyz_m[tile.fields["row"]])
        assert tile_numbers(key) == tuple(np.floor(tile.xyz_m[0, :2] / 20).astype(int))


def test_isolated_points_are_left_out_on_request() -> None:
    check_open3d()
    rng = np.random.default_rng(5)
    xyz_m = np.vstack([rng.uniform(1, 19, (3000, 3)) * [1, 1, 0.01], [[10, 10, 15], [3, 3, -12]]])
    tiles = ingest(records_of(xyz_m), PointCloudParams(outlier_neighbours=10, outlier_deviations=6.0))
    assert tiles.tiles["0_0"].fields["row"].tolist() == list(range(3000))
    assert list(tiles.findings.code) == ["cloud-outliers"]
    assert tiles.findings.message[0].startswith("2 isolated points of 3002")


def test_what_stands_out_is_what_another_library_says() -> None:
    rng = np.random.default_rng(6)
    xyz_m = np.vstack([rng.uniform(0, 20, (4000, 3)) * [1, 1, 0.02], rng.uniform(0, 20, (100, 3))])
    distance = cKDTree(xyz_m).query(xyz_m, 16)[0].mean(axis=1)
    expected = np.flatnonzero(distance < distance.mean() + 1.5 * distance.std(ddof=1))
    assert 0 < len(expected) < len(xyz_m)
    assert inlier_rows(xyz_m, 16, 1.5).tolist() == expected.tolist()
    assert inlier_rows(xyz_m[:16], 16, 1.5).tolist() == list(range(16))


def test_without_its_system_libraries_open3d_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(
        InputError, match=r"^open3d: cannot be imported .*apt-get install libusb-1.0-0 libgomp1$"
    ):
        check_open3d()


def test_a_viewpoint_is_refused_unless_it_says_nothing() -> None:
    records = records_of(np.ones((3, 3)))
    with pytest.raises(InputError, match=r"VIEWPOINT is 1 2 3 1 0 0 0.*viewpoint to ignore"):
        ingest(records, VIEWPOINT="1 2 3 1 0 0 0")
    ignoring = PointCloudParams(viewpoint="ignore")
    assert ingest(records, ignoring, VIEWPOINT="1 2 3 1 0 0 0").index.count.tolist() == [3]
    assert ingest(records, VIEWPOINT="0 0 0 -1 0 0 0").index.count.tolist() == [3]


def test_unusable_points_are_counted() -> None:
    xyz_m = np.array([[1, 1, 1], [np.nan, 1, 1], [1, -np.inf, 1], [1, 1, 2e8], [2, 2, 2]])
    tiles = ingest(records_of(xyz_m))
    assert tiles.index.count.tolist() == [2]
    assert tiles.findings.message[0] == "3 points of 5 have no usable coordinates and were left out"


def test_no_points_is_an_error() -> None:
    with pytest.raises(InputError, match="no point with finite x, y, z among 0"):
        ingest(records_of(np.zeros((0, 3))))


def test_coarse_float32_coordinates_are_reported() -> None:
    xyz_m = np.array([[698073.0, 5349128.0, 1.0]])
    assert list(ingest(records_of(xyz_m, "<f4")).findings.code) == ["cloud-coarse-coordinates"]
    assert "steps of 500.0 mm" in ingest(records_of(xyz_m, "<f4")).findings.message[0]
    assert list(ingest(records_of(xyz_m, "<f8")).findings.code) == []
    assert list(ingest(records_of(xyz_m / 1000, "<f4")).findings.code) == []


def test_stray_points_all_over_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flexmap_tasks.ingest.tiling.MAX_TILES", 10)
    with pytest.raises(InputError, match="11 tiles of 20 m, more than 10"):
        ingest(records_of(np.arange(11)[:, None] * [25.0, 0.0, 0.0]))


def test_real_scans_are_tiled_alike_in_every_encoding(shared_data: Path) -> None:
    path = min((shared_data / "pcd").glob("*.pcd"))
    tiles = ingest_point_cloud(Source(path.name, path), PARAMS)
    raw = np.frombuffer(path.read_bytes().split(b"DATA binary\n", 1)[1], "<f4").reshape(-1, 4)
    assert tiles.index.count.sum() == len(raw) == 69088
    records = np.zeros(4000, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
    for i, name in enumerate(records.dtype.names or ()):
        records[name] = raw[:4000, i]
    binary, ascii_, compressed = (
        {
            k: (t.xyz_m.tobytes(), t.fields["intensity"].tobytes())
            for k, t in ingest(records, PARAMS, e).tiles.items()
        }
        for e in ("binary", "ascii", "binary_compressed")
    )
    assert binary == compressed == ascii_


def test_a_full_disk_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    class Full:
        def seek(self, at: int) -> None:
            pass

        def write(self, data: bytes) -> None:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.TemporaryFile", Full)
    spill = Spill(np.dtype([("x", "<f4")]))
    with pytest.raises(StoreError, match=r"No space left on device.*TMPDIR"):
        spill.append(np.zeros(3, spill.record_type))


MEMORY = """
import resource, sys
from pathlib import Path
from flexmap_tasks.config import PointCloudParams
from flexmap_tasks.ingest.point_cloud import ingest_point_cloud
from flexmap_tasks.model.source import Source
def run(path):
    tiles = ingest_point_cloud(Source("cloud", Path(path)), PointCloudParams())
    return sum(len(t) for t in tiles.tiles.values())
run(sys.argv[1])  # loads what is loaded on demand
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
count = run(sys.argv[2])
print(count, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def test_memory_does_not_grow_with_the_cloud(tmp_path: Path) -> None:
    """From 1 to 5 million points: 112 MB more data, less than half of that more memory."""
    rng = np.random.default_rng(11)
    for name, count in (("small", 1_000_000), ("large", 5_000_000)):
        records = np.zeros(count, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("extra", "<f4", (4,))])
        records["x"], records["y"] = rng.uniform(0, 400, (2, count))
        head = pcd(records[:0], "binary", POINTS=str(count), WIDTH=str(count))
        with (tmp_path / name).open("wb") as file:
            file.write(head)
            records.tofile(file)
    command = [sys.executable, "-c", MEMORY, str(tmp_path / "small"), str(tmp_path / "large")]
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    assert int(out[0]) == 5_000_000
    assert int(out[1]) < 50_000, "KiB"
