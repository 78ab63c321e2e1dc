"""Real maps under made-up roads, looked at by a judge that shares no code with the project."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from transfer_worlds import matches_of, read, roads_of, run, save

from flexmap_tasks.config import TransferParams
from flexmap_tasks.model.conflation import Enriched, Matches
from flexmap_tasks.model.lanelets import centrelines, follow_pairs, lanelets_of, lengths_m
from flexmap_tasks.model.maps import LaneletMap

lanelet2 = pytest.importorskip("lanelet2")

MAPS = ("garching/lanelet2_route_1.osm", "lanelet2/mapping_example.osm", "lanelet2/sample_map_planning.osm")
TAGS = [
    {
        "highway": "secondary",
        "maxspeed": "50",
        "name": "Ost",
        "oneway": "no",
        "surface": "asphalt",
        "lanes": "2",
    },
    {"highway": "residential", "maxspeed": "30 mph", "oneway": "reversible", "lanes": "variable"},
    {"highway": "living_street", "name": "West", "maxspeed": "walk", "oneway": "no"},
    {"highway": "motorway", "oneway": "yes", "maxspeed": "none", "lanes": "1"},
    {"highway": "service", "maxspeed": "", "name": "", "surface": "", "oneway": ""},
    {"highway": "tertiary", "maxspeed:forward": "70", "maxspeed:backward": "DE:urban", "surface": "sett"},
    {"highway": "busway", "maxspeed": "0", "oneway": "-1"},
]


def made_up_matches(lanelet_map: LaneletMap, seed: int) -> Matches:
    """Every lanelet is matched piece by piece to changing ways, each lanelet at places of its own."""
    lanelets = lanelets_of(lanelet_map)
    length = lengths_m(centrelines(lanelet_map, lanelets))
    random = np.random.default_rng(seed)
    rows = []
    for k in range(len(lanelets)):
        stops = np.sort(random.uniform(0.0, length[k], random.choice(4, p=[0.7, 0.1, 0.1, 0.1])))
        edges = [0.0, *stops.tolist(), float(length[k])]
        for a, b in pairwise(edges):
            if random.uniform() < 0.9:
                rows.append(
                    (
                        int(lanelets.id[k]),
                        a,
                        b,
                        int(random.integers(1, len(TAGS) + 1)) * 100,
                        1 - 2 * int(random.integers(0, 2)),
                    )
                )
    return matches_of(rows)


def judged(
    judge: Path, before: Path, after: Path, deleted: list[int] | None = None
) -> tuple[dict[str, int], dict[str, float]]:
    command = [sys.executable, str(judge), str(before), str(after), "--json"]
    command += ["--deleted", *map(str, deleted)] if deleted else []
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    text = done.stdout[: done.stdout.rindex("}") + 1]
    found = json.loads(text)
    return found["harm"], found["info"]


def read_speeds_kmh(path: Path, lonlat: tuple[float, float]) -> dict[int, float]:
    """Speed of every lanelet as Lanelet2's own rules read it."""
    rules = lanelet2.traffic_rules.create(
        lanelet2.traffic_rules.Locations.Germany, lanelet2.traffic_rules.Participants.Vehicle
    )
    projector = lanelet2.projection.UtmProjector(lanelet2.io.Origin(lonlat[1], lonlat[0]))
    loaded, _ = lanelet2.io.loadRobust(str(path), projector)
    return {
        x.id: float(rules.speedLimit(x).speedLimit) for x in loaded.laneletLayer if not x.regulatoryElements
    }


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("seed", [1, 2])
def test_no_harm(shared_data: Path, judge: Path, tmp_path: Path, name: str, seed: int) -> None:
    source = shared_data / name
    before = read(source)
    after = run(before, made_up_matches(before, seed), roads_of(TAGS))
    saved = save(after.map, tmp_path / "after.osm")
    harm, info = judged(judge, source, saved)
    assert {k: v for k, v in harm.items() if v} == {}
    cut = int((after.transfers.action == "split").sum())
    assert info["lanelets after"] - info["lanelets before"] == cut > 0
    speeds = read_speeds_kmh(saved, tuple(before.document.nodes.lonlat_deg[0]))
    told = told_speeds(after)
    assert len(told) > 20
    for lanelet, value in told.items():
        if lanelet in speeds:
            assert speeds[lanelet] == pytest.approx(value, abs=0.01)


@pytest.mark.parametrize("name", MAPS)
def test_cuts_keep_every_way_through_the_map(shared_data: Path, name: str) -> None:
    before = read(shared_data / name)
    after = run(before, made_up_matches(before, 5), roads_of(TAGS))
    cut = np.flatnonzero(after.transfers.action == "split")
    source = dict(
        zip(
            after.transfers.lanelet_id[cut].tolist(),
            after.transfers.source_lanelet_id[cut].tolist(),
            strict=True,
        )
    )
    pairs = [(source.get(a, a), source.get(b, b)) for a, b in followers(after.map)]
    assert {p for p in pairs if p[0] != p[1]} == set(followers(before))
    assert len(pairs) == len(followers(before)) + len(cut)


def followers(lanelet_map: LaneletMap) -> list[tuple[int, int]]:
    lanelets = lanelets_of(lanelet_map)
    return [(a, b) for a, b in lanelets.id[follow_pairs(lanelet_map, lanelets)].tolist()]


@pytest.mark.parametrize("name", MAPS)
def test_removing_fragments_does_no_other_harm(
    shared_data: Path, judge: Path, tmp_path: Path, name: str
) -> None:
    source = shared_data / name
    before = read(source)
    ids = lanelets_of(before).id
    length = lengths_m(centrelines(before, lanelets_of(before)))
    matched = [(int(i), 0.0, float(s), 100, 1) for i, s in zip(ids, length, strict=True) if int(i) % 7]
    params = TransferParams(remove_fragments=True)
    after = run(before, matches_of(matched), roads_of([{"highway": "residential", "lanes": "1"}]), params)
    gone = after.transfers.lanelet_id[after.transfers.action == "remove"].tolist()
    assert sorted(set(ids.tolist()) - set(lanelets_of(after.map).id.tolist())) == sorted(gone)
    harm, _ = judged(judge, source, save(after.map, tmp_path / "after.osm"), gone)
    assert {k: v for k, v in harm.items() if v} == {}


def told_speeds(after: Enriched) -> dict[int, float]:
    table = after.transfers
    at = np.flatnonzero((table.key == "speed_limit") & (table.action == "set"))
    return {int(table.lanelet_id[i]): float(table.new[i]) for i in at}


@pytest.mark.parametrize("name", MAPS)
def test_nothing_in_osm_changes_nothing(shared_data: Path, tmp_path: Path, name: str) -> None:
    before = read(shared_data / name)
    after = run(before, matches_of([]), roads_of([]))
    assert save(after.map, tmp_path / "a.osm").read_bytes() == save(before, tmp_path / "b.osm").read_bytes()


def test_same_inputs_same_bytes(shared_data: Path, tmp_path: Path) -> None:
    before = read(shared_data / MAPS[1])
    maps = [run(before, made_up_matches(before, 3), roads_of(TAGS)).map for _ in range(2)]
    assert save(maps[0], tmp_path / "a.osm").read_bytes() == save(maps[1], tmp_path / "b.osm").read_bytes()


def broken(lanelet_map: LaneletMap, random: np.random.Generator) -> LaneletMap:
    """The map with ways and relations that say nonsense."""
    document = lanelet_map.document
    ways, relations = document.ways, document.relations
    ref, kind, member, role = (
        c.copy() for c in (ways.ref, relations.member_type, relations.member_ref, relations.member_role)
    )
    for i in random.integers(0, len(ways.id), 20).tolist():
        at = slice(int(ways.offset[i]), int(ways.offset[i + 1]))
        nodes = ref[at]
        ref[at] = [nodes[::-1], np.roll(nodes, 1), np.full(len(nodes), nodes[0]), np.full(len(nodes), 10**9)][
            random.integers(0, 4)
        ]
    for i in random.integers(0, len(member), 25).tolist():
        member[i] = [random.choice(ways.id), random.choice(relations.id), -5][random.integers(0, 3)]
        kind[i] = str(random.choice(["node", "way", "relation"]))
        role[i] = str(random.choice(["left", "right", "centerline", "regulatory_element", "outer", ""]))
    changed = replace(relations, member_type=kind, member_ref=member, member_role=role)
    return replace(lanelet_map, document=replace(document, ways=replace(ways, ref=ref), relations=changed))


@pytest.mark.parametrize("seed", range(8))
def test_broken_maps_end_nothing_and_lose_nothing(shared_data: Path, seed: int) -> None:
    whole = read(shared_data / MAPS[1 + seed % 2])
    before = broken(whole, np.random.default_rng(seed))
    params = TransferParams(split_everywhere=seed % 4 < 2, split_junctions=True, remove_fragments=True)
    after = run(before, made_up_matches(whole, seed), roads_of(TAGS), params)
    gone = after.transfers.lanelet_id[after.transfers.action == "remove"]
    for kind in ("nodes", "ways", "relations"):
        ids = getattr(after.map.document, kind).id
        assert np.isin(np.setdiff1d(getattr(before.document, kind).id, gone), ids).all()
        assert len(np.unique(ids)) == len(ids)
