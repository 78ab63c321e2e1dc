"""Laws of the kernels under the alignment."""

from __future__ import annotations

import numpy as np
import pytest
from evo.core.geometry import umeyama_alignment
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from flexmap_tasks.geometry import utm
from flexmap_tasks.geometry.breaks import observed_steps
from flexmap_tasks.geometry.polyline import arc_length_m, nearest_on_polyline, resample_evenly
from flexmap_tasks.geometry.rigid import fit_planar_motion
from flexmap_tasks.geometry.sheet import EDGE_TOLERANCE_M, build_mesh, locate, move
from flexmap_tasks.geometry.triangulation import canonical, delaunay, ring, twice_area
from flexmap_tasks.geometry.turns import turned_about_z, yaw_rad
from flexmap_tasks.model.projection import Projection

coordinate = st.floats(-1e4, 1e4, allow_nan=False)


def rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


@pytest.mark.parametrize(
    ("lon", "lat", "epsg"),
    [
        (11.67, 48.26, 32632), (5.32, 60.39, 32632), (2.99, 60.0, 32631), (15.6, 78.2, 32633),
        (8.9, 78.0, 32631), (151.2, -33.9, 32756), (180.0, 10.0, 32601), (-180.0, 10.0, 32601),
        (179.999, 0.0, 32660), (0.0, 0.0, 32631),
    ],
)  # fmt: skip
def test_zone_of_a_place(lon: float, lat: float, epsg: int) -> None:
    assert utm.utm_epsg(lon, lat) == epsg


@pytest.mark.parametrize("zone", ["0N", "61N", "32", "N", "32X", "-3N", ""])
def test_zone_that_is_none(zone: str) -> None:
    with pytest.raises(ValueError, match="UTM zone"):
        utm.epsg_of_zone(zone)


@given(st.floats(-179, 179), st.floats(-79, 83), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_projection_there_and_back(lon: float, lat: float, dlon: float, dlat: float) -> None:
    projection = Projection.at(lon, lat)
    place = np.array([[lon, lat], [lon + dlon, np.clip(lat + dlat, -80, 84)]])
    xy = projection.to_xy_m(place)
    assert np.abs(xy[0]).max() < 1e-6
    back = projection.to_lonlat_deg(xy)
    assert np.abs((back - place + 180.0) % 360.0 - 180.0).max() < 1e-9


def test_convergence_and_scale_by_small_steps() -> None:
    projection = Projection.at(11.669, 48.264, height_m=480.0)
    north = projection.to_xy_m(np.array([[11.669, 48.2645], [11.669, 48.2635]]))
    step = north[0] - north[1]
    assert np.degrees(np.arctan2(-step[0], step[1])) == pytest.approx(projection.convergence_deg, abs=1e-5)
    meridian_radius = 6378137 * (1 - 0.00669438) / (1 - 0.00669438 * np.sin(np.radians(48.264)) ** 2) ** 1.5
    assert np.hypot(*step) / (np.radians(0.001) * meridian_radius) == pytest.approx(
        projection.point_scale_factor, abs=1e-7
    )
    assert projection.point_scale_factor / projection.grid_scale_factor == pytest.approx(
        1 + 480 / 6371008.8, abs=1e-9
    )


@given(
    arrays.arrays(float, st.tuples(st.integers(3, 40), st.just(2)), elements=coordinate),
    st.floats(-np.pi, np.pi), coordinate, coordinate,
)  # fmt: skip
def test_motion_is_recovered(points: np.ndarray, angle: float, x: float, y: float) -> None:
    spread = np.ptp(points, axis=0).max()
    if spread < 1e-2:
        return
    moved = points @ rotation(angle).T + (x, y)
    fit = fit_planar_motion(points, moved)
    assert np.linalg.det(fit.rotation) == pytest.approx(1.0)
    assert np.abs(points @ fit.rotation.T + fit.translation - moved).max() < 1e-7
    assert fit.scale == pytest.approx(1.0, abs=1e-6 + 1e-9 / spread)


def test_motion_never_reflects() -> None:
    points = np.array([[0.0, 0], [2, 0], [2, 1], [0, 3]])
    fit = fit_planar_motion(points, points * (1, -1))
    assert np.linalg.det(fit.rotation) == pytest.approx(1.0)


def test_motion_agrees_with_evo() -> None:
    rng = np.random.default_rng(1)
    source = rng.normal(size=(200, 2)) * 100
    target = 1.03 * source @ rotation(0.7).T + (5, -7) + rng.normal(size=(200, 2))
    theirs, _, scale = umeyama_alignment(source.T, target.T, with_scale=True)
    _, shift, _ = umeyama_alignment(source.T, target.T, with_scale=False)
    fit = fit_planar_motion(source, target)
    assert np.allclose(fit.rotation, theirs, atol=1e-12)
    assert fit.scale == pytest.approx(scale, abs=1e-12)
    assert np.allclose(fit.translation, shift, atol=1e-9)


def test_weight_of_zero_removes_a_point() -> None:
    rng = np.random.default_rng(2)
    source, target = rng.normal(size=(2, 20, 2))
    weight = np.r_[np.ones(15), np.zeros(5)]
    with_weight, without = (
        fit_planar_motion(source, target, weight),
        fit_planar_motion(source[:15], target[:15]),
    )
    assert np.allclose(with_weight.rotation, without.rotation)
    assert with_weight.rmse == pytest.approx(without.rmse)


def test_motion_of_a_single_place_is_refused() -> None:
    with pytest.raises(ValueError, match="into one"):
        fit_planar_motion(np.ones((5, 2)), np.zeros((5, 2)))


def test_resampling_is_even_and_keeps_the_ends() -> None:
    line = np.array([[0.0, 0], [1, 0], [1, 0], [1, 3]])
    out = resample_evenly(line, 9)
    assert np.allclose(np.diff(arc_length_m(out)), 0.5)
    assert np.array_equal(out[[0, -1]], line[[0, -1]])


@settings(max_examples=40, deadline=None)  # the first example loads compiled code
@given(
    arrays.arrays(float, st.tuples(st.integers(1, 20), st.just(2)), elements=coordinate),
    arrays.arrays(float, st.tuples(st.integers(2, 20), st.just(2)), elements=coordinate),
)
def test_distance_to_a_line_is_the_smallest_of_all(points: np.ndarray, line: np.ndarray) -> None:
    start, edge = line[:-1], np.diff(line, axis=0)
    square = np.maximum((edge**2).sum(axis=1), 1e-300)
    share = np.clip(((points[:, None] - start) * edge).sum(axis=2) / square, 0, 1)
    brute = np.linalg.norm(points[:, None] - start - share[..., None] * edge, axis=2).min(axis=1)
    near = nearest_on_polyline(points, line)
    assert np.allclose(near.distance_m, brute, atol=1e-7)
    place = line[near.segment] + near.share[:, None] * edge[near.segment]
    assert np.allclose(np.linalg.norm(points - place, axis=1), near.distance_m)


def test_of_segments_as_near_as_each_other_the_first_is_taken_whatever_was_asked_before() -> None:
    rng = np.random.default_rng(2)
    line = rng.integers(0, 9, (150, 2)).astype(float)  # repeated vertices, and segments without length
    line[40:45] = line[40]
    points = np.concatenate([line, line + np.array([0.0, 100.0]), rng.integers(-3, 12, (300, 2))])
    start, edge = line[:-1], np.diff(line, axis=0)
    square = (edge**2).sum(axis=1)
    along = ((points[:, None] - start) * edge).sum(axis=2)
    share = np.clip(np.divide(along, square, out=np.zeros_like(along), where=square > 0), 0, 1)
    distance = np.linalg.norm(points[:, None] - start - share[..., None] * edge, axis=2)
    first = (distance <= distance.min(axis=1, keepdims=True) + 1e-9).argmax(axis=1)
    near = nearest_on_polyline(points, line)
    vertex = np.isin(near.share, (0.0, 1.0))  # inside of a segment rounding may decide
    assert vertex.sum() > 300
    assert np.array_equal(near.segment[vertex], first[vertex])
    backwards = nearest_on_polyline(points[::-1], line)
    assert np.array_equal(backwards.segment[::-1], near.segment)


def test_distance_skips_what_was_not_driven() -> None:
    line = np.array([[0.0, 0], [10, 0], [10, 10]])
    near = nearest_on_polyline(np.array([[9.0, 8]]), line, np.array([True, False]))
    assert near.distance_m[0] == pytest.approx(8.0)
    assert np.isnan(nearest_on_polyline(np.array([[9.0, 8]]), line, np.zeros(2, bool)).distance_m[0])


@settings(max_examples=40)
@given(arrays.arrays(float, st.tuples(st.integers(3, 30), st.just(2)), elements=coordinate, unique=True))
def test_triangulation_covers_the_rectangle(points: np.ndarray) -> None:
    inner = np.array([[-2e4, -2e4], [2e4, -2e4], [2e4, 2e4], [-2e4, 2e4]])
    outer = 2 * inner
    everything = np.concatenate([np.unique(points.round(1), axis=0), inner, outer])
    n = len(everything) - 8
    triangles = canonical(
        np.concatenate([delaunay(everything[:-4]), ring(np.arange(n, n + 4), np.arange(n + 4, n + 8))])
    )
    area = twice_area(everything[triangles])
    assert (area > 0).all()
    assert area.sum() / 2 == pytest.approx(8e4**2, rel=1e-9)


def test_breaks_of_a_jump_an_outage_and_the_scatter_between() -> None:
    x = np.r_[np.arange(100) * 0.5, 90 + np.arange(5) * 0.1, 200 + np.arange(100) * 0.5]
    track = np.column_stack([x, np.zeros(205)])
    wanted = np.ones(205, bool)
    wanted[100:106] = False
    assert np.array_equal(observed_steps(track, None), wanted)
    stamp = np.arange(205) * 0.1
    assert np.array_equal(observed_steps(track, stamp), wanted)
    even = np.column_stack([np.arange(50) * 0.5, np.zeros(50)])
    late = np.arange(50) * 0.1 + np.where(np.arange(50) >= 20, 5.0, 0.0)
    assert np.flatnonzero(~observed_steps(even, late)).tolist() == [20]


@pytest.mark.parametrize("step", [0.3, 15.0, 30.0])
def test_no_break_in_a_steady_drive(step: float) -> None:
    assert observed_steps(np.column_stack([np.arange(80) * step, np.zeros(80)]), None).all()


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_turn_about_z_adds_to_the_heading(first: float, second: float) -> None:
    start = np.array([[0.0, 0.0, np.sin(first / 2), np.cos(first / 2)]])
    turned = yaw_rad(turned_about_z(start, np.array([second])))[0]
    assert np.cos(turned - first - second) == pytest.approx(1.0)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(3, 40), st.sampled_from((1.0, 40.0, 3000.0)), st.booleans())
def test_a_point_belongs_to_the_first_triangle_that_holds_it(
    seed: int, vertices: int, side_m: float, overlapping: bool
) -> None:
    rng = np.random.default_rng(seed)
    source = np.round(rng.uniform(0, side_m, (vertices, 2)), 1 if side_m > 1 else 3)
    source = np.unique(source, axis=0)
    if overlapping:  # the way back through a folded sheet
        triangles = rng.integers(0, len(source), (vertices, 3))
    else:
        triangles = delaunay(np.concatenate([source, [[-side_m, 0], [2 * side_m, 0], [0, 3 * side_m]]]))
        source = np.concatenate([source, [[-side_m, 0], [2 * side_m, 0], [0, 3 * side_m]]])
    area = twice_area(source[triangles])
    triangles = np.where(area[:, None] < 0, triangles[:, ::-1], triangles)[np.abs(area) > 1e-3 * side_m**2]
    ends = source[triangles] if len(triangles) else source[None, :3]
    share = rng.dirichlet((1, 1, 1), 300) * (
        rng.random((300, 3)) > 0.4
    )  # in triangles, on edges, at vertices
    share[share.sum(axis=1) == 0] = 1.0
    share /= share.sum(axis=1, keepdims=True)
    on = np.einsum("nk,nkd->nd", share, ends[rng.integers(0, len(ends), 300)])
    xy = np.concatenate([on, on + rng.normal(0, 2e-7, on.shape), rng.uniform(-2, 4, (300, 2)) * side_m])
    xyz = np.column_stack([xy, np.arange(len(xy))])
    outside = np.array([[1.0, 0.0, 7.0], [0.0, 1.0, -7.0]])
    wanted = np.full(len(xy), len(triangles))
    for t in range(len(triangles) - 1, -1, -1):
        start, end = source[triangles[t]], source[np.roll(triangles[t], -1)]
        normal = np.column_stack([start[:, 1] - end[:, 1], end[:, 0] - start[:, 0]])
        normal /= np.hypot(normal[:, 0], normal[:, 1])[:, None]
        inside = normal[:, 0] * xy[:, :1] + normal[:, 1] * xy[:, 1:] - (normal * start).sum(axis=1)
        wanted[(inside >= -EDGE_TOLERANCE_M).all(axis=1)] = t
    for points in (1, 20_000, 1 << 22):  # from few large cells to many small ones
        mesh = build_mesh(source, source[::-1], triangles, outside, points)
        assert np.array_equal(locate(mesh, xyz), wanted)
        a = mesh.affine[wanted]
        moved = np.column_stack([a[:, i, 0] * xy[:, 0] + a[:, i, 1] * xy[:, 1] + a[:, i, 2] for i in (0, 1)])
        assert np.array_equal(move(mesh, xyz), np.column_stack([moved, xyz[:, 2]]))
