"""Building OSM XML documents element by element."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from flexmap_tasks.model.arrays import Floats, Ints, Strings, strings
from flexmap_tasks.model.osm import OsmDocument, OsmNodes, OsmRelations, OsmWays, Tags

Member = tuple[str, int, str]


@dataclass(slots=True)
class DocumentDraft:
    """Ways and relations with their tags, in the order they were added."""

    way_ids: list[int] = field(default_factory=list)
    way_refs: list[Sequence[int] | Ints] = field(default_factory=list)
    way_tags: list[Mapping[str, str]] = field(default_factory=list)
    relation_ids: list[int] = field(default_factory=list)
    members: list[list[Member]] = field(default_factory=list)
    relation_tags: list[Mapping[str, str]] = field(default_factory=list)

    def way(self, number: int, refs: Sequence[int] | Ints, tags: Mapping[str, str]) -> int:
        """Add a way over node ids."""
        self.way_ids.append(number)
        self.way_refs.append(refs)
        self.way_tags.append(tags)
        return number

    def relation(self, number: int, members: list[Member], tags: Mapping[str, str]) -> int:
        """Add a relation."""
        self.relation_ids.append(number)
        self.members.append(members)
        self.relation_tags.append(tags)
        return number

    def finished(
        self, root: dict[str, str], node_ids: Ints, lonlat_deg: Floats, node_attributes: Tags, node_tags: Tags,
        attributes: Mapping[int, Mapping[str, str]] | None = None, other_xml: Sequence[str] = (),
    ) -> OsmDocument:  # fmt: skip
        """The document: other elements first, then nodes, ways, relations; `attributes` by element id."""
        extra = attributes or {}
        first, n, w, r = len(other_xml), len(node_ids), len(self.way_ids), len(self.relation_ids)
        ways = OsmWays(
            np.array(self.way_ids, dtype=np.int64), _offsets(self.way_refs), _flat(self.way_refs),
            Tags.of(extra.get(i, {}) for i in self.way_ids), Tags.of(self.way_tags),
            np.arange(first + n, first + n + w),
        )  # fmt: skip
        flat = [m for members in self.members for m in members]
        relations = OsmRelations(
            np.array(self.relation_ids, dtype=np.int64), _offsets(self.members), strings(m[0] for m in flat),
            np.array([m[1] for m in flat], dtype=np.int64), strings(m[2] for m in flat),
            Tags.of(extra.get(i, {}) for i in self.relation_ids), Tags.of(self.relation_tags),
            np.arange(first + n + w, first + n + w + r),
        )  # fmt: skip
        nodes = OsmNodes(node_ids, lonlat_deg, node_attributes, node_tags, np.arange(first, first + n))
        return OsmDocument(root, nodes, ways, relations, strings(other_xml), np.arange(first))


def same_keys(columns: Mapping[str, Strings]) -> Tags:
    """Tags of n elements that all have the same keys."""
    keys = list(columns)
    n = len(columns[keys[0]])
    value = np.column_stack([columns[k] for k in keys]).ravel() if n else np.empty(0, dtype=object)
    return Tags(np.arange(n + 1, dtype=np.int64) * len(keys), np.tile(strings(keys), n), value)


def texts(values: Floats, form: str) -> Strings:
    """(n,) str of numbers in a %-format."""
    return strings([form % v for v in values.tolist()])


def _offsets(rows: Sequence[Sequence[object] | Ints]) -> Ints:
    return np.concatenate([[0], np.cumsum([len(r) for r in rows])]).astype(np.int64)


def _flat(rows: Sequence[Sequence[int] | Ints]) -> Ints:
    parts = [np.asarray(r, dtype=np.int64) for r in rows]
    return np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)
