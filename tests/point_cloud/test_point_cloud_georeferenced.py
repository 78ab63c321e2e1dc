"""The moved cloud: all points, where the warp puts them, in tiles that Autoware can read."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pcd_writer import pcd, source
from scipy.spatial import Delaunay

from flexmap_tasks.config import CloudCheckParams, GeoreferenceParams, PcdParams, PointCloudParams
from flexmap_tasks.errors import CoverageError
from flexmap_tasks.formats.artifacts import decode, encode
from flexmap_tasks.formats.pcd import read_pcd
from flexmap_tasks.geometry.mgrs import squares
from flexmap_tasks.georeferencing.cloud import (
    check_cloud,
    merge_tile,
    pointcloud_metadata,
    tile_extent,
    warp_tile,
)
from flexmap_tasks.georeferencing.frame import cloud_frame, projector_file
from flexmap_tasks.ingest.point_cloud import ingest_point_cloud
from flexmap_tasks.model.alignment import RigidMotion, RubberSheet, Warp
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.clouds import (
    CloudFrame,
    PointCloud,
    TileIndex,
    TileKeys,
    Tiles,
    cloud_findings,
    tile_key,
    tile_numbers,
)
from flexmap_tasks.model.maps import Findings
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.tracks import Trajectory

PARAMS = PointCloudParams()
PCD = PcdParams()


def rigid(angle_rad: float = 0.0, shift_m: tuple[float, float] = (0.0, 0.0), scale: float = 1.0) -> Warp:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return Warp(RigidMotion(np.array([[cos, -sin], [sin, cos]]), np.array(shift_m), scale, 1.0, 0.0), None)


def bent(seed: int, angle_rad: float = 0.7) -> Warp:
    """A rubber sheet with a vertex about every 30 m, each moved by about a metre."""
    rng = np.random.default_rng(seed)
    inner = rng.uniform(-90, 90, (40, 2))
    corners = np.array([[-100.0, -100], [100, -100], [100, 100], [-100, 100]])
    before = np.vstack([corners, inner])
    after = np.vstack([corners, inner + rng.normal(0, 1, inner.shape)]) + np.array([0.3, -0.2])
    triangles = Delaunay(before).simplices.astype(np.int64)
    a, b, c = (before[triangles[:, i]] for i in range(3))
    turn = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    triangles[turn < 0] = triangles[turn < 0][:, ::-1]
    return Warp(
        rigid(angle_rad, (5.0, -3.0)).motion, RubberSheet(before, after, triangles, np.array([0.3, -0.2]))
    )


def slam_tiles(seed: int = 1, points: int = 4000, reach_m: float = 130.0) -> dict[str, PointCloud]:
    rng = np.random.default_rng(seed)
    xyz_m = rng.uniform(-reach_m, reach_m, (points, 3))
    rows = np.arange(points, dtype=np.uint32)
    cells = np.floor(xyz_m[:, :2] / PARAMS.tile_size_m).astype(int)
    return {
        tile_key(ix, iy): PointCloud(xyz_m, {"row": rows, "wide": np.stack([rows, rows], axis=1)}).take(
            (cells == [ix, iy]).all(axis=1)
        )
        for ix, iy in np.unique(cells, axis=0).tolist()
    }


def map_tiles(tiles: dict[str, PointCloud], warp: Warp) -> dict[str, dict[str, PointCloud]]:
    """Map tile -> SLAM tile -> points."""
    out: dict[str, dict[str, PointCloud]] = {}
    for key, tile in tiles.items():
        for moved_key, part in warp_tile(tile, warp, None, PARAMS).items():
            out.setdefault(moved_key, {})[key] = part
    return out


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 1000), st.floats(-3.2, 3.2))
def test_every_point_arrives_once_where_the_warp_puts_it(seed: int, angle_rad: float) -> None:
    tiles, warp = slam_tiles(seed, 600), bent(seed, angle_rad)
    rows = []
    for key, parts in map_tiles(tiles, warp).items():
        for slam_key, part in parts.items():
            tile = tiles[slam_key]
            at = np.searchsorted(tile.fields["row"], part.fields["row"])
            np.testing.assert_array_equal(part.xyz_m, warp.apply(tile.xyz_m)[at])
            assert (np.diff(at) > 0).all(), "order within the tile"
            np.testing.assert_array_equal(np.floor(part.xyz_m[:, :2] / 20), [tile_numbers(key)] * len(part))
            np.testing.assert_array_equal(part.fields["wide"], tile.fields["wide"][at])
            rows.append(part.fields["row"])
    np.testing.assert_array_equal(np.sort(np.concatenate(rows)), np.arange(600))


def test_the_part_of_the_warp_that_touches_a_tile_moves_it_to_the_same_bits() -> None:
    warp = bent(3)
    for key, tile in slam_tiles().items():
        near = warp.restrict(tile_extent(key, PARAMS))
        whole, part = warp_tile(tile, warp, None, PARAMS), warp_tile(tile, near, None, PARAMS)
        assert list(whole) == list(part)
        assert all(whole[k].xyz_m.tobytes() == part[k].xyz_m.tobytes() for k in whole)


def test_a_tile_s_box_holds_its_points_even_where_division_rounds() -> None:
    for size in (1, 3, 7, 20, 49):
        edges = np.arange(-2000, 2000) * float(size)
        for x in np.concatenate([edges, np.nextafter(edges, np.inf), np.nextafter(edges, -np.inf)])[::37]:
            ix = int(np.floor(x / size))
            box = tile_extent(tile_key(ix, 0), PointCloudParams(tile_size_m=size))
            assert box.x_min_m < x < box.x_max_m


def test_merged_tiles_hold_all_points_in_float32_whatever_the_order_of_parts(tmp_path: Path) -> None:
    tiles, warp = slam_tiles(), bent(5)
    total = 0
    for parts in map_tiles(tiles, warp).values():
        (name, content), *rest = merge_tile(parts, PCD).items()
        assert name == "tile.pcd"
        assert not rest
        assert content == merge_tile(dict(reversed(parts.items())), PCD)["tile.pcd"]
        cloud = read_pcd(source(tmp_path, content))
        in_order = [parts[k] for k in sorted(parts, key=tile_numbers)]
        assert np.abs(cloud.xyz_m - np.concatenate([p.xyz_m for p in in_order])).max() < 1e-5
        np.testing.assert_array_equal(
            cloud.fields["row"], np.concatenate([p.fields["row"] for p in in_order])
        )
        assert cloud.fields["wide"].shape == (len(cloud), 2)
        total += len(cloud)
    assert total == 4000


def test_parts_are_in_numeric_order_of_their_tiles(tmp_path: Path) -> None:
    parts = {
        k: PointCloud(np.full((1, 3), float(i)), {})
        for i, k in enumerate(["-2_0", "0_-1", "0_3", "2_0", "10_0"])
    }
    content = merge_tile(dict(sorted(parts.items())), PCD)["tile.pcd"]
    assert read_pcd(source(tmp_path, content)).xyz_m[:, 0].tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("names", [("normal_x", "normal_y", "normal_z"), ("nx", "ny", "nz")])
def test_normals_turn_with_the_warp(names: tuple[str, str, str]) -> None:
    rng = np.random.default_rng(2)
    normal = rng.normal(size=(50, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    fields = {n: normal[:, i].astype("f4") for i, n in enumerate(names)}
    tile = PointCloud(rng.uniform(0, 5, (50, 3)), fields)
    moved = next(iter(warp_tile(tile, rigid(0.5, (110.0, 110.0), 0.9996), None, PARAMS).values()))
    cos, sin = np.cos(0.5), np.sin(0.5)
    expected = normal @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    got = np.column_stack([moved.fields[n] for n in names])
    order = np.argsort(moved.xyz_m[:, 2])
    np.testing.assert_allclose(got[order], expected[np.argsort(tile.xyz_m[:, 2])], atol=1e-6)
    assert all(moved.fields[n].dtype == np.float32 for n in names)


def test_normals_stay_of_unit_length_in_a_sheet() -> None:
    tile = PointCloud(
        np.random.default_rng(3).uniform(-60, 60, (500, 3)),
        {"normal_x": np.ones(500), "normal_y": np.zeros(500)},
    )
    for part in warp_tile(tile, bent(1), None, PARAMS).values():
        np.testing.assert_allclose(np.hypot(part.fields["normal_x"], part.fields["normal_y"]), 1, atol=1e-12)


def test_without_a_warp_tiles_stay_as_they_are() -> None:
    for key, tile in slam_tiles(points=300).items():
        parts = warp_tile(tile, None, None, PARAMS)
        assert list(parts) == [key]
        np.testing.assert_array_equal(parts[key].xyz_m, tile.xyz_m)
        np.testing.assert_array_equal(parts[key].fields["row"], tile.fields["row"])


def test_a_warp_out_of_this_world_is_refused() -> None:
    with pytest.raises(CoverageError, match="out of any map frame"):
        warp_tile(PointCloud(np.zeros((1, 3)), {}), rigid(0, (1e12, 0)), None, PARAMS)
    with pytest.raises(CoverageError, match="out of any map frame"):
        warp_tile(PointCloud(np.zeros((1, 3)), {}), rigid(0, (np.nan, 0)), None, PARAMS)


def test_metadata_lists_every_tile_as_autoware_reads_it() -> None:
    keys = TileKeys(strings(["10_0", "-2_5", "2_0"]))
    content = pointcloud_metadata(keys, PARAMS)["pointcloud_map_metadata.yaml"]
    assert content.decode() == (
        "x_resolution: 20.0\ny_resolution: 20.0\n-2_5.pcd: [-40, 100]\n2_0.pcd: [40, 0]\n10_0.pcd: [200, 0]\n"
    )
    loaded = yaml.safe_load(content)
    assert loaded.pop("x_resolution") == loaded.pop("y_resolution") == 20.0
    assert all(isinstance(v, int) for corner in loaded.values() for v in corner)


def drive_at(x_m: float) -> Trajectory:
    return Trajectory(
        np.array([[x_m, 0.0, 0.0], [x_m + 50, 9.0, 0.0]]), np.tile([0.0, 0, 0, 1], (2, 1)), None
    )


def checked(keys: list[str], *, coordinates: str = "float32", drive_x_m: float = 0.0) -> Findings:
    index = TileIndex(strings(["0_0"]), np.array([9]), *(np.array([float(v)]) for v in (0, 0, 0, 20, 20, 5)))
    params = CloudCheckParams.model_validate({"tile_size_m": 20, "coordinates": coordinates})
    read = cloud_findings([("cloud-outliers", "info", "one")])
    return check_cloud(read, index, drive_at(drive_x_m), TileKeys(strings(keys)), params)


def test_tiles_far_from_the_origin_are_reported() -> None:
    assert checked(["818_0", "-819_3"]).code.tolist() == ["cloud-outliers"]
    assert len(checked([])) == 1
    found = checked(["0_0", "0_-850", "1_900"])
    assert found.code.tolist() == ["cloud-outliers", "cloud-far-from-origin"]
    assert "2 of 3 tiles" in found.message[1]
    assert "up to 18.0 km are off by up to 1.0 mm" in found.message[1]
    assert "up to 100.0 km are off by up to 3.9 mm" in checked(["4999_0"]).message[1], (
        "the far end of an MGRS square"
    )
    assert len(checked(["4999_0"], coordinates="float64")) == 1


def test_a_cloud_beside_the_drive_is_told() -> None:
    assert checked(["0_0"], drive_x_m=500).code.tolist() == ["cloud-outliers"]
    found = checked(["0_0"], drive_x_m=1020.0)
    assert found.code.tolist() == ["cloud-outliers", "cloud-far-from-drive"]
    assert "1000 m from" in found.message[1]


@settings(max_examples=200)
@given(st.floats(-16_384, 16_384), st.floats(-16_384, 16_384), st.floats(-500, 9000))
def test_float32_loses_less_than_half_a_millimetre_within_16_km(x: float, y: float, z: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        cloud = PointCloud(np.array([[x, y, z]]), {})
        near = read_pcd(source(Path(folder), merge_tile({"0_0": cloud}, PCD)["tile.pcd"]))
        assert np.abs(near.xyz_m - cloud.xyz_m).max() < 0.0005
        exact = merge_tile({"0_0": cloud}, PcdParams(coordinates="float64"))["tile.pcd"]
        np.testing.assert_array_equal(read_pcd(source(Path(folder), exact)).xyz_m, cloud.xyz_m)


def test_with_mgrs_the_cloud_lies_in_the_square_as_the_lanelets_do() -> None:
    origin = Projection.at(11.6690, 48.2643)
    mgrs = GeoreferenceParams(projector="MGRS")
    frame = cloud_frame(origin, None, mgrs)
    assert cloud_frame(origin, None, GeoreferenceParams()) == CloudFrame(0.0, 0.0)
    place = np.array([[11.6700, 48.2650]])
    names, within_m = squares(place)
    tile = PointCloud(np.column_stack([origin.to_xy_m(place), [500.0]]), {})
    (key, part), *_ = warp_tile(tile, None, frame, PARAMS).items()
    np.testing.assert_allclose(part.xyz_m[0, :2], within_m[0], atol=2e-6)
    assert tile_numbers(key) == tuple(np.floor(within_m[0] / 20).astype(int))
    assert (tile.xyz_m[0, :2] == origin.to_xy_m(place)[0]).all(), "what is cached is not written to"
    files = projector_file(origin, mgrs)
    assert f"mgrs_grid: {names[0]}".encode() in files["map_projector_info.yaml"]
    assert cloud_frame(origin, files, mgrs) == frame
    with pytest.raises(CoverageError, match="lies in MGRS square 32UPA, the origin in 32UPU"):
        cloud_frame(origin, {"map_projector_info.yaml": b"mgrs_grid: 32UPA"}, mgrs)
    plain = projector_file(origin, GeoreferenceParams())["map_projector_info.yaml"]
    assert b"LocalCartesianUTM" in plain
    assert b"latitude: 48.2643" in plain


class Folder:
    """Files of a value in memory."""

    def __init__(self, files: dict[str, bytes]) -> None:
        self.files = files

    def names(self) -> list[str]:
        return sorted(self.files)

    def read(self, name: str) -> bytes:
        return self.files[name]

    def sub(self, prefix: str) -> Folder:
        return Folder({n[len(prefix) :]: c for n, c in self.files.items() if n.startswith(prefix)})


def test_tiles_survive_the_store(tmp_path: Path) -> None:
    records = np.zeros(
        300, [("x", "<f8"), ("wide", "<i2", (3,)), ("y", "<f8"), ("ring", "<u1"), ("z", "<f4")]
    )
    rng = np.random.default_rng(8)
    for name in ("x", "y", "z", "ring"):
        records[name] = rng.uniform(0, 70, 300)
    records["wide"] = rng.integers(-99, 99, (300, 3))
    tiles = ingest_point_cloud(source(tmp_path, pcd(records, "binary")), PARAMS)
    stored = Folder(dict(encode(tiles, "tiles")))
    loaded = decode(Tiles, stored, "tiles")  # type: ignore[arg-type]
    assert loaded.index.key.tolist() == tiles.index.key.tolist()
    assert set(loaded.tiles) == set(tiles.tiles)
    for key, tile in tiles.tiles.items():
        np.testing.assert_array_equal(loaded.tiles[key].xyz_m, tile.xyz_m)
        assert set(loaded.tiles[key].fields) == set(tile.fields) == {"wide", "ring"}
        for name, values in tile.fields.items():
            assert loaded.tiles[key].fields[name].dtype == values.dtype
            np.testing.assert_array_equal(loaded.tiles[key].fields[name], values)


def test_parts_survive_the_store() -> None:
    parts = next(iter(map_tiles(slam_tiles(), bent(5)).values()))
    stored = Folder(dict(encode(parts, "parts")))
    loaded = decode(dict[str, PointCloud], stored, "parts")  # type: ignore[arg-type]
    assert merge_tile(loaded, PCD) == merge_tile(parts, PCD)
