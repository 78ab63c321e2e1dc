"""What lies along roads: land of towns and between them, and the signs where towns begin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import osmium
import pytest

from flexmap_tasks.config import OsmRoadsParams
from flexmap_tasks.formats.osm_roads_elements import city_limit
from flexmap_tasks.ingest.osm_roads import ingest_osm_roads
from flexmap_tasks.model.maps import RoadNetwork
from flexmap_tasks.model.source import Source

M = 1e-5 / 1.1132
"""Degrees of a metre, northwards."""


class Extract:
    """An extract being drawn, in metres east and north of 48 N 11 E."""

    def __init__(self) -> None:
        self.nodes: list[str] = []
        self.rest: list[str] = []

    def node(self, x: float, y: float, **tags: str) -> int:
        i = len(self.nodes) + 1
        lon, lat = 11.0 + x * M / np.cos(np.radians(48.0)), 48.0 + y * M
        self.nodes.append(f'<node id="{i}" version="1" lat="{lat:.7f}" lon="{lon:.7f}">{_tags(tags)}</node>')
        return i

    def way(self, i: int, refs: list[int], **tags: str) -> int:
        body = "".join(f'<nd ref="{r}"/>' for r in refs)
        self.rest.append(f'<way id="{i}" version="1">{body}{_tags(tags)}</way>')
        return i

    def box(self, i: int, x: tuple[float, float], y: tuple[float, float], **tags: str) -> int:
        corners = [self.node(a, b) for a, b in ((x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1]))]
        return self.way(i, [*corners, corners[0]], **tags)

    def relation(self, i: int, outer: list[int], inner: list[int], **tags: str) -> None:
        body = "".join(f'<member type="way" ref="{w}" role="outer"/>' for w in outer)
        body += "".join(f'<member type="way" ref="{w}" role="inner"/>' for w in inner)
        self.rest.append(
            f'<relation id="{i}" version="1">{body}{_tags({"type": "multipolygon"} | tags)}</relation>'
        )

    def read(self, folder: Path, kind: str) -> RoadNetwork:
        xml = folder / "x.osm"
        xml.write_text(f'<osm version="0.6">{"".join(self.nodes + self.rest)}</osm>')
        path = xml
        if kind == "pbf":
            path = folder / "x.osm.pbf"
            with osmium.SimpleWriter(str(path)) as writer:
                for element in osmium.FileProcessor(str(xml)):
                    writer.add(element)
        return ingest_osm_roads(Source(path.name, path), OsmRoadsParams())


def _tags(tags: dict[str, str]) -> str:
    return "".join(f'<tag k="{k}" v="{v}"/>' for k, v in tags.items())


@pytest.mark.parametrize("kind", ["xml", "pbf"])
def test_land_along_the_road(tmp_path: Path, kind: str) -> None:
    draft = Extract()
    line = [draft.node(x, 0.0) for x in (0.0, 100.0, 200.0, 300.0)]
    for i in range(3):
        draft.way(i + 1, line[i : i + 2], highway="tertiary")
    draft.way(4, [line[3], draft.node(400.0, 0.0)], highway="tertiary")
    draft.box(11, (0.0, 70.0), (15.0, 80.0), landuse="residential")
    draft.box(12, (-50.0, 350.0), (-80.0, -12.0), landuse="farmland")
    a, b = [draft.node(x, y) for x, y in ((110.0, 10.0), (190.0, 90.0))]
    draft.way(13, [a, draft.node(190.0, 10.0), b])
    draft.way(14, [b, draft.node(110.0, 90.0), a])
    draft.relation(20, [13, 14], [], landuse="retail")
    draft.box(15, (0.0, 400.0), (-9.0, 9.0), landuse="grass")
    found = draft.read(tmp_path, kind)
    assert found.built_up is not None
    assert found.open_land is not None
    assert found.built_up == pytest.approx([0.95, 1.0, 0.15, 0.0], abs=0.16)
    assert found.open_land == pytest.approx([0.05, 0.0, 0.85, 0.7], abs=0.16)


@pytest.mark.parametrize("kind", ["xml", "pbf"])
def test_signs_where_towns_begin(tmp_path: Path, kind: str) -> None:
    draft = Extract()
    sign = {"traffic_sign": "city_limit", "direction": "forward"}
    nodes = [draft.node(x, 0.0) for x in (0.0, 50.0)]
    nodes.append(draft.node(100.0, 0.0, **sign))
    nodes += [draft.node(150.0, 0.0, traffic_sign="stop"), draft.node(200.0, 0.0, **sign, city_limit="end")]
    draft.way(1, nodes[:3], highway="secondary")
    draft.way(2, nodes[2:], highway="secondary")
    draft.way(3, [nodes[4], draft.node(300.0, 0.0)], highway="secondary")
    draft.way(
        4, [draft.node(0.0, 90.0), draft.node(50.0, 90.0, **sign), draft.node(90.0, 90.0)], highway="road"
    )
    found = draft.read(tmp_path, kind)
    assert found.city_limit is not None
    assert found.city_limit.tolist() == [-1, 1, -1, 0]


@pytest.mark.parametrize(
    ("tags", "sense"),
    [
        ({"traffic_sign": "city_limit"}, 0),
        ({"traffic_sign": "city_limit", "direction": "backward"}, -1),
        ({"traffic_sign": "city_limit", "direction": "forward", "city_limit": "both"}, 0),
        ({"traffic_sign": "DE:311", "direction": "forward"}, -1),
        ({"traffic_sign": "maxspeed;DE:310", "direction": "forward"}, 1),
        ({"traffic_sign:backward": "DE:310"}, -1),
        ({"traffic_sign:forward": "DE:274[50]"}, 0),
        ({"direction": "forward"}, 0),
    ],
)
def test_senses_of_signs(tags: dict[str, str], sense: int) -> None:
    assert city_limit(tags) == sense


@pytest.mark.parametrize("kind", ["xml", "pbf"])
def test_broken_land_is_no_land(tmp_path: Path, kind: str) -> None:
    draft = Extract()
    draft.way(1, [draft.node(0.0, 0.0), draft.node(100.0, 0.0)], highway="tertiary")
    draft.way(2, [draft.node(0.0, 5.0), 998, draft.node(50.0, 50.0)], landuse="residential")
    eight = [draft.node(x, y) for x, y in ((0.0, 1.0), (9.0, 9.0), (0.0, 9.0), (9.0, 1.0))]
    draft.way(3, [*eight, eight[0]], landuse="residential")
    draft.relation(4, [77, 2], [3], landuse="residential")
    draft.relation(5, [], [], landuse="forest")
    found = draft.read(tmp_path, kind)
    assert found.built_up is not None
    assert 0.0 <= found.built_up[0] <= 1.0
