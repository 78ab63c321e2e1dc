"""Garbage in OpenStreetMap never ends a run: a real extract broken in many places, through matching and transfer."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lxml import etree

from flexmap_tasks.config import CollapseParams, GapsParams, MatchParams, OsmRoadsParams, TransferParams
from flexmap_tasks.ingest.lanelet_map import ingest_lanelet_map
from flexmap_tasks.ingest.osm_roads import ingest_osm_roads
from flexmap_tasks.matching.collapse import collapse
from flexmap_tasks.matching.gaps import find_gaps
from flexmap_tasks.matching.match import match
from flexmap_tasks.matching.road_changes import road_changes
from flexmap_tasks.model.lanelets import lanelets_of
from flexmap_tasks.model.maps import LaneletMap, PlacedRoads
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.source import Source
from flexmap_tasks.transfer.transfer import transfer

ORIGIN = (11.669079695833185, 48.264367644601826)
VALUES = (
    "", " ", "0", "-1", "1e9", "NaN", "inf", "viele", "2;3", "2,5", "30 @ (Mo-Fr)", "none", "walk", "\u202ename", "x" * 9999,
    "DE:urban", "DE:", "||", "left|through;right|", "yes", "no", "-1", "reversible", "alternating", "50 knots", "\u0661\u0662",
)  # fmt: skip
KEYS = (
    "highway", "lanes", "lanes:forward", "maxspeed", "maxspeed:forward", "maxspeed:lanes", "oneway", "name", "surface",
    "layer", "bridge", "junction", "area", "turn:lanes", "busway", "cycleway:right", "shoulder", "zone:traffic", "access",
    "landuse", "traffic_sign", "direction", "maxspeed:conditional",
)  # fmt: skip


class Vandal:
    """Breaks an extract; one seed, one extract."""

    def __init__(self, root: Any, seed: int) -> None:
        self.root, self.random = root, np.random.default_rng(seed)
        self.ways, self.nodes = root.findall("way"), root.findall("node")
        self.roads = [w for w in self.ways if w.find("tag[@k='highway']") is not None]

    def pick(self, of: Any) -> Any:
        return of[int(self.random.integers(len(of)))]

    def refs(self, way: Any, refs: list[str]) -> None:
        for nd in way.findall("nd"):
            way.remove(nd)
        for i, ref in enumerate(refs):
            way.insert(i, etree.Element("nd", ref=ref))

    def break_one(self) -> None:
        way, node = self.pick(self.roads), self.pick(self.nodes)
        own = [nd.get("ref") for nd in way.findall("nd")]
        shuffled = self.random.permutation(own).tolist()
        acts = (
            lambda: self.tag(self.pick((way, node))),
            lambda: self.refs(way, own[::-1]),
            lambda: self.refs(way, shuffled),
            lambda: self.refs(way, [*own, *own[:1]]),
            lambda: self.refs(way, own[:1]),
            lambda: self.refs(way, []),
            lambda: self.refs(way, own * 2),
            lambda: self.refs(way, [*own, "99999999999999999999", "x", "-5", node.get("id")]),
            lambda: self.root.append(copy.deepcopy(way)),
            lambda: self.root.insert(0, copy.deepcopy(node)),
            lambda: node.set("id", self.pick(self.nodes).get("id")),
            lambda: way.set("id", self.pick(self.ways).get("id")),
            lambda: node.set("lat", self.pick(("NaN", "inf", "91", "-200", "", "1e400", "4,8", "48.2"))),
            lambda: node.set("lon", self.pick(("NaN", "-inf", "181", "x", "11.67"))),
            lambda: node.getparent() is not None and self.root.remove(node),
            lambda: way.set("visible", "false"),
            lambda: way.set("version", self.pick(("-1", "x", "9" * 30, "0"))),
            self.ring_of_relations,
        )
        self.pick(acts)()

    def tag(self, element: Any) -> None:
        key, value = self.pick(KEYS), self.pick(VALUES)
        found = element.find(f"tag[@k='{key}']")
        found = etree.SubElement(element, "tag", k=key) if found is None else found
        found.set("v", value)

    def ring_of_relations(self) -> None:
        ids = [str(i) for i in self.random.integers(1, 9, 3)]
        for i, other in zip(ids, ids[1:] + ids[:1], strict=True):
            relation = etree.SubElement(self.root, "relation", id=i)
            etree.SubElement(relation, "member", type="relation", ref=other, role="outer")
            etree.SubElement(relation, "member", type="way", ref=self.pick(self.ways).get("id"), role="outer")
            etree.SubElement(relation, "tag", k="landuse", v="residential")


@pytest.fixture(scope="module")
def town(shared_data: Path) -> tuple[LaneletMap, Any, PlacedRoads, bytes]:
    folder = shared_data / "garching"
    built = ingest_lanelet_map(Source("map", folder / "lanelet2_route_1.osm"))
    content = (folder / "osm_2023.osm").read_bytes()
    whole = ingest_osm_roads(Source("roads", folder / "osm_2023.osm"), OsmRoadsParams())
    return built, collapse(built, CollapseParams()), placed(whole), content


def placed(network: Any) -> PlacedRoads:
    return PlacedRoads(network, Projection.at(*ORIGIN).to_xy_m(network.lonlat_deg))


@pytest.mark.parametrize(
    ("seed", "method"), [*((s, "path") for s in range(6)), (0, "buffer_growing"), (1, "buffer_growing")]
)
def test_no_garbage_ends_a_run(town: Any, tmp_path: Path, seed: int, method: Any) -> None:
    built, lines, today, content = town
    root = etree.fromstring(content)
    vandal = Vandal(root, seed)
    for _ in range(60 * 4 ** (seed % 3)):
        vandal.break_one()
    file = tmp_path / "garbage.osm"
    file.write_bytes(etree.tostring(root))
    roads = placed(ingest_osm_roads(Source(file.name, file), OsmRoadsParams()))
    matches = match(lines, built, roads, MatchParams(method=method)).matches
    params = TransferParams(remove_fragments=seed % 2 == 0, provenance_tags=True, lane_check_tags=True)
    after = transfer(built, lines, matches, roads, params)
    find_gaps(lines, roads, matches, GapsParams())
    road_changes(today, roads, matches, matches)
    assert len(lanelets_of(after.map)) > 400
    assert np.isfinite(matches.confidence).all()
    written = after.transfers.new[after.transfers.action == "set"]
    assert all(text.isprintable() and len(text) <= 255 for text in written.tolist())
    speeds = after.transfers.new[(after.transfers.action == "set") & (after.transfers.key == "speed_limit")]
    assert all(3.0 <= float(text) <= 150.0 for text in speeds.tolist())
