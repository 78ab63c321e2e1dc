"""An OSM XML document as columns: everything that was in the file, in its order.

Lanelet2 maps and OpenStreetMap share this shape. Columns of variable length are stored as
`offset` (n + 1,) into flat arrays: element i owns rows offset[i]:offset[i + 1].
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from flexmap_tasks.geometry.lanelets import gather
from flexmap_tasks.model.arrays import Floats, Ints, Strings, require, strings


@dataclass(frozen=True, slots=True, eq=False)
class Tags:
    """Key-value pairs of n elements, in the order of the file.

    offset : (n + 1,) int64
    key, value : (m,) str
    """

    offset: Ints
    key: Strings
    value: Strings

    def __len__(self) -> int:
        return len(self.offset) - 1

    def __post_init__(self) -> None:
        require(len(self.key) == len(self.value) == self.offset[-1], "tag columns differ in length")

    @classmethod
    def of(cls, elements: Iterable[Mapping[str, str]]) -> Tags:
        """Tags from one mapping per element."""
        rows = [dict(e) for e in elements]
        offset = np.concatenate([[0], np.cumsum([len(r) for r in rows])]).astype(np.int64)
        return cls(offset, strings(k for r in rows for k in r), strings(v for r in rows for v in r.values()))

    def owner(self) -> Ints:
        """(m,) int64: the element each pair belongs to."""
        return np.repeat(np.arange(len(self), dtype=np.int64), np.diff(self.offset))

    def column(self, key: str) -> Strings:
        """(n,) str: the value of `key` per element, None where it has none."""
        out: Strings = np.full(len(self), None, dtype=object)
        hit = np.flatnonzero(self.key == key)
        out[self.owner()[hit]] = self.value[hit]
        return out

    def of_element(self, i: int) -> dict[str, str]:
        """All pairs of element i."""
        rows = slice(int(self.offset[i]), int(self.offset[i + 1]))
        return dict(zip(self.key[rows], self.value[rows], strict=True))

    def take(self, rows: Ints) -> Tags:
        """The tags of the given elements, in the given order (an element may be taken twice)."""
        size = np.diff(self.offset)[rows]
        offset = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
        flat = np.repeat(self.offset[rows] - offset[:-1], size) + np.arange(offset[-1])
        return Tags(offset, self.key[flat], self.value[flat])

    def with_values(self, rows: Ints, keys: Iterable[str], values: Iterable[str]) -> Tags:
        """A copy where element rows[i] has keys[i] = values[i]: replaced in place, or appended in this order.

        The last one counts where an element gets the same key twice.
        """
        value = self.value.copy()
        key_in, value_in = strings(keys), strings(values)
        place = self._places(rows, key_in)
        value[place[place >= 0]] = value_in[place >= 0]
        new: dict[tuple[int, str], str] = {}
        for i in np.flatnonzero(place < 0).tolist():
            new[int(rows[i]), key_in[i]] = value_in[i]
        if not new:
            return Tags(self.offset, self.key, value)
        owner = np.array([row for row, _ in new], dtype=np.int64)
        order = np.argsort(owner, kind="stable")
        at = self.offset[owner[order] + 1]
        added = np.bincount(owner, minlength=len(self))
        key_out = np.insert(self.key, at, strings(k for _, k in new)[order])
        value_out = np.insert(value, at, strings(new.values())[order])
        offset = self.offset + np.concatenate([[0], np.cumsum(added)])
        return Tags(offset.astype(np.int64), key_out, value_out)

    def _places(self, rows: Ints, keys: Strings) -> Ints:
        """Flat position of keys[i] in element rows[i], -1 where it has no such key."""
        out = np.full(len(rows), -1, dtype=np.int64)
        owner = self.owner()
        for key in dict.fromkeys(keys.tolist()):
            here = np.full(len(self), -1, dtype=np.int64)
            hit = np.flatnonzero(self.key == key)
            here[owner[hit]] = hit
            wanted = keys == key
            out[wanted] = here[rows[wanted]]
        return out


@dataclass(frozen=True, slots=True, eq=False)
class OsmNodes:
    """Nodes.

    id : (n,) int64, unique
    lonlat_deg : (n, 2) float64, NaN where the file leaves them blank
    attributes : all XML attributes but the id, as text (`lat`, `lon`, `version`, ...)
    tags : the node's tags
    position : (n,) int64, where the element stands among all top-level elements of the file
    """

    id: Ints
    lonlat_deg: Floats
    attributes: Tags
    tags: Tags
    position: Ints

    def take(self, rows: Ints) -> OsmNodes:
        """The given nodes."""
        texts = (self.attributes.take(rows), self.tags.take(rows))
        return OsmNodes(self.id[rows], self.lonlat_deg[rows], *texts, self.position[rows])


@dataclass(frozen=True, slots=True, eq=False)
class OsmWays:
    """Ways: way i runs over node ids ref[offset[i]:offset[i + 1]].

    id : (w,) int64, unique; offset : (w + 1,) int64; ref : (m,) int64 node ids
    attributes, tags, position : as for nodes
    """

    lists: ClassVar[tuple[str, ...]] = ("ref",)

    id: Ints
    offset: Ints
    ref: Ints
    attributes: Tags
    tags: Tags
    position: Ints

    def take(self, rows: Ints) -> OsmWays:
        """The given ways."""
        offset, flat = _pieces(self.offset, rows)
        texts = (self.attributes.take(rows), self.tags.take(rows))
        return OsmWays(self.id[rows], offset, self.ref[flat], *texts, self.position[rows])


@dataclass(frozen=True, slots=True, eq=False)
class OsmRelations:
    """Relations: relation i has the members offset[i]:offset[i + 1].

    id : (r,) int64, unique; offset : (r + 1,) int64
    member_type : (m,) str, "node", "way" or "relation"; member_ref : (m,) int64; member_role : (m,) str
    attributes, tags, position : as for nodes
    """

    lists: ClassVar[tuple[str, ...]] = ("member_type", "member_ref", "member_role")

    id: Ints
    offset: Ints
    member_type: Strings
    member_ref: Ints
    member_role: Strings
    attributes: Tags
    tags: Tags
    position: Ints

    def take(self, rows: Ints) -> OsmRelations:
        """The given relations, with all their members."""
        offset, flat = _pieces(self.offset, rows)
        members = (self.member_type[flat], self.member_ref[flat], self.member_role[flat])
        return OsmRelations(
            self.id[rows],
            offset,
            *members,
            self.attributes.take(rows),
            self.tags.take(rows),
            self.position[rows],
        )


@dataclass(frozen=True, slots=True, eq=False)
class OsmDocument:
    """A whole file.

    root : attributes of the root element, as text, in order (`version`, `generator`, ...)
    nodes, ways, relations : the three kinds of elements
    other_xml, other_position : every other top-level element (MetaInfo, bounds, ...) as XML, and its place
    """

    root: dict[str, str]
    nodes: OsmNodes
    ways: OsmWays
    relations: OsmRelations
    other_xml: Strings
    other_position: Ints


def _pieces(offset: Ints, rows: Ints) -> tuple[Ints, Ints]:
    return gather(offset, rows, np.zeros(len(rows), dtype=bool))


def rows_of(ids: Ints, wanted: Ints) -> Ints:
    """Row of each wanted id among unique `ids`, -1 where it is not there."""
    if not len(ids):
        return np.full(len(wanted), -1, dtype=np.int64)
    if bool((ids[1:] > ids[:-1]).all()):
        place = np.minimum(np.searchsorted(ids, wanted), len(ids) - 1)
        return np.where(ids[place] == wanted, place, -1)
    order = np.argsort(ids, kind="stable")
    place = np.minimum(np.searchsorted(ids, wanted, sorter=order), len(ids) - 1)
    row = order[place]
    return np.where(ids[row] == wanted, row, -1)


def node_rows(document: OsmDocument) -> Ints:
    """(m,) row in `nodes` of every entry of `ways.ref`, -1 where the file has no such node."""
    return rows_of(document.nodes.id, document.ways.ref)
