"""The paper's stages: what they recover, what they refuse, and the real route in metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexmap_tasks.alignment.align_track import align_track
from flexmap_tasks.alignment.control_points import control_points
from flexmap_tasks.alignment.project import project_utm
from flexmap_tasks.alignment.rubber_sheet import rubber_sheet
from flexmap_tasks.alignment.umeyama import umeyama
from flexmap_tasks.config import (
    GeoPoint,
    GnssParams,
    PairParams,
    ProjectionParams,
    RubberSheetParams,
    SlamParams,
    UmeyamaParams,
)
from flexmap_tasks.errors import AlignmentError, ConfigError
from flexmap_tasks.geometry.polyline import nearest_on_polyline
from flexmap_tasks.ingest.gnss import ingest_gnss
from flexmap_tasks.ingest.slam import ingest_slam
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import GnssFixes, GnssTrack, Trajectory

HERE = Projection.at(11.67, 48.26)


def fixes(lon: np.ndarray, lat: np.ndarray, **columns: np.ndarray) -> GnssFixes:
    n, unknown = len(lon), np.full(len(lon), np.nan)
    values = {
        "alt_m": unknown, "sigma_east_m": unknown, "sigma_north_m": unknown, "sigma_up_m": unknown,
        "status": np.full(n, -2), "stamp_ns": None,
    }  # fmt: skip
    return GnssFixes(lon_deg=lon, lat_deg=lat, **(values | columns))


def gnss_track(xy: np.ndarray) -> GnssTrack:
    n = len(xy)
    return GnssTrack(
        np.column_stack([xy, np.zeros(n)]), np.full((n, 3), np.nan), np.full(n, -2),
        np.arange(n), np.ones(n, bool), None,
    )  # fmt: skip


def slam_track(xy: np.ndarray) -> Trajectory:
    return Trajectory(np.column_stack([xy, np.zeros(len(xy))]), np.tile([0.0, 0, 0, 1], (len(xy), 1)), None)


def drive(n: int = 200) -> np.ndarray:
    x = np.linspace(0, 500, n)
    return np.column_stack([x, 80 * np.sin(x / 60)])


# --- projection ---------------------------------------------------------------------------------


def test_first_usable_fix_is_the_origin() -> None:
    lon = np.array([np.nan, 0.0, 11.0, 11.67, 11.68, 11.69])
    lat = np.array([48.0, 0.0, 48.0, 48.26, 48.26, 48.26])
    out = project_utm(fixes(lon, lat, status=np.array([0, 0, -1, 0, 0, 0])), ProjectionParams())
    assert out.gnss_track.row.tolist() == [3, 4, 5]
    assert np.abs(out.gnss_track.xyz_m[0, :2]).max() < 1e-9
    assert (out.projection.origin_lat_deg, out.projection.zone) == (48.26, "32N")


def test_configured_origin_and_zone() -> None:
    params = ProjectionParams(origin=GeoPoint(lat_deg=48.0, lon_deg=11.0), zone="33N")
    out = project_utm(fixes(np.array([11.67]), np.array([48.26])), params)
    assert out.projection.zone == "33N"
    assert np.allclose(out.projection.to_lonlat_deg(out.gnss_track.xyz_m[:, :2]), [[11.67, 48.26]])


def test_height_enters_the_grid_scale() -> None:
    flat = project_utm(fixes(np.array([11.67]), np.array([48.26])), ProjectionParams()).projection
    high = project_utm(
        fixes(np.array([11.67]), np.array([48.26]), alt_m=np.array([500.0])), ProjectionParams()
    ).projection
    assert flat.grid_scale_factor == flat.point_scale_factor
    assert high.grid_scale_factor == pytest.approx(flat.point_scale_factor * (1 - 500 / 6371e3), abs=1e-8)


@pytest.mark.parametrize(
    ("lon", "lat", "params", "error", "text"),
    [
        ([np.nan], [1.0], {}, AlignmentError, "none of 1 fixes has a position"),
        ([11.0, 11.0], [48.0, 86.0], {}, AlignmentError, "row 1: UTM covers latitudes"),
        ([11.67], [48.26], {"zone": "10N"}, ConfigError, "its own zone is 32N"),
        ([11.67], [48.26], {"origin": {"lat_deg": 40, "lon_deg": -90}}, ConfigError, "first fix at 48.26"),
    ],
)
def test_projection_refuses(lon: list, lat: list, params: dict, error: type, text: str) -> None:
    with pytest.raises(error, match=text):
        project_utm(fixes(np.array(lon), np.array(lat)), ProjectionParams.model_validate(params))


# --- rigid start --------------------------------------------------------------------------------


@settings(max_examples=30)
@given(st.floats(-np.pi, np.pi), st.floats(-1e5, 1e5), st.floats(-1e5, 1e5), st.booleans())
def test_any_motion_is_recovered(angle: float, x: float, y: float, grid_scale: bool) -> None:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    scale = HERE.grid_scale_factor if grid_scale else 1.0
    truth = scale * drive() @ turn.T + (x, y)
    motion = umeyama(
        slam_track(drive()), gnss_track(truth), HERE, UmeyamaParams(grid_scale=grid_scale, points=300)
    )
    assert np.abs(motion.apply_xy(drive()) - truth).max() < 1e-6
    assert motion.fitted_scale == pytest.approx(1.0, abs=1e-9)
    assert np.abs(motion.inverse().apply_xy(truth) - drive()).max() < 1e-6


def test_straight_drive_is_enough() -> None:
    line = np.column_stack([np.linspace(0, 400, 50), np.zeros(50)])
    motion = umeyama(slam_track(line), gnss_track(line[:, ::-1]), HERE, UmeyamaParams(grid_scale=False))
    assert np.abs(motion.apply_xy(line) - line[:, ::-1]).max() < 1e-9


@pytest.mark.parametrize(
    ("slam", "gnss", "text"),
    [
        (drive()[:2], drive(), "SLAM trajectory: needs at least 3 distinct places, found 2"),
        (drive(), np.repeat(drive()[:2], 9, axis=0), "GNSS track: needs at least 3 distinct places, found 2"),
        (drive(), drive()[:1].repeat(0, axis=0), "found 0"),
        (drive(), np.random.default_rng(0).normal(size=(500, 2)) * 0.01, "stands still"),
        (drive(), drive()[:60], "is 668.7 m long, the GNSS track 1"),
        (drive(), 90 * np.column_stack([np.cos(drive()[:, 0] / 80), np.sin(drive()[:, 0] / 80)]), "cannot be one"),
    ],
)  # fmt: skip
def test_rigid_start_refuses(slam: np.ndarray, gnss: np.ndarray, text: str) -> None:
    with pytest.raises(AlignmentError, match=text):
        umeyama(slam_track(slam), gnss_track(gnss), HERE, UmeyamaParams())


# --- control points -----------------------------------------------------------------------------

HEADER = "name,source_x_m,source_y_m,target_x_m,target_y_m,use\n"
GOOD = HEADER + "a,0,0,1,1,yes\nb,100,0,101,1,\nc,0,100,1,101,1\n"


def read(tmp_path: Path, text: str, **params: float):
    path = tmp_path / "pairs.csv"
    path.write_text(text, encoding="utf-8")
    track = drive()
    motion = umeyama(slam_track(track), gnss_track(track), HERE, UmeyamaParams(grid_scale=False))
    return control_points(
        Source("pairs.csv", path), slam_track(track), gnss_track(track), motion, HERE,
        PairParams(**params),
    )  # fmt: skip


WAYS = {
    "source_x_m,source_y_m": lambda xy, lonlat, row: f"{xy[0]},{xy[1]}",
    "source_row": lambda xy, lonlat, row: str(row),
    "source_map_x_m,source_map_y_m": lambda xy, lonlat, row: f"{xy[0]},{xy[1]}",
    "source_lat_deg,source_lon_deg": lambda xy, lonlat, row: f"{lonlat[1]},{lonlat[0]}",
}


@pytest.mark.parametrize("source", WAYS)
@pytest.mark.parametrize("target", list(WAYS)[:2] + list(WAYS)[3:])
def test_all_ways_to_name_a_place_agree(tmp_path: Path, source: str, target: str) -> None:
    rows, track = [10, 70, 150], drive()
    lonlat = HERE.to_lonlat_deg(track)
    lines = [
        ",".join(WAYS[way](track[row], lonlat[row], row) for way in (source, target)) + ",0.5" for row in rows
    ]
    header = f"{source},{target.replace('source', 'target')},sigma_m"
    points = read(tmp_path, "\n".join([header, *lines]))
    assert np.abs(points.source_xy_m - track[rows]).max() < 1e-6
    assert np.abs(points.target_xy_m - track[rows]).max() < 1e-6
    assert points.sigma_m.tolist() == [0.5] * 3


def test_first_complete_way_counts(tmp_path: Path) -> None:
    text = "name,slam_row,slam_raw_x,slam_raw_y,gnss_x,gnss_y,gnss_row\na,,0,0,1,2,\nb,7,,,101,1,\nc,,0,100,,,199\n"
    points = read(tmp_path, text, max_rigid_distance_m=1000)
    assert np.allclose(points.source_xy_m, [[0, 0], drive()[7], [0, 100]], atol=1e-9)
    assert np.allclose(points.target_xy_m, [[1, 2], [101, 1], drive()[199]], atol=1e-9)


@pytest.mark.parametrize("edited", ["lat", "x", "row"])
def test_the_one_of_three_ways_that_was_changed_counts(tmp_path: Path, edited: str) -> None:
    rows, track = [10, 70, 150], drive()
    lonlat = HERE.to_lonlat_deg(track)
    moved = track[70] + np.array([0.3, -0.2])
    x, lat, row = track.copy(), lonlat.copy(), np.arange(len(track))
    expected = moved
    if edited == "lat":
        lat[70] = HERE.to_lonlat_deg(moved[None])[0]
    elif edited == "x":
        x[70] = moved
    else:
        row[70], expected = 71, track[71]
    lines = [f"{r},{x[r, 0]},{x[r, 1]},{lat[r, 1]:.12f},{lat[r, 0]:.12f},{row[r]}" for r in rows]
    points = read(tmp_path, "\n".join(["slam_row,gnss_x,gnss_y,gnss_lat,gnss_lon,gnss_row", *lines]))
    assert np.abs(points.target_xy_m - np.array([track[10], expected, track[150]])).max() < 1e-6


def test_two_ways_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    text = "slam_row,gnss_x,gnss_y,gnss_row\n10,5000,1,10\n70,,,70\n150,,,150\n"
    with pytest.raises(AlignmentError, match=r"line 2 .*target_x_m and target_row lie .* m apart; keep one"):
        read(tmp_path, text)


def test_delimiters_comments_and_marks_are_understood(tmp_path: Path) -> None:
    text = "\ufeff# by hand\n" + GOOD.replace(",", ";") + "\n\nd;5;5;6;6;no\n"
    points = read(tmp_path, text)
    assert points.label.tolist() == ["a", "b", "c", "d"]
    assert points.used.tolist() == [True, True, True, False]
    assert points.reason[3] == "excluded by the user"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "pairs.csv: is empty"),
        (HEADER, "has 0 control points in use; .* at least 3"),
        (HEADER + "a,0,0,1,1,\nb,9,9,9,8,\n", "has 2 control points in use; .* at least 3"),
        (GOOD.replace("c,0,100,1,101,1", "c,50,0,51,1,"), "all 3 control points lie on one line"),
        (GOOD + "d,0,0,7,7,\n", r'line 5 \("d"\): has the same source as line 2 \("a"\)'),
        (GOOD + "d,7,7,1,1,\n", r'line 5 \("d"\): has the same target as line 2 \("a"\)'),
        (GOOD + "d,7,seven,1,1,\n", r'line 5 \("d"\): source_y_m: expected a number, found "seven"'),
        (GOOD + "d,7,nan,1,1,\n", 'expected a number, found "nan"'),
        (GOOD + "d,7,1e999,1,1,\n", 'expected a number, found "1e999"'),
        (GOOD + "d,7,,1,1,\n", r'line 5 \("d"\): gives no complete source'),
        (GOOD + "d,7,7,1\n", "line 5: expected 6 values as in the header, found 4"),
        (GOOD + "d,7,7,1,1,maybe\n", 'use: expected yes or no, found "maybe"'),
        (GOOD + "d,7,7,900,1,\n", r'line 5 \("d"\): source and target lie 893.0 m apart'),
        (GOOD.replace("use", "usage"), 'line 1: unknown column "usage"'),
        (GOOD.replace("use", "name"), "column name appears twice"),
        ("use,target_row\nyes,1\n", "line 1: no column says where the source is"),
        ("name,target_row\na,1\n", r'line 2 \("a"\): gives no complete source'),
        ("source_row,target_row\n1,1\n2,2.5\n", 'target_row: expected a row counted from 0, found "2.5"'),
        ("source_row,target_row\n1,1\n-2,2\n", 'source_row: expected a row counted from 0, found "-2"'),
        ("source_row,target_row\n1,1\n200,2\n", r"row 200 is beyond the SLAM trajectory, whose last row is 199"),
        ("source_row,target_row\n1,1\n20,2000\n", r"row 2000 is beyond the GNSS recording, whose last row is 199"),
        ("source_row,target_lat_deg,target_lon_deg\n1,100,11\n", "target_lat_deg: 100 degrees do not exist"),
        ("source_row,target_row,sigma_m\n1,1,0\n", "sigma_m: expected a number over 0"),
        ('source_row,target_row\n"1,1\n', "line 2: is not a CSV line"),
    ],
)  # fmt: skip
def test_control_points_refuse(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(AlignmentError, match=message):
        read(tmp_path, text)


def test_file_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "pairs.csv"
    path.write_bytes(b"\xff\xfe\x00a")
    with pytest.raises(AlignmentError, match="is not UTF-8 text"):
        control_points(
            Source("pairs.csv", path), slam_track(drive()), gnss_track(drive()),
            umeyama(slam_track(drive()), gnss_track(drive()), HERE, UmeyamaParams()), HERE, PairParams(),
        )  # fmt: skip


# --- the real route -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def garching(shared_data: Path):
    folder = shared_data / "garching"
    gnss = ingest_gnss(Source("gnss", folder / "route_1_GPS.txt"), GnssParams())
    slam = ingest_slam(Source("slam", folder / "route1_pose_kitti.txt"), SlamParams())
    return slam, project_utm(gnss, ProjectionParams()), Source("pairs", folder / "control_points_peer.csv")


def deviation(slam_xyz: np.ndarray, gnss: GnssTrack) -> tuple[float, float, float]:
    distance = nearest_on_polyline(slam_xyz[:, :2], gnss.xyz_m[:, :2]).distance_m
    return distance.mean(), distance.std(), float(np.sqrt((distance**2).mean()))


def test_garching_origin_and_outage(garching) -> None:
    _, projected, _ = garching
    projection, track = projected.projection, projected.gnss_track
    assert projection.origin_easting_m == pytest.approx(698073.91706, abs=1e-5)
    assert projection.origin_northing_m == pytest.approx(5349128.20088, abs=1e-5)
    assert np.hypot(*np.diff(track.xyz_m[:, :2], axis=0).T).sum() == pytest.approx(4134.9, abs=0.05)
    broken = np.flatnonzero(~track.observed)
    assert (broken.min(), broken.max()) == (12320, 12991)


def test_garching_rigid_start(garching) -> None:
    slam, projected, _ = garching
    motion = umeyama(slam, projected.gnss_track, projected.projection, UmeyamaParams(grid_scale=False))
    assert np.degrees(motion.angle_rad) == pytest.approx(-5.609090, abs=1e-6)
    assert np.allclose(motion.translation_m, [1.063620, -1.176658], atol=1e-6)
    moved = np.column_stack([motion.apply_xy(slam.xyz_m), slam.xyz_m[:, 2]])
    assert np.allclose(deviation(moved, projected.gnss_track), [5.946, 5.226, 7.916], atol=1e-3)


@pytest.mark.parametrize("grid_scale", [True, False])
def test_garching_rubber_sheet(garching, grid_scale: bool) -> None:
    slam, projected, pairs = garching
    track, projection = projected.gnss_track, projected.projection
    motion = umeyama(slam, track, projection, UmeyamaParams(grid_scale=grid_scale))
    points = control_points(pairs, slam, track, motion, projection, PairParams())
    warp = rubber_sheet(points, motion, slam, None, None, RubberSheetParams())
    mean, std, rmse = deviation(align_track(slam, warp).xyz_m, track)
    assert mean <= 1.00
    assert std <= 1.61
    assert rmse <= 1.90
