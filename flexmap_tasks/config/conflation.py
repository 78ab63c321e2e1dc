"""How OpenStreetMap's knowledge reaches the lanelets."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from flexmap_tasks.config.base import NonNegative, Params, Positive, Share


class CollapseParams(Params):
    """Adjacent lanelets become one centreline."""

    lane_subtypes: tuple[str, ...] = Field(
        ("road", "highway", "play_street", "bus_lane"), description="subtypes that count as lanes"
    )
    driving_side: Literal["right", "left"] = "right"
    connect_distance_m: Positive = Field(1.0, description="ends nearer than this become one point")


class PathParams(Params):
    """Matching of all lanelet paths as paths on the road graph, at once."""

    spacing_m: Positive = Field(5.0, description="distance between samples along the lanelets")
    radius_m: Positive = Field(20.0, description="roads further away than this are no candidates")
    candidates: Annotated[int, Field(ge=1, le=30)] = Field(8, description="candidates per sample")
    correlation_m: Positive = Field(
        20.0, description="roads are displaced as a whole: samples nearer than this say the same thing"
    )
    sigma_start_m: Positive = Field(3.0, description="scatter of roads before it is estimated")
    angle_sigma_deg: Positive = 12.0
    absent_cost: NonNegative = Field(
        3.75, description="misfit of a sample at which no counterpart is as likely"
    )
    absent_cost_start: NonNegative = Field(
        5.0, description="the same while it is still being estimated by how much roads are displaced"
    )
    gap_cost: NonNegative = Field(3.0, description="misfit for a change between a road and no counterpart")
    jump_cost: NonNegative = Field(5.0, description="misfit for a change to a road that is not connected")
    detour_m: Positive = Field(4.0, description="metres of detour per unit of misfit")
    wrong_way_cost: NonNegative = Field(2.0, description="misfit for driving against a one-way road")
    level_cost: NonNegative = Field(
        2.0,
        description="misfit for the lower of two roads above each other on a bridge, or the upper below it",
    )
    minor_cost: NonNegative = Field(0.5, description="misfit for service roads for few, and private roads")
    narrow_cost: NonNegative = Field(
        3.0,
        description="misfit of a road too small for several lanes in one direction, where the map has them",
    )
    rounds: Annotated[int, Field(ge=1, le=10)] = Field(3, description="estimates of displacement and scatter")
    review_confidence: Share = Field(0.7, description="a less certain match goes to review")


class MatchParams(Params):
    """How lanelets find their roads. All but `path` belongs to buffer growing, with the original's defaults."""

    method: Literal["path", "buffer_growing"] = Field(
        "path",
        description="path: all lanelet paths at once; buffer_growing: the paper's (Zhang and Meng 2005)",
    )
    path: PathParams = PathParams()
    segment_length_m: Positive = 5.0
    reference_angle_max_deg: Positive = Field(
        30.0, description="a reference polyline ends at a sharper corner"
    )
    buffer_half_width_m: Positive = 2.5
    buffer_overshoot_m: NonNegative = 3.0
    buffer_corner: Share = Field(0.5, description="how much of the buffer's corner is cut")
    enlargement_factor: Annotated[float, Field(gt=1)] = 1.5
    enlargements: Annotated[int, Field(ge=1, le=10)] = Field(3, description="rounds, the first included")
    angle_max_deg: Positive = 20.0
    length_max_m: Positive = 20.0
    chord_max_m: Positive = 15.0
    area_max_m: Positive = Field(10.0, description="enclosed area over length")
    weight_angle: NonNegative = 0.35
    weight_length: NonNegative = 0.2
    weight_chord: NonNegative = 0.35
    weight_area: NonNegative = 0.1


class TransferRule(Params):
    """One row of the mapping table: an OSM key and where its value goes."""

    key: str = Field(description="OSM tag")
    variants: tuple[str, ...] = Field((), description="OSM tags read, in this order, where `key` is absent")
    target: str = Field(description="Lanelet2 attribute")
    parser: Literal["text", "word", "speed", "subtype", "location", "oneway"] = "text"
    element: Literal["tag", "speed_limit_rule"] = Field(
        "tag", description="write a tag of the lanelet, or a Lanelet2 speed limit rule it refers to"
    )
    policy: Literal["osm_wins", "fill_only", "review_conflicts"] = Field(
        "osm_wins", description="when the map has another value: replace it, leave it, or ask a person"
    )

    @model_validator(mode="after")
    def _speed_rule(self) -> TransferRule:
        if self.element == "speed_limit_rule" and (self.parser, self.target) != ("speed", "speed_limit"):
            raise ValueError("element speed_limit_rule needs parser speed and target speed_limit")
        return self


DEFAULT_RULES = (
    TransferRule(key="highway", target="subtype", parser="subtype"),
    TransferRule(key="highway", target="location", parser="location"),
    TransferRule(key="maxspeed", target="speed_limit", parser="speed"),
    TransferRule(key="name", variants=("official_name", "loc_name"), target="road_name"),
    TransferRule(key="surface", target="road_surface", parser="word"),
    TransferRule(key="oneway", target="one_way", parser="oneway"),
    TransferRule(key="lane_markings", target="lane_markings", parser="word"),
)

HIGHWAY_SUBTYPES = {
    "motorway": "highway", "motorway_link": "highway", "trunk": "highway", "trunk_link": "highway",
    "primary": "road", "primary_link": "road", "secondary": "road", "secondary_link": "road",
    "tertiary": "road", "tertiary_link": "road", "unclassified": "road", "residential": "road",
    "service": "road", "road": "road", "track": "road", "living_street": "play_street",
    "busway": "bus_lane", "cycleway": "bicycle_lane", "pedestrian": "walkway", "footway": "walkway",
}  # fmt: skip

ZONE_SPEEDS_KMH: dict[str, float | Literal["none"]] = {
    "at:urban": 50, "at:rural": 100, "at:trunk": 100, "at:motorway": 130, "at:living_street": 7,
    "be:urban": 50, "be:motorway": 120, "be:living_street": 20,
    "be-bru:urban": 30, "be-bru:rural": 70, "be-vlg:urban": 50, "be-vlg:rural": 70,
    "be-wal:urban": 50, "be-wal:rural": 90,
    "bg:urban": 50, "bg:rural": 90, "by:urban": 60, "by:rural": 90, "by:motorway": 110,
    "ch:urban": 50, "ch:rural": 80, "ch:trunk": 100, "ch:motorway": 120, "ch:living_street": 20,
    "cz:urban": 50, "cz:rural": 90, "cz:motorway": 130, "cz:living_street": 20,
    "de:urban": 50, "de:rural": 100, "de:motorway": "none", "de:living_street": 7, "de:bicycle_road": 30,
    "dk:urban": 50, "dk:rural": 80, "dk:motorway": 130,
    "es:urban": 50, "es:rural": 90, "es:motorway": 120, "es:living_street": 20,
    "fi:urban": 50, "fi:rural": 80, "fi:motorway": 120, "fi:living_street": 20,
    "fr:urban": 50, "fr:rural": 80, "fr:motorway": 130, "fr:living_street": 20,
    "gb:nsl_single": 96.56, "gb:nsl_dual": 112.65, "gb:nsl_restricted": 48.28, "gb:motorway": 112.65,
    "hr:urban": 50, "hr:rural": 90, "hr:trunk": 110, "hr:motorway": 130,
    "hu:urban": 50, "hu:rural": 90, "hu:trunk": 110, "hu:motorway": 130, "hu:living_street": 20,
    "it:urban": 50, "it:rural": 90, "it:trunk": 110, "it:motorway": 130,
    "lu:urban": 50, "lu:rural": 90, "lu:living_street": 20,
    "nl:urban": 50, "nl:rural": 80, "nl:trunk": 100, "nl:living_street": 15,
    "no:urban": 50, "no:rural": 80,
    "pl:urban": 50, "pl:rural": 90, "pl:motorway": 140, "pl:living_street": 20,
    "pt:urban": 50, "pt:rural": 90, "pt:trunk": 100, "pt:motorway": 120, "pt:living_street": 20,
    "ro:urban": 50, "ro:rural": 90, "ro:trunk": 100, "ro:motorway": 130,
    "ru:urban": 60, "ru:rural": 90, "ru:motorway": 110, "ru:living_street": 20,
    "se:urban": 50, "se:rural": 70, "se:motorway": 110, "se:living_street": 7,
    "si:urban": 50, "si:rural": 90, "si:trunk": 110, "si:motorway": 130, "si:living_street": 10,
    "sk:urban": 50, "sk:rural": 90, "sk:motorway": 130, "sk:living_street": 20,
    "ua:urban": 50, "ua:rural": 90, "ua:trunk": 110, "ua:motorway": 130, "ua:living_street": 20,
    "uk:nsl_single": 96.56, "uk:nsl_dual": 112.65, "uk:nsl_restricted": 48.28, "uk:motorway": 112.65,
}  # fmt: skip
"""Limits that OSM names by country and zone, in lower case."""


class TransferParams(Params):
    """What OSM's tags become on the lanelets."""

    rules: tuple[TransferRule, ...] = DEFAULT_RULES
    highway_subtypes: dict[str, str] = Field(HIGHWAY_SUBTYPES, description="OSM highway to Lanelet2 subtype")
    zone_speeds_kmh: dict[str, float | Literal["none"]] = Field(
        ZONE_SPEEDS_KMH, description="limit behind a maxspeed code such as DE:urban; codes in lower case"
    )
    no_limit_kmh: Positive | None = Field(None, description="written for maxspeed=none; review when empty")
    confidence_min: Share = Field(0.5, description="a match less certain than this changes nothing")
    coverage_min: Share = Field(0.5, description="less of a lanelet matched goes to review")
    split: bool = Field(True, description="cut lanelets where a transferred value changes")
    split_end_distance_m: Positive = Field(3.0, description="no cut nearer to an end than this")
    split_snap_m: NonNegative = Field(1.0, description="cut at an existing vertex when one is this near")
    split_stretch_m: NonNegative = Field(5.0, description="a value that holds for less is not worth a cut")
    split_gap_m: Positive = Field(20.0, description="an unmatched end longer than this is cut off")
    split_junctions: bool = Field(
        False,
        description="also cut lanelets that fork, merge or turn; else the longer part decides for the whole",
    )
    junction_max_m: Positive = Field(50.0, description="a longer lanelet is no mere way through a junction")
    split_everywhere: bool = Field(
        False, description="also cut carriageways with lanelets that are closed to cars or driven both ways"
    )
    remove_fragments: bool = Field(False, description="delete unconnected lanelets beyond OSM's lane count")
    speed_jump_kmh: Positive = Field(
        50.0,
        description="a short stretch this much faster, or slower, than before and after it goes to review",
    )
    speed_jump_max_m: NonNegative = Field(100.0, description="a longer stretch is believed; 0 believes all")
    lanes_far: Annotated[int, Field(ge=1)] = Field(
        2, description="a lane count this far from OSM's goes to review"
    )
    provenance_tags: bool = Field(
        False, description="write way, version and time beside every value: source:<key>"
    )
    lane_check_tags: bool = Field(False, description="write the verdict of the lane check: lane_check")

    @model_validator(mode="after")
    def _one_rule_per_target(self) -> TransferParams:
        targets = [rule.target for rule in self.rules]
        twice = sorted({t for t in targets if targets.count(t) > 1})
        if twice:
            raise ValueError(f"two rules write {twice[0]}: give one, with the other key among its `variants`")
        return self


class GapsParams(Params):
    """What one of the two maps has and the other has not."""

    corridor_m: Positive = Field(15.0, description="roads within this distance of mapped lanes are asked for")
    shortest_m: NonNegative = Field(10.0, description="shorter stretches are not worth a row")


class ConflationParams(Params):
    """How OpenStreetMap's knowledge reaches the lanelets."""

    collapse: CollapseParams = CollapseParams()
    match: MatchParams = MatchParams()
    gaps: GapsParams = GapsParams()
    transfer: TransferParams = TransferParams()
    review_file: Path | None = Field(
        None, description="CSV of people's decisions on what is up for review; flexmap edit writes it"
    )
