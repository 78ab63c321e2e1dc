"""People's decisions on matches, carried out before anything is transferred."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely

from flexmap_tasks.engine.stage import stage
from flexmap_tasks.model import lanelets as lanes
from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.model.conflation import Matches
from flexmap_tasks.model.maps import LaneletMap, PlacedRoads
from flexmap_tasks.model.osm import rows_of
from flexmap_tasks.model.review import ReviewDecisions, ReviewedMatches

MIN_OVERLAP = 0.5
"""A decision holds for a piece of which it names at least this share: new data shift where pieces begin and end."""
FARTHEST_M = 50.0
"""A chosen way that lies further from the piece than this, on the mean, is no longer the one that was meant."""
SAMPLES = 9


@stage("reviewed_matches")
def review_matches(
    matches: Matches, decisions: ReviewDecisions, lanelet_map: LaneletMap, roads: PlacedRoads
) -> ReviewedMatches:
    """The matches as people decided them, and the decisions that met no piece.

    A decision counts for the pieces of its lanelet that were offered the same way and that it covers; of several
    for one piece the last one counts. "accept" takes the way offered, or the way named as `value`; "reject" says
    that the piece has no counterpart. Where the way offered has changed, or the chosen one is gone or far away,
    the decision changes nothing.
    """
    governs = _governed(matches, decisions)
    laid = _Laid(lanelet_map, roads)
    columns = {name: getattr(matches, name).copy() for name in Matches.__slots__}
    used = np.zeros(len(decisions), dtype=bool)
    for row, ruling in sorted(governs.items()):
        for d in ruling:
            used[d] = True
        d = ruling[-1]
        if decisions.accept[d] == "reject":
            _put(columns, row, 0, (np.nan, np.nan, 0), 0.0)
        elif decisions.value[d]:
            found = laid.along(matches, row, int(decisions.value[d]))
            if found is None:
                used[d] = False
                continue
            _put(columns, row, int(decisions.value[d]), found, 1.0)
        elif columns["way_id"][row] == 0:
            used[d] = False
            continue
        decided = columns["way_id"][row] != 0
        columns["decision"][row] = "match" if decided else "none"
        columns["confidence"][row] = 1.0
        verb = "chosen" if decisions.value[d] else "accepted" if decided else "rejected"
        columns["reason"][row] = f"{verb} {decisions.by(d)}"
    return ReviewedMatches(replace(matches, **columns), decisions.take(~used))


def _governed(matches: Matches, decisions: ReviewDecisions) -> dict[int, list[int]]:
    """Decisions by row of the matches they speak of, in their order."""
    if not len(decisions):
        return {}
    order = np.argsort(matches.lanelet_id, kind="stable")
    ids = matches.lanelet_id[order]
    first = np.searchsorted(ids, decisions.lanelet_id, side="left").tolist()
    last = np.searchsorted(ids, decisions.lanelet_id, side="right").tolist()
    out: dict[int, list[int]] = {}
    for d, (a, b) in enumerate(zip(first, last, strict=True)):
        for row in order[a:b].tolist():
            low, high = matches.s_from_m[row], matches.s_to_m[row]
            covered = min(high, decisions.s_to_m[d]) - max(low, decisions.s_from_m[d])
            if matches.way_id[row] == decisions.way_id[d] and covered >= MIN_OVERLAP * (high - low):
                out.setdefault(row, []).append(d)
    return out


def _put(columns: dict[str, Ints], row: int, way: int, along: tuple[float, float, int], score: float) -> None:
    columns["way_id"][row] = way
    columns["way_s_from_m"][row], columns["way_s_to_m"][row], columns["direction"][row] = along
    columns["score"][row] = score
    for name in ("d_angle_deg", "d_length_m", "d_chord_m", "d_area_m"):
        columns[name][row] = np.nan


class _Laid:
    """Lanelets and ways as lines, made when a decision asks for one."""

    def __init__(self, lanelet_map: LaneletMap, roads: PlacedRoads) -> None:
        self._map, self._roads = lanelet_map, roads
        self._found = lanes.lanelets_of(lanelet_map)
        self._middle: lanes.Polylines | None = None

    def along(self, matches: Matches, row: int, way_id: int) -> tuple[float, float, int] | None:
        """Metres along the way where the piece begins and ends, and its direction; None where it is not there."""
        network = self._roads.network
        (way,) = rows_of(network.way_id, np.array([way_id])).tolist()
        (lane,) = rows_of(self._found.id, matches.lanelet_id[[row]]).tolist()
        if way < 0 or lane < 0 or network.offset[way + 1] - network.offset[way] < 2:
            return None
        self._middle = self._middle or lanes.centrelines(self._map, self._found)
        middle = self._middle.xyz_m[self._middle.offset[lane] : self._middle.offset[lane + 1], :2]
        course = self._roads.xy_m[network.offset[way] : network.offset[way + 1]]
        at = np.linspace(matches.s_from_m[row], matches.s_to_m[row], SAMPLES)
        return _laid_along(middle, course, at) if np.isfinite(course).all() and len(middle) > 1 else None


def _laid_along(middle: Floats, course: Floats, at_m: Floats) -> tuple[float, float, int] | None:
    places = shapely.line_interpolate_point(shapely.LineString(middle), at_m)
    line = shapely.LineString(course)
    if float(shapely.distance(line, places).mean()) > FARTHEST_M:
        return None
    s = shapely.line_locate_point(line, places)
    steps = np.diff(s)
    if line.is_closed:
        steps = (steps + line.length / 2) % line.length - line.length / 2
    return float(s[0]), float(s[-1]), 1 if steps.sum() >= 0 else -1
