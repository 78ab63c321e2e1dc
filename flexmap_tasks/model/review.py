"""What people decided about what was put up for review."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.model.conflation import Matches

COUNTS = ("lanes", "bus_lane", "bicycle_lane", "road_shoulder")
"""Keys that compare numbers of lanes: a decision on them writes no tag."""


@dataclass(frozen=True, slots=True, eq=False)
class ReviewDecisions:
    """One row per decision, in the order in which they were made. It holds while its ground stays the same.

    kind : (n,) str, what it is about:
        "value", the attribute `key` of a lanelet: the map has `old`, the way offers `new`
        "match", the way of the piece `s_from_m` to `s_to_m` of a lanelet; way 0 where matching found none
        "lanes", the number of lanes: the map has `old`, the way says `new`
        "fragment", a lanelet beyond the number of lanes that is to be taken out; `old` and `new` as for "lanes"
        "change", what became of a way (lanelet 0) between two dates of OSM: `key`, `old` and `new` as told there
    lanelet_id, way_id : (n,) int64; s_from_m, s_to_m : (n,) float64, NaN unless it is a match
    key, old, new : (n,) str
    accept : (n,) str, "accept" (OSM or the finding is right) or "reject" (the map is right, or no way at all)
    value : (n,) str, what holds instead of `new`: a value, the id of another way, or a number of lanes; "" for none
    note, who, when : (n,) str, why, by whom, and at what time (UTC, ISO 8601)
    """

    kind: Strings
    lanelet_id: Ints
    way_id: Ints
    s_from_m: Floats
    s_to_m: Floats
    key: Strings
    old: Strings
    new: Strings
    accept: Strings
    value: Strings
    note: Strings
    who: Strings
    when: Strings

    def __len__(self) -> int:
        return len(self.lanelet_id)

    def take(self, rows: Ints | Bools) -> ReviewDecisions:
        """The given rows, in that order."""
        return ReviewDecisions(*(getattr(self, name)[rows] for name in self.__slots__))

    def of_kind(self, kind: str) -> ReviewDecisions:
        """The decisions of one kind."""
        return self.take(np.flatnonzero(self.kind == kind))

    def key_of(self, d: int) -> tuple[int, int, str, str, str]:
        """What decision `d` names: lanelet, way, key, the map's value and the one offered."""
        names = str(self.key[d]), str(self.old[d]), str(self.new[d])
        return int(self.lanelet_id[d]), int(self.way_id[d]), *names

    def by(self, d: int) -> str:
        """What a reason says of the person behind decision `d`."""
        told = [str(text[d]) for text in (self.who, self.when, self.note) if text[d]]
        return f"by a person ({', '.join(told)})" if told else "by a person"


@dataclass(frozen=True, slots=True, eq=False)
class Decided:
    """The decisions by what they are about, so that each stage waits for its own only."""

    KINDS: ClassVar[tuple[str, ...]] = ("value", "match", "lanes", "fragment", "change")

    values: ReviewDecisions
    matches: ReviewDecisions
    lanes: ReviewDecisions
    fragments: ReviewDecisions
    changes: ReviewDecisions


@dataclass(frozen=True, slots=True, eq=False)
class ReviewedMatches:
    """The matches as people decided them.

    unused : decisions that met no piece: the ground they were made on has changed
    """

    matches: Matches
    unused: ReviewDecisions
