"""An OSM XML document as columns: everything that was in the file, in its order.

Lanelet2 maps and OpenStreetMap share this shape. Columns of variable length are stored as
`offset` (n + 1,) into flat arrays: element i owns rows offset[i]:offset[i + 1].
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

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
        """A copy where element rows[i] has keys[i] = values[i]: replaced in place, or appended after its tags."""
        wanted: dict[int, dict[str, str]] = {}
        for row, key, value in zip(rows.tolist(), keys, values, strict=True):
            wanted.setdefault(row, {})[key] = value
        value = self.value.copy()
        extra: list[tuple[int, str, str]] = []
        for row, pairs in wanted.items():
            start, end = int(self.offset[row]), int(self.offset[row + 1])
            place = {k: start + i for i, k in enumerate(self.key[start:end])}
            for key, new in pairs.items():
                if key in place:
                    value[place[key]] = new
                else:
                    extra.append((row, key, new))
        if not extra:
            return Tags(self.offset, self.key, value)
        added = np.bincount([e[0] for e in extra], minlength=len(self))
        at = self.offset[[e[0] for e in extra]] + np.diff(self.offset)[[e[0] for e in extra]]
        order = np.argsort([e[0] for e in extra], kind="stable")
        key_out = np.insert(self.key, at[order], strings(extra[i][1] for i in order))
        value_out = np.insert(value, at[order], strings(extra[i][2] for i in order))
        offset = self.offset + np.concatenate([[0], np.cumsum(added)])
        return Tags(offset.astype(np.int64), key_out, value_out)


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


@dataclass(frozen=True, slots=True, eq=False)
class OsmWays:
    """Ways: way i runs over node ids ref[offset[i]:offset[i + 1]].

    id : (w,) int64, unique; offset : (w + 1,) int64; ref : (m,) int64 node ids
    attributes, tags, position : as for nodes
    """

    id: Ints
    offset: Ints
    ref: Ints
    attributes: Tags
    tags: Tags
    position: Ints


@dataclass(frozen=True, slots=True, eq=False)
class OsmRelations:
    """Relations: relation i has the members offset[i]:offset[i + 1].

    id : (r,) int64, unique; offset : (r + 1,) int64
    member_type : (m,) str, "node", "way" or "relation"; member_ref : (m,) int64; member_role : (m,) str
    attributes, tags, position : as for nodes
    """

    id: Ints
    offset: Ints
    member_type: Strings
    member_ref: Ints
    member_role: Strings
    attributes: Tags
    tags: Tags
    position: Ints


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
