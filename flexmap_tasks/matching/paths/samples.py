"""Carriageways of the lanelet map as samples to be matched, and how the samples hang together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from flexmap_tasks.geometry.lanelets import along_m, lengths_m, offsets
from flexmap_tasks.matching.collapse import members_as_lanelets
from flexmap_tasks.model import lanelets as lanes
from flexmap_tasks.model.arrays import Bools, Floats, Ints
from flexmap_tasks.model.conflation import Centerlines
from flexmap_tasks.model.maps import LaneletMap, Lanelets

CONNECTOR_MAX_M = 80.0
"""A lane that branches off at a junction and is longer than this is a road of its own."""

BEND_MAX_M, BEND_MIN_DEG = 40.0, 45.0
STRAY_MAX_M = 20.0
STACK_REACH_M, STACK_MIN_M = 8.0, 3.0
TWIN_MAX_M, TWIN_ALONG_M, TWIN_COS = 30.0, 6.0, -0.9


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Both directions of every centreline ("bundles"), sampled at the middles of equal parts.

    Bundles (lanes of one direction side by side), in the order of the centrelines, forward first:
    centerline, direction : (b,) int64; offset : (b + 1,) int64 into the samples; length_m : (b,) float64
    home : (k,) int64, the bundle of every member lanelet

    Samples, along the bundle:
    bundle : (n,) int64; step_m : (n,) float64, the length a sample stands for
    point_m : (n, 2) float64, on the centreline; heading : (n, 2) float64, unit vectors of travel
    lone : (n,) bool, no lane comes towards it here; aside_m : (n,) float64, from the point to the middle of
    its own lanes, positive to the right of travel; inner_m : (n,) float64, from the point to
    where the middle of the road could lie at most, positive to the left in traffic on the right
    turn_deg : (n,) float64, how far a junction connector turns in all, 0 for other lanes
    connector : (n,) bool; stray : (n,) bool, of a short lanelet that nothing leads to or from

    lanes : (n,) int64, lanes side by side in the direction of travel
    level : (n,) int64, +1 where another carriageway runs below, -1 where one runs above, else 0

    edges : (e, 2) int64, samples that follow each other; edge_m : (e,) float64, metres between them
    """

    centerline: Ints
    direction: Ints
    offset: Ints
    length_m: Floats
    home: Ints
    bundle: Ints
    step_m: Floats
    point_m: Floats
    heading: Floats
    lone: Bools
    aside_m: Floats
    inner_m: Floats
    turn_deg: Floats
    connector: Bools
    stray: Bools
    lanes: Ints
    level: Ints
    edges: Ints
    edge_m: Floats

    def __len__(self) -> int:
        return len(self.bundle)


def samples_of(centerlines: Centerlines, lanelet_map: LaneletMap, spacing_m: float) -> Samples:
    """Sample every direction of every centreline at most `spacing_m` apart."""
    lanelets = members_as_lanelets(centerlines, lanelet_map)
    members = centerlines.members
    key = members.centerline * 2 + (members.direction < 0)
    bundle_key, home = np.unique(key, return_inverse=True)
    centerline, direction = bundle_key // 2, np.where(bundle_key % 2, -1, 1)
    total = lengths_m(centerlines.offset, centerlines.xy_m)
    length = total[centerline]
    count = np.maximum(np.ceil(length / spacing_m - 1e-9), 1).astype(np.int64)
    offset = offsets(count)
    bundle = np.repeat(np.arange(len(count)), count)
    share = (np.arange(offset[-1]) - offset[bundle] + 0.5) / count[bundle]
    share = np.where(direction[bundle] > 0, share, 1.0 - share)
    point, heading = _stations(centerlines, centerline[bundle], share * length[bundle])
    heading = heading * direction[bundle][:, None]
    width = _widths_m(lanelet_map, lanelets)
    own = np.bincount(home, weights=width, minlength=len(count))
    every = np.bincount(members.centerline, weights=width, minlength=len(centerlines))[centerline]
    side = _kerb_side(centerlines)
    follow = lanes.follow_pairs(lanelet_map, lanelets)
    turn, connector = _connectors(lanelets, follow, home, offset, heading, length)
    stray = ~np.isin(np.arange(len(count)), home[follow]) & (length < STRAY_MAX_M)
    edges, edge_m = _edges(offset, home, follow, length / count)
    return Samples(
        centerline, direction, offset, length, home, bundle, (length / count)[bundle], point, heading,
        lone=(own == every)[bundle],
        aside_m=(side * (every - own) / 2)[bundle],
        inner_m=side * _inner_m(point, heading, side, (own / 2)[bundle], (own == every)[bundle] & ~connector[bundle]),
        turn_deg=turn[bundle],
        connector=connector[bundle],
        stray=stray[bundle],
        lanes=np.bincount(home, minlength=len(count))[bundle],
        level=_levels(point, _heights_m(lanelet_map, lanelets, home, offset)),
        edges=edges,
        edge_m=edge_m,
    )  # fmt: skip


def _stations(centerlines: Centerlines, line: Ints, s_m: Floats) -> tuple[Floats, Floats]:
    """Points and unit tangents at metres along centrelines."""
    along = along_m(centerlines.offset, centerlines.xy_m)
    base = np.append(0.0, np.cumsum(lengths_m(centerlines.offset, centerlines.xy_m)))
    size = np.diff(centerlines.offset)
    walk = along + np.repeat(base[:-1], size)
    first, last = centerlines.offset[line], centerlines.offset[line + 1] - 2
    row = np.clip(np.searchsorted(walk, base[line] + s_m, side="right") - 1, first, last)
    a, b = centerlines.xy_m[row], centerlines.xy_m[row + 1]
    run = b - a
    step = np.hypot(*run.T)
    t = np.clip(np.divide(s_m - along[row], step, out=np.zeros_like(s_m), where=step > 0), 0.0, 1.0)
    heading = np.divide(run, step[:, None], out=np.tile([1.0, 0.0], (len(run), 1)), where=step[:, None] > 0)
    return a + t[:, None] * run, heading


def _widths_m(lanelet_map: LaneletMap, lanelets: Lanelets) -> Floats:
    """(k,) mean width of every lanelet: the area between its bounds over its length."""
    left, right = (lanes.bound_polylines(lanelet_map, lanelets, side) for side in ("left", "right"))
    length = lanes.lengths_m(lanes.centrelines(lanelet_map, lanelets))
    origin = left.xyz_m[left.offset[:-1], :2]
    ends = [line.xyz_m[line.offset[1:] - 1, :2] - origin for line in (left, right)]
    double = ends[0][:, 0] * ends[1][:, 1] - ends[0][:, 1] * ends[1][:, 0]
    for line, sign in ((left, 1.0), (right, -1.0)):
        row = np.repeat(np.arange(len(line)), np.diff(line.offset))
        p = line.xyz_m[:, :2] - origin[row]
        cross = np.where(row[:-1] == row[1:], p[:-1, 0] * p[1:, 1] - p[:-1, 1] * p[1:, 0], 0.0)
        double = double + sign * np.bincount(row[:-1], weights=cross, minlength=len(double))
    width: Floats = np.clip(np.abs(double) / 2 / np.maximum(length, 1e-6), 0.0, 10.0)
    return width


def _heights_m(lanelet_map: LaneletMap, lanelets: Lanelets, home: Ints, offset: Ints) -> Floats:
    """(n,) height of every sample, as the first lanelet of its bundle has it at the nearest vertex."""
    line = lanes.centrelines(lanelet_map, lanelets)
    count = np.diff(offset)
    first = np.unique(home, return_index=True)[1]
    bundle = np.repeat(np.arange(len(count)), count)
    share = (np.arange(offset[-1]) - offset[bundle] + 0.5) / count[bundle]
    vertex = np.rint(share * (np.diff(line.offset)[first][bundle] - 1)).astype(np.int64)
    height: Floats = line.xyz_m[line.offset[first][bundle] + vertex, 2]
    return height


def _levels(point_m: Floats, height_m: Floats) -> Ints:
    """(n,) whether something is mapped right below (+1) or above (-1) a sample."""
    if len(point_m) < 2:
        return np.zeros(len(point_m), dtype=np.int64)
    pairs = cKDTree(point_m).query_pairs(STACK_REACH_M, output_type="ndarray")
    step = height_m[pairs[:, 0]] - height_m[pairs[:, 1]]
    apart = np.abs(step) > STACK_MIN_M
    pairs, sign = pairs[apart], np.sign(step[apart])
    total = np.bincount(pairs[:, 0], weights=sign, minlength=len(point_m))
    total -= np.bincount(pairs[:, 1], weights=sign, minlength=len(point_m))
    return np.sign(total).astype(np.int64)


def _inner_m(point_m: Floats, heading: Floats, side: float, half_m: Floats, lone: Bools) -> Floats:
    """(n,) how far towards oncoming traffic the middle of the road may lie.

    Half the width of the lanes, or, where another carriageway runs the other way beside this one, half of what
    lies between them: a road with a median may be drawn as one line.
    """
    rows = np.flatnonzero(lone)
    out = half_m.copy()
    if len(rows) < 2:
        return out
    pairs = rows[cKDTree(point_m[rows]).query_pairs(TWIN_MAX_M, output_type="ndarray")]
    a, b = np.concatenate([pairs, pairs[:, ::-1]]).T
    opposed = np.einsum("ij,ij->i", heading[a], heading[b]) < TWIN_COS
    a, b = a[opposed], b[opposed]
    to = point_m[b] - point_m[a]
    along = np.abs(np.einsum("ij,ij->i", to, heading[a]))
    inwards = side * (heading[a, 0] * to[:, 1] - heading[a, 1] * to[:, 0])
    beside = (inwards > half_m[a]) & (along < TWIN_ALONG_M)
    nearest = np.full(len(point_m), np.inf)
    np.minimum.at(nearest, a[beside], inwards[beside] / 2)
    return np.where(np.isfinite(nearest), np.maximum(out, nearest), out)


def _kerb_side(centerlines: Centerlines) -> float:
    """+1.0 where traffic keeps to the right, -1.0 to the left; as the two-way centrelines of the map show."""
    members = centerlines.members
    new = np.append(True, members.centerline[1:] != members.centerline[:-1])[: len(members)]
    first = members.direction[new]
    last = members.direction[np.append(new[1:], True)[: len(members)]]
    return -1.0 if (first > last).sum() > (first < last).sum() else 1.0


def _connectors(
    lanelets: Lanelets, follow: Ints, home: Ints, offset: Ints, heading: Floats, length_m: Floats
) -> tuple[Floats, Bools]:
    """Per bundle: how far it turns from start to end in degrees, and whether it joins roads in a junction."""
    n = len(lanelets)
    out, into = (np.bincount(follow[:, k], minlength=n) for k in (0, 1))
    shared = np.zeros(n, dtype=bool)
    shared[follow[out[follow[:, 0]] > 1, 1]] = True
    shared[follow[into[follow[:, 1]] > 1, 0]] = True
    connector = np.zeros(len(length_m), dtype=bool)
    connector[home[shared]] = True
    a, b = heading[offset[:-1]], heading[offset[1:] - 1]
    turn = np.degrees(np.abs(np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], np.einsum("ij,ij->i", a, b))))
    # A sharp short bend is a turn as well, though it be the only way on.
    connector |= (length_m < BEND_MAX_M) & (turn > BEND_MIN_DEG)
    connector &= length_m < CONNECTOR_MAX_M
    return np.where(connector, turn, 0.0), connector


def _edges(offset: Ints, home: Ints, follow: Ints, step_m: Floats) -> tuple[Ints, Floats]:
    """Neighbouring samples of each bundle, then last and first samples of bundles that follow each other."""
    n = int(offset[-1])
    bundle = np.repeat(np.arange(len(step_m)), np.diff(offset))
    inner = np.flatnonzero(bundle[1:] == bundle[:-1]) if n else np.zeros(0, dtype=np.int64)
    pairs = np.unique(home[follow], axis=0).reshape(-1, 2)
    across = np.stack([offset[pairs[:, 0] + 1] - 1, offset[pairs[:, 1]]], axis=1)
    edges = np.concatenate([np.stack([inner, inner + 1], axis=1), across])
    metres = np.concatenate([step_m[bundle[inner]], step_m[pairs].sum(axis=1) / 2])
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    return edges[order], metres[order]
