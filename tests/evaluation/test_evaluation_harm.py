"""Harm is counted as the independent judge counts it, over real maps and every kind of damage."""

from __future__ import annotations

import copy
import json
import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lxml import etree

from flexmap_tasks.evaluation.harm import harm_done
from flexmap_tasks.evaluation.harm_geometry import shape_change
from flexmap_tasks.evaluation.routing import reachable_share, routing
from flexmap_tasks.evaluation.traffic_rules import can_pass, is_one_way, speed_limit_kmh
from flexmap_tasks.formats.osm_xml import read_osm_xml
from flexmap_tasks.ingest.lanelet_map import ingest_lanelet_map
from flexmap_tasks.model.maps import Findings, LaneletMap
from flexmap_tasks.model.source import Source

MAPS = ("garching/lanelet2_route_1.osm", "lanelet2/mapping_example.osm", "lanelet2/sample_map_planning.osm")
Damage = Callable[[Any, random.Random], None]


def load(path: Path) -> LaneletMap:
    """Also maps too broken to be ingested: they lie where lat and lon say."""
    document = read_osm_xml(path, path.name)
    east = np.cos(np.radians(np.nanmean(document.nodes.lonlat_deg[:, 1]))) * 111_320.0
    xyz = np.column_stack([document.nodes.lonlat_deg * (east, 111_320.0), np.zeros(len(document.nodes.id))])
    none = np.empty(0, dtype=object)
    return LaneletMap(document, xyz, Findings(none, none, none, np.empty(0, np.int64), none))


def lanelets(root: Any) -> list[Any]:
    return [r for r in root.iter("relation") if r.find("tag[@k='type'][@v='lanelet']") is not None]


def tag(element: Any, key: str, value: str) -> None:
    found = element.find(f"tag[@k='{key}']")
    if found is None:
        found = etree.SubElement(element, "tag", k=key)
    found.set("v", value)


def bound(root: Any, lanelet: Any, side: str) -> Any:
    ref = lanelet.find(f"member[@role='{side}']").get("ref")
    return root.find(f"way[@id='{ref}']")


def empty_speed(root: Any, chance: random.Random) -> None:
    for lanelet in chance.sample(lanelets(root), 30):
        tag(lanelet, "speed_limit", "")


def two_way(root: Any, chance: random.Random) -> None:
    for lanelet in chance.sample(lanelets(root), 40):
        tag(lanelet, "one_way", chance.choice(["no", "", "false", "x"]))


def close(root: Any, chance: random.Random) -> None:
    for lanelet in chance.sample(lanelets(root), 10):
        tag(lanelet, "subtype", chance.choice(["walkway", "bus_lane", "nonsense", ""]))
    for lanelet in chance.sample(lanelets(root), 10):
        tag(
            lanelet,
            chance.choice(["participant:vehicle", "participant:bicycle"]),
            chance.choice(["yes", "no"]),
        )


def lose_tags(root: Any, chance: random.Random) -> None:
    for kind in ("node", "way", "relation"):
        tags = [t for e in root.iter(kind) for t in e.iter("tag") if t.get("k") not in ("type", "subtype")]
        for t in chance.sample(tags, min(7, len(tags))):
            t.getparent().remove(t)


def lose_elements(root: Any, chance: random.Random) -> None:
    for lanelet in chance.sample(lanelets(root), 5):
        root.remove(lanelet)


def lose_metadata(root: Any, _: random.Random) -> None:
    for element in list(root):
        if element.tag not in ("node", "way", "relation"):
            root.remove(element)


def lose_members(root: Any, _: random.Random) -> None:
    for relation in [r for r in root.iter("relation") if r not in lanelets(root)][:3]:
        relation.remove(relation.find("member"))


def repeat_points(root: Any, chance: random.Random) -> None:
    for lanelet in chance.sample(lanelets(root), 6):
        way = bound(root, lanelet, "left")
        nodes = way.findall("nd")
        nodes[1].addprevious(copy.deepcopy(nodes[1]))


def one_point(root: Any, chance: random.Random) -> None:
    way = bound(root, chance.choice(lanelets(root)), "right")
    for nd in way.findall("nd")[1:]:
        way.remove(nd)


def double(root: Any, chance: random.Random) -> None:
    for lanelet in chance.sample(lanelets(root), 4):
        twin = copy.deepcopy(lanelet)
        twin.set("id", str(int(lanelet.get("id")) + 900_000_000))
        root.append(twin)


def disconnect(root: Any, chance: random.Random) -> None:
    for lanelet in chance.sample(lanelets(root), 8):
        way = bound(root, lanelet, "left")
        last = way.findall("nd")[-1]
        node = copy.deepcopy(root.find(f"node[@id='{last.get('ref')}']"))
        node.set("id", str(int(node.get("id")) + 800_000_000))
        root.insert(0, node)
        last.set("ref", node.get("id"))


def move(root: Any, chance: random.Random) -> None:
    for node in chance.sample(root.findall("node"), 25):
        node.set("lat", f"{float(node.get('lat')) + 2e-6:.11f}")


def dangle(root: Any, chance: random.Random) -> None:
    lanelet = chance.choice(lanelets(root))
    lanelet.find("member[@role='left']").set("ref", "123456789")


DAMAGE: tuple[Damage, ...] = (
    empty_speed, two_way, close, lose_tags, lose_elements, lose_metadata, lose_members, repeat_points, double,
    disconnect, move, one_point,
)  # fmt: skip
LEFT_OUT_WHEN_ZERO = (
    "new lanelets without two bounds", "new lanelets with a one-point bound", "new lanelets that share both bounds",
    "new lanelets with repeated points in a bound", "new ways with a missing node", "new relations with a missing member",
)  # fmt: skip
LIBRARY_ONLY = {"new load errors"}
LIBRARY_KEEPS_ONE_POINT = {"following edges short", "following edges in excess", "reachability lost (per mille)",
                           "lanelets with speed limit 0", "lanelets that became two-way"}  # fmt: skip


def judged(judge: Path, before: Path, after: Path, *more: str) -> dict[str, int]:
    run = subprocess.run(
        [sys.executable, str(judge), str(before), str(after), "--json", *more],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "total harm" in run.stdout, run.stderr
    found: dict[str, int] = json.loads(run.stdout[: run.stdout.rindex("total harm")])["harm"]
    return dict.fromkeys(LEFT_OUT_WHEN_ZERO, 0) | found


@pytest.mark.parametrize("name", MAPS)
def test_no_change_no_harm(shared_data: Path, name: str) -> None:
    lanelet_map = ingest_lanelet_map(Source(name, shared_data / name))
    harm = harm_done(lanelet_map, lanelet_map, moved=False)
    assert harm.total == 0
    assert harm.info["lanelets before"] > 100
    assert harm.info["following edges before"] > 200


@pytest.mark.parametrize("damage", DAMAGE, ids=lambda d: d.__name__)
def test_every_damage_counts_as_the_judge_counts_it(
    shared_data: Path, judge: Path, tmp_path: Path, damage: Damage
) -> None:
    name = "lanelet2/mapping_example.osm" if damage is lose_members else MAPS[2]
    before, after = shared_data / name, tmp_path / "after.osm"
    tree = etree.parse(before)
    damage(tree.getroot(), random.Random(damage.__name__))
    tree.write(after)
    expected = judged(judge, before, after)
    harm = harm_done(load(before), load(after), moved=False).counts
    skip = LIBRARY_ONLY | (LIBRARY_KEEPS_ONE_POINT if damage in (one_point,) else set())
    assert {k: v for k, v in harm.items() if k not in skip} == {
        k: v for k, v in expected.items() if k not in skip
    }
    assert sum(harm.values()) > 0


def test_a_dangling_bound_which_ends_the_library(shared_data: Path, tmp_path: Path) -> None:
    before, after = shared_data / MAPS[2], tmp_path / "after.osm"
    tree = etree.parse(before)
    dangle(tree.getroot(), random.Random(1))
    tree.write(after)
    harm = harm_done(load(before), load(after), moved=False).counts
    assert harm["new lanelets without two bounds"] == harm["new relations with a missing member"] == 1


def test_much_damage_at_once(shared_data: Path, judge: Path, tmp_path: Path) -> None:
    before, after = shared_data / MAPS[0], tmp_path / "after.osm"
    tree = etree.parse(before)
    for damage in (
        empty_speed,
        two_way,
        close,
        lose_tags,
        lose_elements,
        lose_metadata,
        repeat_points,
        double,
        disconnect,
    ):
        damage(tree.getroot(), random.Random(3))
    tree.write(after)
    removed = [r.get("id") for r in etree.parse(before).getroot().iter("relation")][:4]
    for more, options in (((), {"moved": False}), (("--moved",), {"moved": True})):
        expected = judged(judge, before, after, *more)
        harm = harm_done(load(before), load(after), **options).counts
        assert harm == {k: v for k, v in expected.items() if k not in LIBRARY_ONLY}
    expected = judged(judge, before, after, "--moved", "--deleted", *removed)
    harm = harm_done(load(before), load(after), moved=True, deleted=np.array(removed, dtype=np.int64)).counts
    assert harm == {k: v for k, v in expected.items() if k not in LIBRARY_ONLY}


def test_rules_as_the_library_reads_them() -> None:
    lanelet2 = pytest.importorskip("lanelet2")
    rules = lanelet2.traffic_rules.create(
        lanelet2.traffic_rules.Locations.Germany, lanelet2.traffic_rules.Participants.Vehicle
    )
    values = {
        "subtype": ("", "road", "highway", "play_street", "exit", "bus_lane", "walkway", "nonsense"),
        "location": ("", "urban", "nonurban"),
        "one_way": ("yes", "no", "", "false", "0", "x"), "one_way:vehicle": ("yes", "no"),
        "participant": ("yes", "no"), "participant:vehicle": ("yes", "no", "1"), "participant:bicycle": ("yes",),
        "speed_limit": ("", "0", "50", "50 km/h", "30 mph", "none", "10 m/s", "-5", "5e1", "50kmh", "50;30", ".5", "walk"),
        "speed_limit:vehicle": ("40", ""),
    }  # fmt: skip
    core, chance = lanelet2.core, random.Random(1)
    for _ in range(400):
        tags = {k: chance.choice(v) for k, v in values.items() if chance.random() < 0.4}
        lines = [
            core.LineString3d(core.getId(), [core.Point3d(core.getId(), x, y, 0) for x in (0, 10)])
            for y in (1, 0)
        ]
        lanelet = core.Lanelet(core.getId(), *lines)
        for key, value in tags.items():
            lanelet.attributes[key] = value
        limit = rules.speedLimit(lanelet).speedLimit
        assert can_pass(tags) == rules.canPass(lanelet), tags
        assert is_one_way(tags) == rules.isOneWay(lanelet), tags
        assert speed_limit_kmh(tags) == pytest.approx(float(getattr(limit, "value", limit))), tags


@pytest.mark.parametrize("name", MAPS)
def test_reach_is_what_walking_finds(shared_data: Path, name: str) -> None:
    routes = routing(ingest_lanelet_map(Source(name, shared_data / name)))
    follow: dict[int, set[int]] = {}
    for a, b in routes.follow.tolist():
        follow.setdefault(a, set()).add(b)
    total = 0
    for start in routes.lanelet_id.tolist():
        stack, seen = [start], {start}
        while stack:
            new = follow.get(stack.pop(), set()) - seen
            seen |= new
            stack.extend(new)
        total += len(seen)
    assert reachable_share(routes) == pytest.approx(total / len(routes.lanelet_id) ** 2)


def moved(lanelet_map: LaneletMap, xyz_m: np.ndarray) -> LaneletMap:
    return LaneletMap(lanelet_map.document, xyz_m, lanelet_map.findings)


def test_a_rigid_motion_changes_no_width_and_folds_nothing(shared_data: Path) -> None:
    lanelet_map = ingest_lanelet_map(Source("map", shared_data / MAPS[0]))
    turn = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
    change = shape_change(lanelet_map, moved(lanelet_map, lanelet_map.xyz_m @ turn.T + (100, -50, 3)))
    assert change.width_change_m.max() < 1e-9
    assert change.width_change_m.shape == (432 * 9,)
    assert not change.folded.any()
    assert change.skipped == 0


def test_a_stretch_changes_widths_and_a_mirror_folds_all(shared_data: Path) -> None:
    lanelet_map = ingest_lanelet_map(Source("map", shared_data / MAPS[0]))
    wide = shape_change(lanelet_map, moved(lanelet_map, lanelet_map.xyz_m * 1.1))
    assert wide.width_after_m == pytest.approx(1.1 * wide.width_before_m)
    flipped = lanelet_map.xyz_m * (-1, 1, 1)
    before = shape_change(lanelet_map, lanelet_map)
    change = shape_change(lanelet_map, moved(lanelet_map, flipped))
    assert change.folded.mean() > 0.9
    assert change.width_after_m == pytest.approx(before.width_after_m)
    crossed = lanelet_map.xyz_m.copy()
    way = slice(*lanelet_map.document.ways.offset[:2])
    rows = np.flatnonzero(np.isin(lanelet_map.document.nodes.id, lanelet_map.document.ways.ref[way]))
    crossed[rows[len(rows) // 2]] += (15, 15, 0)
    assert 0 < shape_change(lanelet_map, moved(lanelet_map, crossed)).folded.sum() < 20
