"""The truth of a simulated world."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.truth_tables import read_columns
from flexmap_tasks.model.arrays import Bools, Floats
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.truth import TrueLanes, TrueMatches, TrueNodes, TruePoses, TrueTags, Truth

PIECE = {"lanelet_id": "int", "s_from_m": "float", "s_to_m": "float", "lanelet_length_m": "float"}


@stage("truth")
def ingest_truth(poses: Source, map_nodes: Source, matches: Source, tags: Source, lanes: Source) -> Truth:
    """The tables of the folder `truth/` that a simulation writes.

    Raises InputError for a file that is no such table, and for pieces that lie beyond their lanelet.
    """
    return Truth(_poses(poses), _nodes(map_nodes), _matches(matches), _tags(tags), _lanes(lanes))


def _poses(source: Source) -> TruePoses:
    numbers = ("lon_deg", "lat_deg", "ele_m", "true_yaw_rad", "true_pitch_rad")
    flags = ("outage", "multipath", "standstill")
    c = read_columns(
        source, {"stamp_ns": "int"} | dict.fromkeys(numbers, "float") | dict.fromkeys(flags, "bool")
    )
    lonlat = np.column_stack([c["lon_deg"], c["lat_deg"]])
    return TruePoses(
        c["stamp_ns"],
        lonlat,
        c["ele_m"],
        c["true_yaw_rad"],
        c["true_pitch_rad"],
        *(c[name] for name in flags),
    )


def _nodes(source: Source) -> TrueNodes:
    c = read_columns(source, {"node_id": "int", "lon_deg": "float", "lat_deg": "float", "ele_m": "float"})
    return TrueNodes(c["node_id"], np.column_stack([c["lon_deg"], c["lat_deg"]]), c["ele_m"])


def _matches(source: Source) -> TrueMatches:
    more = {"way_id": "int", "also_way_id": "int", "direction": "int", "class": "text", "reason": "text"}
    c = read_columns(source, PIECE | more)
    _check_pieces(source, c["s_from_m"], c["s_to_m"], c["lanelet_length_m"])
    return TrueMatches(
        c["lanelet_id"], c["s_from_m"], c["s_to_m"], c["lanelet_length_m"], c["way_id"], c["also_way_id"],
        c["direction"], c["class"], c["reason"],
    )  # fmt: skip


def _tags(source: Source) -> TrueTags:
    c = read_columns(source, PIECE | dict.fromkeys(("key", "value", "osm_value"), "text"))
    _check_pieces(source, c["s_from_m"], c["s_to_m"], c["lanelet_length_m"])
    return TrueTags(*(c[name] for name in (*PIECE, "key", "value", "osm_value")))


def _lanes(source: Source) -> TrueLanes:
    names = ("lanelet_id", "way_id", "lanes_drawn", "lanes_osm")
    c = read_columns(source, dict.fromkeys(names, "int"))
    return TrueLanes(*(c[name] for name in names))


def _check_pieces(source: Source, start: Floats, stop: Floats, length: Floats) -> None:
    bad: Bools = ~((start >= -1e-6) & (start <= stop) & (stop <= length + 1e-6) & (length > 0))
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        rule = f"a piece must lie on its lanelet, found {start[row]:g} to {stop[row]:g} of {length[row]:g} m"
        raise InputError(source.name, rule, f"row {row}")
