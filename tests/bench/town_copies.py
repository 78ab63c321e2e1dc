"""The same map and roads side by side many times: how cost grows with size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexmap_tasks.model.arrays import Ints
from flexmap_tasks.model.maps import Findings, LaneletMap, PlacedRoads, RoadNetwork
from flexmap_tasks.model.osm import OsmDocument, OsmNodes, OsmRelations, OsmWays, Tags

SPACING_M = 5_000.0


def copies_of_map(one: LaneletMap, count: int) -> LaneletMap:
    """`count` maps beside each other, every one with ids of its own."""
    document = one.document
    step = int(max(document.nodes.id.max(), document.ways.id.max(), document.relations.id.max())) + 1
    add = [i * step for i in range(count)]
    nodes, ways, relations = document.nodes, document.ways, document.relations
    many = OsmDocument(
        root=document.root,
        nodes=OsmNodes(
            _ids(nodes.id, add), np.tile(nodes.lonlat_deg, (count, 1)), _tags(nodes.attributes, count),
            _tags(nodes.tags, count), _ids(nodes.id, [0] * count) * 0,
        ),
        ways=OsmWays(
            _ids(ways.id, add), _offset(ways.offset, count), _ids(ways.ref, add), _tags(ways.attributes, count),
            _tags(ways.tags, count), _ids(ways.id, [0] * count) * 0 + 1,
        ),
        relations=OsmRelations(
            _ids(relations.id, add), _offset(relations.offset, count), np.tile(relations.member_type, count),
            _ids(relations.member_ref, add), np.tile(relations.member_role, count), _tags(relations.attributes, count),
            _tags(relations.tags, count), _ids(relations.id, [0] * count) * 0 + 2,
        ),
        other_xml=document.other_xml,
        other_position=document.other_position * 0,
    )  # fmt: skip
    shift = np.repeat(np.arange(count) * SPACING_M, len(one.xyz_m))
    xyz_m = np.tile(one.xyz_m, (count, 1)) + np.column_stack([shift, 0 * shift, 0 * shift])
    none = Findings(
        *(np.empty(0, dtype=object) for _ in range(3)), np.empty(0, dtype=np.int64), np.empty(0, dtype=object)
    )
    return LaneletMap(many, xyz_m, none)


def copies_of_roads(one: PlacedRoads, count: int) -> PlacedRoads:
    """The roads that go with `copies_of_map`."""
    network = one.network
    ways = [i * (int(network.way_id.max()) + 1) for i in range(count)]
    nodes = [i * (int(network.node_id.max()) + 1) for i in range(count)]
    many = RoadNetwork(
        _ids(network.way_id, ways), np.tile(network.version, count), np.tile(network.timestamp, count),
        _offset(network.offset, count), _ids(network.node_id, nodes), np.tile(network.lonlat_deg, (count, 1)),
        _tags(network.tags, count),
    )  # fmt: skip
    shift = np.repeat(np.arange(count) * SPACING_M, len(one.xy_m))
    return replace(
        one, network=many, xy_m=np.tile(one.xy_m, (count, 1)) + np.column_stack([shift, 0 * shift])
    )


def _ids(ids: Ints, add: list[int]) -> Ints:
    return np.concatenate([ids + a for a in add])


def _offset(offset: Ints, count: int) -> Ints:
    return np.concatenate([[0], *(offset[1:] + i * offset[-1] for i in range(count))])


def _tags(tags: Tags, count: int) -> Tags:
    return Tags(_offset(tags.offset, count), np.tile(tags.key, count), np.tile(tags.value, count))
