"""Members of relations after cuts: both pieces where the whole was, rules on the pieces they hold for."""

from __future__ import annotations

import numpy as np
import shapely

from flexmap_tasks.model.arrays import Ints
from flexmap_tasks.model.maps import LaneletMap
from flexmap_tasks.model.osm import node_rows, rows_of
from flexmap_tasks.transfer.cuts.places import CutPlan
from flexmap_tasks.transfer.facts import LaneletFacts

Member = tuple[str, int, str]
"""Type, id, role."""
EVERYWHERE = ("speed_limit", "right_of_way")
"""Rules that hold all along a lanelet, whatever line they name."""
AT_THE_END = ("traffic_light",)
"""Rules that hold at the end of a lanelet unless they name a stop line; what they refer to stands beyond."""


class MemberWriter:
    """Writes member lists; `way_ids` and `lanelet_ids` hold the ids of the pieces, by row of the old element."""

    def __init__(
        self,
        lanelet_map: LaneletMap,
        facts: LaneletFacts,
        plan: CutPlan,
        way_ids: dict[int, list[int]],
        lanelet_ids: dict[int, list[int]],
    ) -> None:
        self.map, self.facts, self.plan = lanelet_map, facts, plan
        self.lanelet_ids = lanelet_ids
        self.way_rows = {int(lanelet_map.document.ways.id[w]): w for w in way_ids}
        self.way_ids = way_ids
        self.lanelet_rows = {int(facts.lanelets.id[k]): k for k in lanelet_ids}
        self.node_rows = node_rows(lanelet_map.document)
        relations = lanelet_map.document.relations
        self.relation_ids = set(relations.id.tolist())
        self.subtypes = relations.tags.column("subtype")

    def lanelet(self, k: int) -> list[list[Member]]:
        """The members of every piece of a cut lanelet."""
        count = len(self.lanelet_ids[k])
        out: list[list[Member]] = [[] for _ in range(count)]
        inverted = {
            "left": bool(self.facts.lanelets.left_inverted[k]),
            "right": bool(self.facts.lanelets.right_inverted[k]),
            "centerline": bool(self.facts.drawn_inverted[k]),
        }
        for kind, ref, role in self._members(int(self.facts.lanelets.relation_row[k])):
            if kind == "way" and role in inverted and ref in self.way_rows:
                pieces = self.way_ids[self.way_rows[ref]]
                for j, piece in enumerate(reversed(pieces) if inverted[role] else pieces):
                    out[j].append((kind, piece, role))
            else:
                for j in self._holds_on(k, kind, ref, role):
                    out[j].append((kind, ref, role))
        return out

    def _holds_on(self, k: int, kind: str, ref: int, role: str) -> list[int]:
        """The pieces of lanelet k that a member goes to: what names a stop line, to the piece with that line."""
        count = len(self.lanelet_ids[k])
        if kind != "relation" or ref not in self.relation_ids:
            return [0]
        row = int(rows_of(self.map.document.relations.id, np.array([ref]))[0])
        if role != "regulatory_element" or self.subtypes[row] in EVERYWHERE:
            return list(range(count))
        subtype = self.subtypes[row]
        places = self._places_m(k, row, "ref_line")
        if not places and subtype == "traffic_sign":
            return list(range(count))
        if not places and subtype not in AT_THE_END:
            places = self._places_m(k, row, None)
        stops = [c.s_m for c in self.plan.lanelets[k]]
        return sorted({int(np.searchsorted(stops, s)) for s in places}) or [count - 1]

    def _places_m(self, k: int, row: int, role: str | None) -> list[float]:
        """Metres along lanelet k of the ways that a relation names, in this role or (None) in any.

        A lanelet it names stands for its left bound.
        """
        ways = []
        for kind, ref, role_there in self._members(row):
            if role is None and kind == "relation" and ref in self.relation_ids:
                named = int(rows_of(self.map.document.relations.id, np.array([ref]))[0])
                ways += [r for t, r, side in self._members(named) if t == "way" and side == "left"]
            elif kind == "way" and role in (None, role_there):
                ways.append(ref)
        return [s for s in (self._place_m(k, way) for way in ways) if s is not None]

    def _place_m(self, k: int, way_id: int) -> float | None:
        """Metres along lanelet k where the middle of a way lies; None for a way without nodes."""
        ways = self.map.document.ways
        way = int(rows_of(ways.id, np.array([way_id]))[0])
        rows = (
            self.node_rows[ways.offset[way] : ways.offset[way + 1]]
            if way >= 0
            else np.zeros(0, dtype=np.int64)
        )
        rows = rows[rows >= 0]
        if not len(rows):
            return None
        line = self.facts.centreline
        vertices = line.xyz_m[line.offset[k] : line.offset[k + 1], :2]
        middle = (self.map.xyz_m[rows[0], :2] + self.map.xyz_m[rows[-1], :2]) * 0.5
        return float(shapely.line_locate_point(shapely.LineString(vertices), shapely.Point(middle)))

    def _members(self, row: int) -> list[Member]:
        relations = self.map.document.relations
        at = slice(int(relations.offset[row]), int(relations.offset[row + 1]))
        return list(
            zip(
                relations.member_type[at].tolist(),
                relations.member_ref[at].tolist(),
                relations.member_role[at].tolist(),
                strict=True,
            )
        )

    def other_relations(self) -> dict[int, list[Member]]:
        """New members of every relation, but cut lanelets, that names a cut way or a cut lanelet; by row."""
        relations = self.map.document.relations
        ways = np.array(sorted(self.way_rows), dtype=np.int64)
        lanelets = np.array(sorted(self.lanelet_rows), dtype=np.int64)
        touched = (relations.member_type == "way") & np.isin(relations.member_ref, ways)
        touched |= (relations.member_type == "relation") & np.isin(relations.member_ref, lanelets)
        rows: Ints = np.unique(np.searchsorted(relations.offset, np.flatnonzero(touched), side="right") - 1)
        own = {int(self.facts.lanelets.relation_row[k]) for k in self.lanelet_ids}
        return {row: self._other(self._members(row)) for row in rows.tolist() if row not in own}

    def _other(self, members: list[Member]) -> list[Member]:
        out: list[Member] = []
        for i, (kind, ref, role) in enumerate(members):
            if kind == "way" and ref in self.way_rows:
                pieces = self.way_ids[self.way_rows[ref]]
                backward = self._runs_backward(members, i)
                out += [(kind, piece, role) for piece in (reversed(pieces) if backward else pieces)]
            elif kind == "relation" and ref in self.lanelet_rows:
                out += [(kind, piece, role) for piece in self.lanelet_ids[self.lanelet_rows[ref]]]
            else:
                out.append((kind, ref, role))
        return out

    def _runs_backward(self, members: list[Member], i: int) -> bool:
        """Way i of a ring is passed from its end to its start: the next one begins where it starts."""
        ring = [m for m in members if m[0] == "way" and m[2] == members[i][2]]
        at = ring.index(members[i])
        start, end = self._ends(members[i][1])
        following, before = self._ends(ring[(at + 1) % len(ring)][1]), self._ends(ring[at - 1][1])
        if len(ring) > 1 and (start in following) != (end in following):
            return start in following
        return len(ring) > 1 and end in before and start not in before

    def _ends(self, way_id: int) -> tuple[int, int]:
        ways = self.map.document.ways
        way = int(rows_of(ways.id, np.array([way_id]))[0])
        if way < 0 or ways.offset[way] == ways.offset[way + 1]:
            return -1, -2
        return int(ways.ref[ways.offset[way]]), int(ways.ref[ways.offset[way + 1] - 1])
