"""Points, lines and lanelets as they are put down, before they get their ids."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.simulate.document import DocumentDraft


@dataclass(frozen=True, slots=True)
class DrawnLanelet:
    """One lanelet of the map.

    id : relation id; strip : row in the lane network, -1 for what lies on no strip
    first, last : the strip's point pairs it covers, both included
    left_way, right_way : way ids; kind : the strip's kind, "crosswalk" or "fragment"
    stub : it belongs to a side road that was drawn for a few metres only
    """

    id: int
    strip: int
    first: int
    last: int
    left_way: int
    right_way: int
    kind: str
    stub: bool


@dataclass(slots=True)
class Drawing:
    """Points and lines as they are put down; ids run through nodes, ways and relations."""

    base: Floats
    extra: list[Floats] = field(default_factory=list)
    used: dict[int, int] = field(default_factory=dict)
    ways: dict[bytes, int] = field(default_factory=dict)
    draft: DocumentDraft = field(default_factory=DocumentDraft)
    lanelets: list[DrawnLanelet] = field(default_factory=list)
    regulatory: dict[int, list[int]] = field(default_factory=dict)
    rows: list[Ints] = field(default_factory=list)
    next_way: int = 0

    def point(self, xyz: Floats) -> int:
        """A point of its own; its row follows those of the lane network."""
        self.extra.append(xyz)
        return len(self.base) + len(self.extra) - 1

    def line(self, rows: Ints, kind: str, subtype: str) -> int:
        """Way over these points, shared by all who ask for the same ones in either direction."""
        rows = rows if rows[0] <= rows[-1] else rows[::-1]
        key = rows.tobytes()
        if key not in self.ways:
            self.next_way += 1
            self.ways[key] = self.next_way
            tags = {"type": kind, "subtype": subtype} if subtype else {"type": kind}
            self.draft.way(self.next_way, [], tags)
            self.rows.append(np.ascontiguousarray(rows))
        return self.ways[key]
