"""Where lanelets are cut: where a value that lands changes along them, through the whole carriageway at once.

Lanelets that share a bound are cut together, every bound at the same share of its length. The middle of a
lanelet is the mean of its bounds at equal shares, so its pieces have exactly the middle of the whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from flexmap_tasks.config import TransferParams
from flexmap_tasks.model.arrays import Bools, Floats, Ints
from flexmap_tasks.model.maps import LaneletMap, Lanelets
from flexmap_tasks.model.osm import node_rows, rows_of
from flexmap_tasks.transfer.cuts.lines import (
    Line,
    WayCut,
    area,
    at_share,
    own_places,
    pieces,
    place,
    turned,
)
from flexmap_tasks.transfer.cuts.wanted import Wanted
from flexmap_tasks.transfer.facts import LaneletFacts

PIECE_MIN_M = 0.5
"""No piece of a bound is shorter."""


@dataclass(frozen=True, slots=True)
class LaneletCut:
    """A cut of a lanelet at `s_m` of its centreline; `cause` is what asked for it, there or beside it."""

    s_m: float
    cause: Wanted


@dataclass(frozen=True, slots=True, eq=False)
class CutPlan:
    """All cuts, by row of the way and of the lanelet, each in its own direction; and what could not be cut."""

    ways: dict[int, list[WayCut]]
    lanelets: dict[int, list[LaneletCut]]
    refused: list[tuple[Wanted, str]]


@dataclass(frozen=True, slots=True)
class _Group:
    """Lanelets that share bounds: direction of lanelets and ways (bounds, centrelines) against the group's axis."""

    lanelet_sign: dict[int, int]
    way_sign: dict[int, int]


def plan_cuts(
    lanelet_map: LaneletMap, facts: LaneletFacts, wanted: list[Wanted], params: TransferParams
) -> CutPlan:
    """Carry each wanted cut through all lanelets that share bounds; drop those that would do harm."""
    planner = _Planner(lanelet_map, facts, params)
    label = tied_groups(facts.lanelets)
    by_group: dict[int, list[Wanted]] = {}
    for w in wanted:
        by_group.setdefault(int(label[w.lanelet]), []).append(w)
    order = np.argsort(label, kind="stable")
    start = np.searchsorted(label[order], np.arange(label.max(initial=-1) + 2))
    for group in sorted(by_group):
        planner.cut_group(order[start[group] : start[group + 1]].tolist(), by_group[group])
    return planner.plan


def tied_groups(lanelets: Lanelets) -> Ints:
    """(k,) int64: equal for lanelets that are tied by shared bounds."""
    k = len(lanelets)
    if not k:
        return np.zeros(0, dtype=np.int64)
    ways = np.concatenate([lanelets.left_way, lanelets.right_way])
    size = k + int(ways.max()) + 1
    rows = np.tile(np.arange(k), 2)
    graph = coo_array((np.ones(2 * k, dtype=np.int8), (rows, k + ways)), shape=(size, size))
    return np.asarray(connected_components(graph, directed=False)[1][:k], dtype=np.int64)


def uncuttable_ways(lanelet_map: LaneletMap, lanelets: Lanelets) -> Bools:
    """(w,) bool: ways that pass a node twice, or that serve a rule or a broken lanelet and cannot be two."""
    document = lanelet_map.document
    ways, relations = document.ways, document.relations
    owner = np.repeat(np.arange(len(ways.id)), np.diff(ways.offset))
    pairs = np.stack([owner, ways.ref], axis=1)
    distinct = np.bincount(np.unique(pairs, axis=0)[:, 0], minlength=len(ways.id))
    bad = (distinct != np.diff(ways.offset)) | (
        np.bincount(owner[node_rows(document) < 0], minlength=len(ways.id)) > 0
    )
    kind = relations.tags.column("type")
    whole = np.zeros(len(relations.id), dtype=bool)
    whole[lanelets.relation_row] = True
    rigid = (kind == "regulatory_element") | ((kind == "lanelet") & ~whole)
    member = rigid[np.repeat(np.arange(len(relations.id)), np.diff(relations.offset))]
    used = rows_of(ways.id, relations.member_ref[member & (relations.member_type == "way")])
    bad[used[used >= 0]] = True
    return np.asarray(bad)


class _Planner:
    """Works on one group after the other and collects the plan."""

    def __init__(self, lanelet_map: LaneletMap, facts: LaneletFacts, params: TransferParams) -> None:
        self.map, self.facts, self.params = lanelet_map, facts, params
        self.plan = CutPlan({}, {}, [])
        self.uncuttable = uncuttable_ways(lanelet_map, facts.lanelets)
        self.node_rows = node_rows(lanelet_map.document)
        self.lines: dict[int, Line] = {}

    def cut_group(self, members: list[int], wanted: list[Wanted]) -> None:
        """Add the cuts of one carriageway to the plan; ways through a junction stay whole without a word."""
        if not self.params.split_junctions and self._in_junction(members):
            return
        group = self._oriented(members)
        problem = "the bounds run in contradicting directions" if group is None else self._problem(group)
        if group is None or problem:
            self.plan.refused.extend((w, problem) for w in wanted)
            return
        accepted: list[tuple[float, Wanted]] = []
        for share, cause in self._places(group, wanted):
            trial = [*accepted, (share, cause)]
            reason = self._harm(group, [s for s, _ in trial])
            if reason:
                self.plan.refused.append((cause, reason))
            else:
                accepted = trial
        if accepted:
            self._accept(group, accepted)

    def _place_of(self, k: int) -> tuple[float, ...]:
        """Where a lanelet starts and ends: an order that does not depend on ids."""
        line = self.facts.centreline
        ends = line.xyz_m[[line.offset[k], line.offset[k + 1] - 1]]
        return tuple(ends.ravel().tolist())

    def _in_junction(self, members: list[int]) -> bool:
        rows = np.array(members, dtype=np.int64)
        short = self.facts.length_m[rows] <= self.params.junction_max_m
        return bool(np.any(self.facts.forks[rows] & short))

    def _oriented(self, members: list[int]) -> _Group | None:
        """Direction of every lanelet and way against the first lanelet; None when they contradict."""
        lanelets = self.facts.lanelets
        users: dict[int, list[tuple[int, int]]] = {}
        for k in members:
            users.setdefault(int(lanelets.left_way[k]), []).append(
                (k, -1 if lanelets.left_inverted[k] else 1)
            )
            users.setdefault(int(lanelets.right_way[k]), []).append(
                (k, -1 if lanelets.right_inverted[k] else 1)
            )
        first = min(members, key=self._place_of)
        group, todo = _Group({first: 1}, {}), [first]
        while todo:
            k = todo.pop()
            for way, inverted in (
                (int(lanelets.left_way[k]), lanelets.left_inverted[k]),
                (int(lanelets.right_way[k]), lanelets.right_inverted[k]),
            ):
                sign = group.lanelet_sign[k] * (-1 if inverted else 1)
                if group.way_sign.setdefault(way, sign) != sign:
                    return None
                for other, side in users[way]:
                    if other not in group.lanelet_sign:
                        group.lanelet_sign[other] = sign * side
                        todo.append(other)
        for k, sign in group.lanelet_sign.items():
            if self.facts.drawn_way[k] >= 0:
                group.way_sign[int(self.facts.drawn_way[k])] = -sign if self.facts.drawn_inverted[k] else sign
        return group

    def _problem(self, group: _Group) -> str:
        """Why this carriageway must stay whole; "" when it may be cut."""
        if any(self.uncuttable[w] for w in group.way_sign):
            return "a bound of the carriageway cannot be cut: it serves a rule, or passes a node twice"
        if any(self.facts.drawn_way[k] == -2 for k in group.lanelet_sign):
            return "a drawn centreline of the carriageway serves more than one lanelet or is not whole"
        if not self.params.split_everywhere:
            rows = np.array(list(group.lanelet_sign), dtype=np.int64)
            if not self.facts.open_to_cars[rows].all():
                return "a lanelet closed to cars shares the carriageway, set split_everywhere to cut it too"
            if not self.facts.lanelets.one_way[rows].all():
                return "a lanelet of the carriageway is driven both ways, set split_everywhere to cut it too"
        return ""

    def _line(self, way: int) -> Line:
        if way not in self.lines:
            a, b = (int(x) for x in self.map.document.ways.offset[way : way + 2])
            xy = self.map.xyz_m[self.node_rows[a:b], :2]
            along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
            self.lines[way] = Line(xy, along)
        return self.lines[way]

    def _bounds(self, k: int) -> tuple[Line, Line]:
        """Left and right bound of a lanelet, along it."""
        lanelets = self.facts.lanelets
        left, right = self._line(int(lanelets.left_way[k])), self._line(int(lanelets.right_way[k]))
        return (
            turned(left) if lanelets.left_inverted[k] else left,
            turned(right) if lanelets.right_inverted[k] else right,
        )

    def _shares(self, k: int) -> tuple[Floats, Floats]:
        """Metres along the centreline of a lanelet, and the share of its bounds there."""
        left, right = self._bounds(k)
        share = np.unique(
            np.concatenate([left.along_m / left.along_m[-1], right.along_m / right.along_m[-1]])
        )
        middle = (at_share(left, share) + at_share(right, share)) * 0.5
        return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(middle, axis=0).T))]), share

    def _places(self, group: _Group, wanted: list[Wanted]) -> list[tuple[float, Wanted]]:
        """Shares along the group's axis: wanted cuts nearer to each other than to an end become one between them."""
        length = max(float(self.facts.length_m[k]) for k in group.lanelet_sign)
        found = []
        for w in wanted:
            along, share = self._shares(w.lanelet)
            at = float(np.interp(w.s_m, along, share))
            found.append((at if group.lanelet_sign[w.lanelet] > 0 else 1.0 - at, w))
        found.sort(key=lambda f: (f[0], self._place_of(f[1].lanelet)))
        near = self.params.split_end_distance_m / length
        clusters = [[f] for f in found if near <= f[0] <= 1.0 - near]
        while len(clusters) > 1:
            centres = [_centre(c) for c in clusters]
            gaps = [b - a for a, b in pairwise(centres)]
            i = gaps.index(min(gaps))
            if gaps[i] >= near:
                break
            clusters[i : i + 2] = [clusters[i] + clusters[i + 1]]
        return [(_centre(c), c[0][1]) for c in clusters]

    def _way_cuts(self, way: int, sign: int, shares: list[float]) -> list[WayCut]:
        """The cuts of a way in its own direction."""
        line = self._line(way)
        own = sorted(s if sign > 0 else 1.0 - s for s in shares)
        end_m = self._end_m(line)
        return [place(line, s, self.params.split_snap_m, end_m) for s in own]

    def _end_m(self, line: Line) -> float:
        """No cut of a bound is nearer to its end; of a short bound less, or it could not be cut with the others."""
        return min(self.params.split_end_distance_m, 0.25 * float(line.along_m[-1]))

    def _harm(self, group: _Group, shares: list[float]) -> str:
        """Why these cuts would do harm; "" when they do none."""
        cuts = {w: self._way_cuts(w, sign, shares) for w, sign in group.way_sign.items()}
        for way, places in cuts.items():
            along = [c.along_m for c in places]
            total = float(self._line(way).along_m[-1])
            inner = min((b - a for a, b in pairwise(along)), default=total)
            if min(along[0], total - along[-1]) < self._end_m(self._line(way)):
                return "a bound of the carriageway would be cut too near to its end"
            if (
                inner < max(PIECE_MIN_M, 0.5 * self.params.split_end_distance_m)
                or along[0] < PIECE_MIN_M
                or total - along[-1] < PIECE_MIN_M
            ):
                return "a piece of a bound would be too short"
        if not all(self._sound(k, cuts) for k in group.lanelet_sign):
            return "a piece of the carriageway would cross itself"
        return ""

    def _sound(self, k: int, cuts: dict[int, list[WayCut]]) -> bool:
        """All pieces of a lanelet are simple areas, unless the whole was none."""
        lanelets = self.facts.lanelets
        left, right = self._bounds(k)
        if not shapely.is_valid(area([left.xy_m, right.xy_m[::-1]])):
            return True
        at_left = own_places(cuts[int(lanelets.left_way[k])], left, bool(lanelets.left_inverted[k]))
        at_right = own_places(cuts[int(lanelets.right_way[k])], right, bool(lanelets.right_inverted[k]))
        both = zip(pieces(left, at_left), pieces(right, at_right), strict=True)
        areas = [area([a, b[::-1]]) for a, b in both]
        return bool(np.all(shapely.is_valid(areas)) and np.all(shapely.area(areas) > 0.0))

    def _accept(self, group: _Group, accepted: list[tuple[float, Wanted]]) -> None:
        shares = [s for s, _ in accepted]
        cuts = {w: self._way_cuts(w, sign, shares) for w, sign in group.way_sign.items()}
        self.plan.ways.update(cuts)
        lanelets = self.facts.lanelets
        for k, sign in group.lanelet_sign.items():
            along, share = self._shares(k)
            left, right = self._bounds(k)
            at_left = own_places(cuts[int(lanelets.left_way[k])], left, bool(lanelets.left_inverted[k]))
            at_right = own_places(cuts[int(lanelets.right_way[k])], right, bool(lanelets.right_inverted[k]))
            mean = (np.array(at_left) / left.along_m[-1] + np.array(at_right) / right.along_m[-1]) * 0.5
            causes = [w for _, w in sorted(accepted, key=lambda a: a[0] * sign)]
            places = np.interp(mean, share, along).tolist()
            self.plan.lanelets[k] = [LaneletCut(s, w) for s, w in zip(places, causes, strict=True)]


def _centre(cluster: list[tuple[float, Wanted]]) -> float:
    """Between the first and the last share of a cluster in order."""
    return (cluster[0][0] + cluster[-1][0]) * 0.5
