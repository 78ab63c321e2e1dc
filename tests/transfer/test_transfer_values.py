from __future__ import annotations

import math

import pytest

from flexmap_tasks.config import TransferParams, TransferRule
from flexmap_tasks.transfer.values import (
    Around,
    Offer,
    count,
    format_kmh,
    offer,
    one_way_sense,
    same_value,
    speed_kmh,
)

PARAMS = TransferParams()
SPEED = TransferRule(key="maxspeed", target="speed_limit", parser="speed")
LOCATION = TransferRule(key="highway", target="location", parser="location")
SUBTYPE = TransferRule(key="highway", target="subtype", parser="subtype")
ONEWAY = TransferRule(key="oneway", target="one_way", parser="oneway")
NAME = TransferRule(key="name", target="road_name")
SURFACE = TransferRule(key="surface", target="road_surface", parser="word")


@pytest.mark.parametrize(
    ("text", "kmh"),
    [
        ("50", 50.0), ("50 km/h", 50.0), ("50km/h", 50.0), ("30 mph", 48.28032), ("30mph", 48.28032),
        ("walk", 7.0), ("10 knots", 18.52), ("none", math.inf), ("DE:urban", 50.0), ("DE:rural", 100.0), ("DE:zone30", 30.0),
        ("DE:zone:30", 30.0), ("RU:60", 60.0), ("RU:rural", 90.0), ("AT:zone30", 30.0), ("be-vlg:rural", 70.0), ("DE:motorway", math.inf), ("50;50", 50.0), (" 80 ", 80.0),
        ("50;30", None), ("signals", None), ("variable", None), ("", None), ("fast", None), ("GB:zone20", None),
        ("-50", None), ("1e3", None), ("٥٠", None), ("50,5", None), ("nan", None),
    ],
)  # fmt: skip
def test_speed_texts(text: str, kmh: float | None) -> None:
    found = speed_kmh(text, PARAMS.zone_speeds_kmh)
    assert found == pytest.approx(kmh) if kmh is not None else found is None


def test_the_speed_lanelet2_reads_is_the_speed_meant() -> None:
    lanelet2 = pytest.importorskip("lanelet2")
    core = lanelet2.core
    rules = lanelet2.traffic_rules.create(
        lanelet2.traffic_rules.Locations.Germany, lanelet2.traffic_rules.Participants.Vehicle
    )
    for text in ("50", "30 mph", "walk", "DE:rural", "7", "12.5"):
        meant = speed_kmh(text, PARAMS.zone_speeds_kmh)
        left = core.LineString3d(1, [core.Point3d(2, 0, 1, 0), core.Point3d(3, 1, 1, 0)])
        right = core.LineString3d(4, [core.Point3d(5, 0, 0, 0), core.Point3d(6, 1, 0, 0)])
        lanelet = core.Lanelet(7, left, right)
        lanelet.attributes["subtype"] = "road"
        assert meant is not None
        lanelet.attributes["speed_limit"] = format_kmh(meant)
        assert rules.speedLimit(lanelet).speedLimit == pytest.approx(meant, abs=0.01)


@pytest.mark.parametrize(
    ("tags", "sense", "expected"),
    [
        ({"maxspeed": "50"}, 1, Offer("50")),
        ({"maxspeed": "50", "maxspeed:backward": "30"}, -1, Offer("30")),
        ({"maxspeed": "50", "maxspeed:backward": "30"}, 1, Offer("50")),
        ({"maxspeed": ""}, 1, Offer()),
        ({}, 1, Offer()),
        ({"maxspeed:lanes": "80|80"}, 1, Offer("80")),
        ({"maxspeed": "30 mph"}, 1, Offer("48.28")),
    ],
)
def test_speed_by_direction(tags: dict[str, str], sense: int, expected: Offer) -> None:
    assert offer(SPEED, tags, sense, PARAMS) == expected


def test_a_lanelet_driven_both_ways_needs_one_value_for_both() -> None:
    assert offer(SPEED, {"maxspeed": "50", "maxspeed:forward": "30"}, 0, PARAMS).problem
    assert offer(SPEED, {"maxspeed:backward": "30", "maxspeed:forward": "30"}, 0, PARAMS) == Offer("30")
    assert offer(ONEWAY, {"oneway": "no"}, 0, PARAMS) == Offer()
    assert offer(ONEWAY, {"oneway": "-1"}, 0, PARAMS) == Offer("yes")


def test_variants_stand_in() -> None:
    rule = TransferRule(key="name", variants=("official_name", "loc_name"), target="road_name")
    assert offer(rule, {"loc_name": "B", "official_name": "A", "name": " "}, 1, PARAMS) == Offer("A")
    assert offer(rule, {"loc_name": "B", "name": "C"}, 1, PARAMS) == Offer("C")


@pytest.mark.parametrize("text", ["none", "signals", "0", "999", "50;30", "x" * 1000])
def test_speeds_for_a_person(text: str) -> None:
    found = offer(SPEED, {"maxspeed": text}, 1, PARAMS)
    assert found.problem
    assert len(found.value) <= 255


def test_no_limit_can_be_given_a_number() -> None:
    assert offer(SPEED, {"maxspeed": "none"}, 1, TransferParams(no_limit_kmh=130)) == Offer("130")


def test_a_conditional_limit_is_told_beside_the_plain_one() -> None:
    tags = {"maxspeed": "50", "maxspeed:conditional": "30 @ (22:00-06:00)"}
    assert offer(SPEED, tags, 1, PARAMS) == Offer("50", also="maxspeed:conditional=30 @ (22:00-06:00)")


@pytest.mark.parametrize(
    ("tags", "expected"),
    [
        ({"highway": "motorway"}, Offer("nonurban")),
        ({"highway": "trunk_link", "maxspeed": "80"}, Offer("nonurban")),
        ({"highway": "trunk", "maxspeed": "50"}, Offer("urban", weak=True)),
        ({"highway": "primary"}, Offer()),
        ({"highway": "primary", "maxspeed": "100"}, Offer("nonurban", weak=True)),
        (
            {"highway": "tertiary", "maxspeed:forward": "70", "maxspeed:backward": "50"},
            Offer("nonurban", weak=True),
        ),
        ({"highway": "tertiary", "maxspeed": "30"}, Offer("urban", weak=True)),
        ({"highway": "tertiary", "maxspeed": "60"}, Offer()),
        ({"highway": "primary", "zone:traffic": "DE:rural"}, Offer("nonurban")),
        ({"highway": "primary", "source:maxspeed": "DE:urban"}, Offer("urban")),
        ({"highway": "trunk", "source:maxspeed": "DE:urban"}, Offer("urban")),
        ({"highway": "residential", "source:maxspeed": "DE:zone30"}, Offer("urban")),
        ({"highway": "residential", "maxspeed:type": "sign"}, Offer("urban", weak=True)),
        ({"highway": "living_street"}, Offer("urban")),
        ({"maxspeed": "DE:urban"}, Offer()),
    ],
)
def test_location(tags: dict[str, str], expected: Offer) -> None:
    found = offer(LOCATION, tags, 1, PARAMS)
    assert (found.value, found.weak, found.problem) == (expected.value, expected.weak, "")


@pytest.mark.parametrize(
    ("around", "tags", "value", "weak"),
    [
        (Around(built_up=0.8), {}, "urban", True),
        (Around(open_land=0.8), {}, "nonurban", True),
        (Around(built_up=0.3, open_land=0.3), {}, "", False),
        (Around(open_land=0.8), {"maxspeed": "100"}, "nonurban", False),
        (Around(built_up=0.8), {"maxspeed": "100"}, "urban", True),
        (Around(city_limit=1), {"maxspeed": "100"}, "urban", False),
        (Around(city_limit=-1), {"maxspeed": "50"}, "nonurban", False),
        (Around(city_limit=-1), {"zone:traffic": "DE:urban"}, "urban", False),
        (Around(built_up=1.0), {"source:maxspeed": "DE:rural"}, "nonurban", False),
    ],
)
def test_location_by_what_lies_along_the_road(
    around: Around, tags: dict[str, str], value: str, weak: bool
) -> None:
    found = offer(LOCATION, {"highway": "secondary"} | tags, 1, PARAMS, around)
    assert (found.value, found.weak, found.problem) == (value, weak, "")


def test_contradicting_zones_are_for_a_person() -> None:
    tags = {"highway": "primary", "zone:traffic": "DE:rural", "source:maxspeed": "DE:urban"}
    assert offer(LOCATION, tags, 1, PARAMS).problem


@pytest.mark.parametrize(
    ("tags", "sense"),
    [
        ({"oneway": "yes"}, 1), ({"oneway": "-1"}, -1), ({"oneway": "no"}, 0), ({}, 0), ({"oneway": "1"}, 1),
        ({"junction": "roundabout"}, 1), ({"junction": "roundabout", "oneway": "no"}, 0),
        ({"highway": "motorway"}, 1), ({"oneway": "reversible"}, None), ({"oneway": "banana"}, None),
    ],
)  # fmt: skip
def test_one_way_sense(tags: dict[str, str], sense: int | None) -> None:
    assert one_way_sense(tags) == sense


def test_a_road_offers_one_way_only_along_itself() -> None:
    assert offer(ONEWAY, {"oneway": "yes"}, 1, PARAMS) == Offer("yes")
    assert offer(ONEWAY, {"oneway": "-1"}, -1, PARAMS) == Offer("yes")
    assert offer(ONEWAY, {"oneway": "yes"}, -1, PARAMS) == Offer()
    assert offer(ONEWAY, {"oneway": "no"}, 1, PARAMS) == Offer()
    assert offer(ONEWAY, {"oneway": "reversible"}, 1, PARAMS).problem


def test_words_and_names() -> None:
    assert offer(NAME, {"name": " Am Coulombwall "}, 1, PARAMS) == Offer("Am Coulombwall")
    assert offer(NAME, {"name": "-"}, 1, PARAMS) == Offer()
    assert offer(NAME, {"name": "a\tb"}, 1, PARAMS).problem
    assert offer(SURFACE, {"surface": "Asphalt"}, 1, PARAMS) == Offer("asphalt")
    assert offer(SURFACE, {"surface": "asphalt;sett"}, 1, PARAMS).problem
    assert offer(SUBTYPE, {"highway": "living_street"}, 1, PARAMS) == Offer("play_street")
    assert offer(SUBTYPE, {"highway": "proposed"}, 1, PARAMS) == Offer()


def test_same_meaning() -> None:
    assert same_value(SPEED, "50.0", "50")
    assert same_value(SPEED, "30 mph", "48.28")
    assert not same_value(SPEED, "", "50")
    assert same_value(ONEWAY, "true", "yes")
    assert not same_value(NAME, "a", "b")


@pytest.mark.parametrize(
    ("text", "lanes"), [("2", 2), ("variable", None), ("1.5", None), ("0", None), ("-1", None), ("999", None)]
)
def test_lane_numbers(text: str, lanes: int | None) -> None:
    assert count(text) == lanes


def test_two_rules_for_one_attribute_are_refused() -> None:
    with pytest.raises(ValueError, match="two rules write road_name"):
        TransferParams(rules=(NAME, TransferRule(key="ref", target="road_name")))


def test_a_speed_limit_rule_takes_speeds_only() -> None:
    with pytest.raises(ValueError, match="speed_limit_rule"):
        TransferRule(key="name", target="road_name", element="speed_limit_rule")
