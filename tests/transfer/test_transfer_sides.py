from __future__ import annotations

from pathlib import Path

import pytest
from transfer_worlds import Draft, along_x, road, roads_of, rows, run

from flexmap_tasks.model.lanelets import lanelets_of
from flexmap_tasks.transfer.side_check import drives_on_the_right, side_lanes


@pytest.mark.parametrize(
    ("tags", "sense", "right_hand", "expected"),
    [
        ({}, 1, True, {}),
        ({"cycleway": "lane"}, 1, True, {"bicycle_lane": 1}),
        ({"cycleway:right": "lane", "cycleway:left": "no"}, 1, True, {"bicycle_lane": 1}),
        ({"cycleway:right": "lane", "cycleway:left": "no"}, -1, True, {"bicycle_lane": 0}),
        ({"cycleway:right": "lane", "cycleway:left": "no"}, 1, False, {"bicycle_lane": 0}),
        ({"cycleway": "track"}, 1, True, {}),
        ({"shoulder": "right"}, 1, True, {"road_shoulder": 1}),
        ({"shoulder": "right"}, -1, True, {"road_shoulder": 0}),
        ({"shoulder": "both", "oneway": "yes"}, 1, True, {"road_shoulder": 2}),
        ({"shoulder": "no"}, 1, True, {"road_shoulder": 0}),
        ({"busway:right": "lane"}, 1, True, {"bus_lane": 1}),
        ({"lanes:bus:forward": "2", "busway": "no"}, 1, True, {"bus_lane": 2}),
        ({"bus:lanes": "yes|yes|designated", "oneway": "yes"}, 1, True, {"bus_lane": 1}),
        ({"psv:lanes:backward": "designated|yes"}, -1, True, {"bus_lane": 1}),
        ({"lanes:bus": "many", "cycleway": ";;"}, 1, True, {}),
    ],
)
def test_side_lanes(tags: dict[str, str], sense: int, right_hand: bool, expected: dict[str, int]) -> None:
    assert side_lanes(tags, sense, right_hand) == expected


def test_driving_side_is_read_from_the_map(tmp_path: Path) -> None:
    draft = Draft()
    low, middle, high = (draft.way([draft.node(0.0, y), draft.node(50.0, y)]) for y in (-3.5, 0.0, 3.5))
    draft.lanelet(middle, low)
    draft.lanelet(middle, high)
    assert drives_on_the_right(lanelets_of(draft.read(tmp_path)))
    mirrored = Draft(last=0)
    low, middle, high = (
        mirrored.way([mirrored.node(0.0, y), mirrored.node(50.0, y)]) for y in (-3.5, 0.0, 3.5)
    )
    mirrored.lanelet(low, middle)
    mirrored.lanelet(high, middle)
    assert not drives_on_the_right(lanelets_of(mirrored.read(tmp_path)))


def test_what_the_map_lacks_is_told_once_per_carriageway(tmp_path: Path) -> None:
    draft = Draft()
    full, bare = road(draft, [60.0], 2, 1), road(draft, [60.0], 2, 1)
    edge = draft.way([draft.node(x, -10.0) for x in (0.0, 60.0)])
    draft.lanelet(full.bounds[0][0], edge, subtype="bicycle_lane")
    before = draft.read(tmp_path)
    after = run(before, along_x(before, []), roads_of([{"cycleway:right": "lane", "busway:right": "lane"}]))
    (row,) = rows(after, key="bicycle_lane")
    assert row["lanelet_id"] in bare.forward[0]
    assert (row["old"], row["new"], row["action"]) == ("0", "1", "review")
    assert not rows(after, key="bus_lane")
