"""Recordings without time: laid where they belong whatever is missing of either track, or refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from flexmap_tasks.alignment.gnss_line import GnssLine
from flexmap_tasks.alignment.outages import guided
from flexmap_tasks.alignment.pose_graph import pose_graph
from flexmap_tasks.alignment.shape_seeds import even_track, seeds_between
from flexmap_tasks.config import PoseGraphParams
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.geometry.colinear import Seeds, best_chain
from flexmap_tasks.geometry.polyline import arc_length_m
from flexmap_tasks.model.pose_graph import PoseGraph
from tests import ways
from tests.drives import HERE, Driven, Noise, driven, untimed
from tests.ways import along, apart, backwards, cut, fix_along_m, turned

POOR = Noise(place_m=0.02, yaw_rad=2e-3, scale=1.01, white_m=0.05)


def adjusted(drive: Driven) -> PoseGraph:
    return pose_graph(drive.slam, drive.gnss, HERE, None, None, PoseGraphParams())


def error_m(drive: Driven, graph: PoseGraph) -> np.ndarray:
    return np.hypot(*(graph.nodes.xyz_m - drive.xyz[graph.nodes.row])[:, :2].T)


@pytest.mark.parametrize("how", ["SLAM early", "SLAM late", "SLAM within", "GNSS within"])
@pytest.mark.parametrize(("way", "seed", "share"), [(ways.winding, 1, 0.5), (ways.irregular, 3, 0.5), (ways.winding, 4, 0.3)])  # fmt: skip
def test_tracks_that_share_a_part_of_their_way_are_laid_there(
    way: ways.Way, seed: int, share: float, how: str
) -> None:
    whole = along(way, 5000.0, seed)
    slam_m, gnss_m = apart(float(whole.along[-1]), share)[how]
    part = turned(untimed(cut(whole, slam_m, gnss_m)), 2.2, (5000.0, -700.0))
    graph = adjusted(part)
    inside = (part.along >= gnss_m[0]) & (part.along <= gnss_m[1])
    assert np.percentile(error_m(part, graph)[inside[graph.nodes.row]], 95) < 2.5


@pytest.mark.parametrize("lengths", [(1500, 1500), (3000, 1000), (800, 3000), (400, 3000)])
@pytest.mark.parametrize("way", [None, ways.uneven, ways.winding, ways.irregular])
def test_no_other_drive_passes(way: ways.Way | None, lengths: tuple[float, float]) -> None:
    for seed in range(3):
        one, other = (driven(m, seed + 1000 * k, way=way) for k, m in enumerate(lengths))
        with pytest.raises(AlignmentError):
            adjusted(untimed(one._replace(gnss=other.gnss)))


@pytest.mark.parametrize("way", [None, ways.winding, ways.out_and_back, ways.laps])
def test_a_file_in_reverse_order_is_told_of(way: ways.Way | None) -> None:
    drive = untimed(driven(2500.0, 1, way=way))
    adjusted(drive)
    with pytest.raises(AlignmentError, match="run in opposite directions") as refused:
        adjusted(backwards(drive))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("way", [ways.laps, ways.eight, ways.out_and_back])
def test_a_way_that_meets_itself_is_laid_on_itself(way: ways.Way) -> None:
    drive = untimed(along(way, 2500.0, 1))
    assert np.median(error_m(drive, adjusted(drive))) < 0.6


def test_a_straight_road_says_what_is_missing() -> None:
    with pytest.raises(AlignmentError, match="with a shape of their own"):
        adjusted(untimed(along(ways.straight, 900.0, 0)))


def test_a_long_drive_is_laid_piece_by_piece() -> None:
    drive = untimed(driven(40_000.0, 1))
    error = error_m(drive, adjusted(drive))
    assert np.median(error) < 0.1
    assert np.percentile(error, 99) < 0.5


def test_outages_without_time_are_bridged() -> None:
    gaps = tuple((float(start), start + 100.0) for start in range(300, 2400, 400))
    for way in (ways.irregular, None):
        drive = untimed(driven(3000.0, 2, POOR, gaps, way=way))
        fix = fix_along_m(drive)
        error, at = error_m(drive, graph := adjusted(drive)), drive.along[graph.nodes.row]
        assert np.median(error[(at > fix[0]) & (at < fix[-1])]) < 0.6


@pytest.mark.parametrize("scale", [0.95, 1.05])
def test_slam_off_in_scale_is_laid_all_the_same(scale: float) -> None:
    drive = untimed(along(ways.irregular, 3000.0, 1, noise=dataclasses.replace(Noise(), scale=scale)))
    assert np.percentile(error_m(drive, adjusted(drive)), 95) < 1.0


def test_place_along_a_way_without_time_is_not_known_better_than_said() -> None:
    for seed in (1, 2):
        drive = untimed(along(ways.uneven, 2500.0, seed, noise=POOR))
        graph = adjusted(drive)
        assert error_m(drive, graph).mean() < 0.3
        predicted = np.hypot(*graph.nodes.sigma_m[:, :2].T)
        assert np.sqrt((error_m(drive, graph) ** 2).mean() / (predicted**2).mean()) < 1.5


def test_pieces_are_found_whatever_the_frame() -> None:
    way = ways.winding(2000.0, np.random.default_rng(3))
    other = way[600:3200] @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + (900.0, 4.0)
    one, two = (even_track(xy, arc_length_m(xy)) for xy in (way, other))
    seeds = seeds_between(two, one)
    score, rows = best_chain(seeds)
    chain = seeds.take(rows)
    assert score > 800.0
    assert np.abs(chain.second_m - chain.first_m - arc_length_m(way)[600]).max() < 6.0
    assert np.abs(np.degrees(chain.turn_rad) + 90.0).max() < 3.0
    assert best_chain(seeds_between(two, one, backwards=True))[0] < 0.5 * score


def test_a_chain_leaves_out_what_does_not_fit_its_order() -> None:
    first = np.arange(0.0, 1000.0, 50.0)
    place = np.concatenate([first, [475.0]]).astype(complex)
    second = np.concatenate([first + 7.0, [120.0]])
    order = np.argsort(place.real, kind="stable")
    count = len(order)
    seeds = Seeds(
        place.real[order], second[order], np.zeros(count), place[order],
        np.where(np.arange(count)[order] == count - 1, 9000.0, place[order]).astype(complex),
        np.zeros(count), np.ones(count), np.full(count, 50.0),
    )  # fmt: skip
    score, rows = best_chain(seeds)
    assert 475.0 not in seeds.first_m[rows]
    assert score == pytest.approx(50.0 * len(first))
    assert best_chain(seeds.take(np.zeros(0, np.int64)))[0] == 0.0


def test_the_way_in_an_outage_is_read_from_the_places_at_its_ends() -> None:
    # east for 300 m, around a block of 200 m that nobody saw, and on to the east
    corners = np.array([[0, 0], [300, 0], [300, 200], [500, 200], [500, 0], [900, 0]], float)
    moved = np.column_stack(
        [np.interp(np.arange(0.0, 1300.0, 5.0), arc_length_m(corners), c) for c in corners.T]
    )
    way = arc_length_m(moved)
    xy = np.array([[0, 0], [300, 0], [500, 0], [900, 0]], float)
    line = GnssLine(np.arange(4), xy, arc_length_m(xy), np.array([False, True, False, True]))
    for pairs in (([100.0], [100.0]), ([1200.0], [800.0]), ([100.0, 1200.0], [100.0, 800.0])):
        found = guided(moved, way, *(np.array(p) for p in pairs), line)
        on = (way < 300) | (way > 900)
        assert np.abs(found - np.where(way < 300, way, way - 400.0))[on].max() < 6.0
