"""The truth beside the files: tables that an evaluation can be judged by."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.model.arrays import Floats, strings
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.drive import Drive
from flexmap_tasks.simulate.frame import TownFrame
from flexmap_tasks.simulate.gnss import GnssMessages
from flexmap_tasks.simulate.hd_map import DrawnLanelet, HdMap
from flexmap_tasks.simulate.lanes import LaneNetwork, Strip
from flexmap_tasks.simulate.osm import OsmTown, RoadPart
from flexmap_tasks.simulate.slam import SlamTrack
from flexmap_tasks.simulate.world import World

Table = dict[str, NDArray[Any]]
NS_PER_S = 1_000_000_000
LOCATION_RURAL = ("motorway", "motorway_link", "trunk", "trunk_link")
MIN_PIECE_M = 1e-6


def stamps_ns(world: World, time_s: Floats) -> NDArray[np.int64]:
    """Nanoseconds since the epoch of times since the start."""
    return np.asarray(world.drive.start_ns + np.rint(time_s * NS_PER_S).astype(np.int64))


def frame_table(world: World, frame: TownFrame, slam: SlamTrack) -> Table:
    """One row: the town's frame on Earth, the rigid part of town to SLAM, and the lever arm."""
    row: dict[str, float | int] = {
        "epsg": frame.epsg, "origin_easting_m": frame.easting_m, "origin_northing_m": frame.northing_m,
        "origin_height_m": frame.height_m, "grid_scale": frame.scale,
    }  # fmt: skip
    row |= {f"rotation_{i}{j}": float(slam.rotation[i, j]) for i in range(3) for j in range(3)}
    for name, vector in (
        ("pivot", slam.origin_m),
        ("start", slam.start_m),
        ("lever", world.gnss.lever_arm_m),
    ):
        row |= {f"{name}_{axis}_m": float(v) for axis, v in zip("xyz", vector, strict=True)}
    row["clock_offset_s"] = world.gnss.clock_offset_s
    return {k: np.array([v]) for k, v in row.items()}


def pose_table(world: World, frame: TownFrame, drive: Drive, slam: SlamTrack, gnss: GnssMessages) -> Table:
    """Every SLAM pose: where the body truly was, what SLAM says, and what GNSS was doing."""
    geo = frame.geodetic(slam.true_xyz_m)
    flags = {
        name: _nearest_flag(slam.time_s, gnss.time_s, getattr(gnss, name), 1.5 / world.gnss.rate_hz)
        for name in ("multipath", "jump")
    }
    gap = (
        np.abs(gnss.time_s[_nearest(slam.time_s, gnss.time_s)] - slam.time_s) if len(gnss.time_s) else np.inf
    )
    return {
        "row": np.arange(len(slam.time_s)), "stamp_ns": stamps_ns(world, slam.time_s), "s_m": slam.s_m,
        "lon_deg": geo[:, 0], "lat_deg": geo[:, 1], "ele_m": geo[:, 2],
        "true_x_m": slam.true_xyz_m[:, 0], "true_y_m": slam.true_xyz_m[:, 1], "true_z_m": slam.true_xyz_m[:, 2],
        "true_yaw_rad": slam.true_yaw_rad, "true_pitch_rad": slam.true_pitch_rad,
        "slam_x_m": slam.xyz_m[:, 0], "slam_y_m": slam.xyz_m[:, 1], "slam_z_m": slam.xyz_m[:, 2],
        "slam_qx": slam.quaternion[:, 0], "slam_qy": slam.quaternion[:, 1], "slam_qz": slam.quaternion[:, 2],
        "slam_qw": slam.quaternion[:, 3],
        "outage": np.broadcast_to(gap > 1.5 / world.gnss.rate_hz, (len(slam.time_s),)).copy(),
        "standstill": drive.stands(slam.time_s), **flags,
    }  # fmt: skip


def _nearest(time: Floats, others: Floats) -> NDArray[np.int64]:
    order = np.argsort(others, kind="stable")
    right = np.clip(np.searchsorted(others[order], time), 1, max(len(others) - 1, 1))
    left = right - 1
    right = np.minimum(right, len(others) - 1)
    nearer = np.abs(others[order[left]] - time) <= np.abs(others[order[right]] - time)
    return np.asarray(order[np.where(nearer, left, right)])


def _nearest_flag(
    time: Floats, others: Floats, flag: NDArray[np.bool_], within_s: float
) -> NDArray[np.bool_]:
    if not len(others):
        return np.zeros(len(time), dtype=bool)
    row = _nearest(time, others)
    return np.asarray(flag[row] & (np.abs(others[row] - time) <= within_s))


def gnss_table(world: World, frame: TownFrame, gnss: GnssMessages) -> Table:
    """Every message: where the antenna truly was, and the error of the fix (grid east, north, up)."""
    geo = frame.geodetic(gnss.antenna_m)
    return {
        "row": np.arange(len(gnss.time_s)), "true_stamp_ns": stamps_ns(world, gnss.time_s),
        "stamp_ns": stamps_ns(world, gnss.stamp_s), "lon_deg": geo[:, 0], "lat_deg": geo[:, 1],
        "ele_m": geo[:, 2], "error_east_m": gnss.error_m[:, 0], "error_north_m": gnss.error_m[:, 1],
        "error_up_m": gnss.error_m[:, 2], "mode": gnss.mode, "status": gnss.status,
        "multipath": gnss.multipath, "outage": gnss.outage, "jump": gnss.jump, "standstill": gnss.stand,
    }  # fmt: skip


def node_table(frame: TownFrame, hd_map: HdMap) -> Table:
    """Every node of the HD map: where it belongs on Earth."""
    geo = frame.geodetic(hd_map.town_xyz_m)
    return {
        "node_id": hd_map.node_id, "lon_deg": geo[:, 0], "lat_deg": geo[:, 1], "ele_m": geo[:, 2],
        "x_m": hd_map.town_xyz_m[:, 0], "y_m": hd_map.town_xyz_m[:, 1], "z_m": hd_map.town_xyz_m[:, 2],
    }  # fmt: skip


class MatchRows:
    """Rows of the match table, and the tags that follow from them."""

    def __init__(self) -> None:
        self.rows: list[tuple[Any, ...]] = []
        self.tags: list[tuple[Any, ...]] = []

    def add(
        self, lanelet: DrawnLanelet, s: tuple[float, float], length: float, part: RoadPart | None,
        way_s: tuple[float, float], direction: int, kind: str, reason: str, road: int, also: int = 0,
    ) -> None:  # fmt: skip
        """One piece; lower way_s first."""
        way = part.way_id if part else 0
        low, high = (min(way_s), max(way_s)) if part else (np.nan, np.nan)
        self.rows.append(
            (lanelet.id, *s, length, way, low, high, direction if part else 0, kind, reason, road, also)
        )


COLUMNS = ("lanelet_id", "s_from_m", "s_to_m", "lanelet_length_m", "way_id", "way_s_from_m", "way_s_to_m",
           "direction", "class", "reason", "road", "also_way_id")  # fmt: skip
TAG_COLUMNS = ("lanelet_id", "s_from_m", "s_to_m", "lanelet_length_m", "key", "value", "osm_value", "way_id")


def match_tables(lanes: LaneNetwork, hd_map: HdMap, osm: OsmTown) -> tuple[Table, Table]:
    """Truth of matching, and of the values each piece should get."""
    rows = MatchRows()
    for lanelet in hd_map.lanelets:
        if lanelet.kind == "fragment":
            _fragment(rows, lanelet)
        elif lanelet.strip >= 0 and lanes.strips[lanelet.strip].drivable:
            strip = lanes.strips[lanelet.strip]
            line = lanes.centreline(strip)[lanelet.first : lanelet.last + 1]
            if strip.kind == "turn":
                _turn(rows, lanes, osm, lanelet, strip, line)
            else:
                _link(rows, lanes, osm, lanelet, strip, line)
    kinds: dict[str, Any] = {"lanelet_id": np.int64, "way_id": np.int64, "direction": np.int64, "road": np.int64,
                             "also_way_id": np.int64}  # fmt: skip
    return _columns(COLUMNS, rows.rows, kinds), _columns(TAG_COLUMNS, rows.tags, kinds)


def _columns(names: tuple[str, ...], rows: list[tuple[Any, ...]], kinds: dict[str, Any]) -> Table:
    text = ("class", "reason", "key", "value", "osm_value")
    return {
        name: strings(r[k] for r in rows)
        if name in text
        else np.array([r[k] for r in rows], dtype=kinds.get(name, np.float64))
        for k, name in enumerate(names)
    }


def _fragment(rows: MatchRows, lanelet: DrawnLanelet) -> None:
    rows.add(lanelet, (0.0, 8.0), 8.0, None, (0.0, 0.0), 0, "none", "fragment", -1)


def _link(
    rows: MatchRows, lanes: LaneNetwork, osm: OsmTown, lanelet: DrawnLanelet, strip: Strip, line: Floats
) -> None:
    """A lane on a road: every way part it runs along."""
    road_s = strip.road_s[lanelet.first : lanelet.last + 1]
    s = lines.along(line)
    kind = "stub" if lanelet.stub else "link"
    _along(rows, lanes, osm, lanelet, strip.road, strip.direction, road_s, s, float(s[-1]), kind)


def _along(
    rows: MatchRows, lanes: LaneNetwork, osm: OsmTown, lanelet: DrawnLanelet, road: int, direction: int,
    road_s: Floats, s: Floats, length: float, kind: str, also: int = 0,
) -> None:  # fmt: skip
    """Rows for a stretch of a lanelet that runs along a road; road_s and s (n,) at the same places."""
    up = (road_s, s) if road_s[-1] >= road_s[0] else (road_s[::-1], s[::-1])
    low, high = float(up[0][0]), float(up[0][-1])
    parts = osm.parts.get(road, [])
    if not parts:
        rows.add(
            lanelet, (float(s[0]), float(s[-1])), length, None, (0.0, 0.0), 0, "none", "missing_in_osm", road
        )
    for part in parts:
        a, b = max(low, float(part.road_s[0])), min(high, float(part.road_s[-1]))
        if b - a <= MIN_PIECE_M:
            continue
        at = sorted(np.interp([a, b], *up).tolist())
        way = np.interp([a, b], part.road_s, part.way_s).tolist()
        rows.add(
            lanelet,
            (at[0], at[1]),
            length,
            part,
            (way[0], way[1]),
            direction * part.direction,
            kind,
            "",
            road,
            also,
        )
    _tags(rows, lanes, osm, lanelet, road, up, length)


def _turn(
    rows: MatchRows, lanes: LaneNetwork, osm: OsmTown, lanelet: DrawnLanelet, strip: Strip, line: Floats
) -> None:
    """A turn: up to where it passes the junction on the first road, from there on the second.

    Where one way runs on through the junction both rows name it; `also_way_id` is the other road's way, which
    a fair judge accepts too.
    """
    node = lanes.network.node_xyz[strip.node]
    s = lines.along(line)
    fine = lines.resample(line, 0.1)
    middle = float(lines.along(fine)[int(np.argmin(np.hypot(*(fine[:, :2] - node[:2]).T)))])
    middle = float(np.clip(middle, 0.02 * s[-1], 0.98 * s[-1]))
    ends = []
    for road, direction, leaving in (
        (strip.road, strip.direction, False),
        (strip.to_road, strip.to_direction, True),
    ):
        at_end = (direction > 0) != leaving
        length = lanes.network.roads[road].length_m
        trim = lanes.trims[road, at_end]
        span = (length, length - trim) if at_end else (0.0, trim)
        ends.append((road, direction, span[::-1] if not leaving else span))
    ways = [_way_at(osm, road, span) for road, _, span in ends]
    for k, (road, direction, span) in enumerate(ends):
        piece = (0.0, middle) if k == 0 else (middle, float(s[-1]))
        other = ways[1 - k] if ways[1 - k] != ways[k] else 0
        _along(
            rows,
            lanes,
            osm,
            lanelet,
            road,
            direction,
            np.array(span),
            np.array(piece),
            float(s[-1]),
            "junction",
            other,
        )


def _way_at(osm: OsmTown, road: int, span: tuple[float, ...]) -> int:
    middle = sum(span) / 2
    return next((p.way_id for p in osm.parts.get(road, []) if p.road_s[0] <= middle <= p.road_s[-1]), 0)


def _tags(
    rows: MatchRows, lanes: LaneNetwork, osm: OsmTown, lanelet: DrawnLanelet, road: int,
    up: tuple[Floats, Floats], length: float,
) -> None:  # fmt: skip
    """What the road is really like, and what OSM says of it, over the stretch."""
    line = lanes.network.roads[road]
    low, high = float(up[0][0]), float(up[0][-1])
    parts = osm.parts.get(road, [])
    borders = sorted({low, high, *(f for f, _, _ in line.sections() if low < f < high),
                      *(float(p.road_s[0]) for p in parts if low < p.road_s[0] < high)})  # fmt: skip
    for a, b in zip(borders, borders[1:], strict=False):
        if b - a <= MIN_PIECE_M:
            continue
        section = next(t for f, _, t in reversed(line.sections()) if f <= (a + b) / 2)
        part = next((p for p in parts if p.road_s[0] <= (a + b) / 2 <= p.road_s[-1]), None)
        said = osm.tags[part.way_id] if part else {}
        s = sorted(np.interp([a, b], *up).tolist())
        truth = expected(
            line.highway, section.get("maxspeed", ""), section.get("name", ""), section.get("surface", "")
        )
        offered = expected(
            said.get("highway", ""), said.get("maxspeed", ""), said.get("name", ""), said.get("surface", "")
        )
        for key, value in truth.items():
            rows.tags.append(
                (lanelet.id, s[0], s[1], length, key, value, offered[key], part.way_id if part else 0)
            )


def expected(highway: str, maxspeed: str, name: str, surface: str) -> dict[str, str]:
    """Lanelet2 attributes of a road with these OSM tags; "" where nothing is known."""
    if not highway:
        return dict.fromkeys(("speed_limit", "road_name", "road_surface", "location", "subtype"), "")
    return {
        "speed_limit": maxspeed,
        "road_name": name,
        "road_surface": surface,
        "location": "nonurban" if highway in LOCATION_RURAL else "urban",
        "subtype": "highway" if highway in ("motorway", "motorway_link")
        else "play_street" if highway == "living_street" else "road",
    }  # fmt: skip


def lane_table(lanes: LaneNetwork, hd_map: HdMap, osm: OsmTown) -> Table:
    """How many lanes the road of every lanelet really has, is drawn with, and has by OSM (-1: no tag)."""
    drawn: dict[int, set[int]] = {}
    for lanelet in hd_map.lanelets:
        if lanelet.strip >= 0 and lanelet.kind in ("lane", "bus"):
            drawn.setdefault(lanes.strips[lanelet.strip].road, set()).add(lanelet.strip)
    rows = []
    for lanelet in hd_map.lanelets:
        if lanelet.strip < 0 or lanelet.kind not in ("lane", "bus"):
            continue
        strip = lanes.strips[lanelet.strip]
        road = lanes.network.roads[strip.road]
        middle = float(strip.road_s[lanelet.first : lanelet.last + 1].mean())
        way = _way_at(osm, strip.road, (middle, middle))
        said = int(osm.tags[way].get("lanes", "-1")) if way else -1
        rows.append((lanelet.id, strip.road, strip.lane, strip.direction, road.forward, road.backward,
                     len(drawn[strip.road]), way, said))  # fmt: skip
    names = ("lanelet_id", "road", "lane", "direction", "lanes_forward", "lanes_backward", "lanes_drawn", "way_id",
             "lanes_osm")  # fmt: skip
    table = np.array(rows, dtype=np.int64).reshape(-1, len(names))
    return {name: np.ascontiguousarray(table[:, k]) for k, name in enumerate(names)}
