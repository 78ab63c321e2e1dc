"""Does the map have as many lanes as OpenStreetMap says?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flexmap_tasks.model.arrays import Bools, Ints, strings
from flexmap_tasks.model.conflation import Centerlines, LaneCheck
from flexmap_tasks.model.maps import Lanelets, PlacedRoads
from flexmap_tasks.model.osm import rows_of
from flexmap_tasks.transfer.values import count, one_way_sense

NO_LANES = "OSM names no number of lanes"
NOT_COUNTED = "lanes are not counted in a junction, nor on no centreline"


@dataclass(frozen=True, slots=True, eq=False)
class LaneCounts:
    """Lanes of the carriageway each lanelet belongs to, by row of the lanelet.

    same, all : (k,) int64, in its direction and in both; -1 for a lanelet on no centreline
    centerline : (k,) int64, -1 for none; lane : (k,) int64, growing outwards
    """

    same: Ints
    all: Ints
    centerline: Ints
    lane: Ints


@dataclass(frozen=True, slots=True)
class Expected:
    """What a way says of its lanes: `lanes` of one direction or of both, -1 when it says nothing usable."""

    lanes: int
    one_direction: bool
    reason: str


def lane_counts(centerlines: Centerlines, lanelets: Lanelets) -> LaneCounts:
    """Count the lanelets side by side; one that is used both ways counts in both directions."""
    row = rows_of(lanelets.id, centerlines.members.lanelet_id)
    known = row >= 0
    line, row = centerlines.members.centerline[known], row[known]
    forward = centerlines.members.direction[known] > 0
    both = ~lanelets.one_way[row]
    size = int(line.max(initial=-1)) + 1
    ahead = np.bincount(line[forward | both], minlength=size)
    back = np.bincount(line[~forward | both], minlength=size)
    out = [np.full(len(lanelets), -1, dtype=np.int64) for _ in range(4)]
    out[0][row] = np.where(forward, ahead[line], back[line])
    out[1][row] = np.bincount(line, minlength=size)[line]
    out[2][row], out[3][row] = line, centerlines.members.lane[known]
    return LaneCounts(*out)


def expected_lanes(tags: Mapping[str, str], sense: int) -> Expected:
    """Lanes of a way for a lanelet along it (`sense` +1) or against it (-1).

    From `lanes:forward` or `lanes:backward`, else `lanes` less those of the other direction, else the number of
    entries of `turn:lanes`. Bus lanes are lanes, as OSM counts them; cycle lanes and shoulders are none.
    """
    one_way = bool(one_way_sense(tags))
    side, other = ("forward", "backward") if sense > 0 else ("backward", "forward")
    keys = ("lanes", f"lanes:{side}", f"lanes:{other}", "lanes:both_ways")
    said = {key: tags[key].strip() for key in keys if tags.get(key, "").strip()}
    numbers = {key: count(text) for key, text in said.items()}
    bad = [key for key, number in numbers.items() if number is None]
    if bad:
        return Expected(-1, False, f"{bad[0]}={said[bad[0]][:40]} is no number of lanes")
    lanes = {key: number for key, number in numbers.items() if number is not None}
    total, parts = lanes.get("lanes"), sum(n for key, n in lanes.items() if key != "lanes")
    if total is not None and {f"lanes:{side}", f"lanes:{other}"} <= lanes.keys() and total != parts:
        return Expected(-1, False, f"lanes={total}, but its parts make {parts}")
    if f"lanes:{side}" in lanes:
        return Expected(lanes[f"lanes:{side}"], True, f"lanes:{side}={lanes[f'lanes:{side}']}")
    if total is not None:
        return _of_all(total, parts if f"lanes:{other}" in lanes else 0, one_way)
    for key in (f"turn:lanes:{side}", "turn:lanes") if one_way else (f"turn:lanes:{side}",):
        if tags.get(key, "").strip():
            return Expected(tags[key].count("|") + 1, True, f"{key}={tags[key][:40]}")
    return Expected(-1, False, NO_LANES)


def _of_all(total: int, others: int, one_way: bool) -> Expected:
    """From `lanes`, and those of them that are told to be for other directions."""
    if not others:
        return Expected(total, one_way, f"lanes={total}")
    reason = f"lanes={total}, of them {others} not in this direction"
    return Expected(total - others if total > others else -1, True, reason)


def check_lanes(
    lanelet_id: Ints,
    source: Ints,
    road: Ints,
    sense: Ints,
    counted: Bools,
    in_junction: Bools,
    counts: LaneCounts,
    roads: PlacedRoads,
) -> LaneCheck:
    """Compare each lanelet (its row before cutting: `source`) with its way (row `road`, -1 for none).

    Only lanelets with `counted` are listed. Through a junction lanes spread out: nothing is compared there.
    Columns have one entry per lanelet.
    """
    keep = np.flatnonzero(counted)
    keep = keep[np.argsort(lanelet_id[keep], kind="stable")]
    pairs, inverse = np.unique(np.stack([road, sense], axis=1)[keep], axis=0, return_inverse=True)
    none = Expected(-1, False, "no matched way")
    table = [
        expected_lanes(roads.network.tags.of_element(r), s) if r >= 0 else none for r, s in pairs.tolist()
    ]
    at = inverse.ravel()
    lanes_osm = np.array([e.lanes for e in table], dtype=np.int64)[at]
    one_direction = np.array([e.one_direction for e in table], dtype=bool)[at]
    lanes_map = np.where(one_direction, counts.same[source[keep]], counts.all[source[keep]])
    lanes_map[in_junction[keep]] = -1
    unmatched, unknown = road[keep] < 0, (lanes_osm < 0) | (lanes_map < 0)
    verdict = np.where(lanes_map == lanes_osm, "agree", "differ")
    verdict = np.where(unmatched, "unmatched", np.where(unknown, "unknown", verdict))
    where = np.where(one_direction, "in its direction", "in all")
    reason = [
        NOT_COUNTED
        if n < 0 and o >= 0
        else table[a].reason
        if o < 0
        else f"{table[a].reason}, the map has {n} {w}"
        for a, n, o, w in zip(
            at.tolist(), lanes_map.tolist(), lanes_osm.tolist(), where.tolist(), strict=True
        )
    ]
    way_id = np.where(unmatched, 0, roads.network.way_id[road[keep]] if len(roads.network) else 0)
    return LaneCheck(
        lanelet_id[keep],
        way_id.astype(np.int64),
        lanes_map,
        lanes_osm,
        strings(verdict.tolist()),
        verdict == "differ",
        strings(reason),
    )
