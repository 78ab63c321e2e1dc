"""Conflation: how fast maps are read, lanelets matched and values carried over, and how that grows."""

from __future__ import annotations

import gzip
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from flexmap_tasks.config import CollapseParams, FlexMapConfig, MatchParams, OsmRoadsParams, TransferParams
from flexmap_tasks.engine.execute import Engine
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.formats.osm_xml import read_osm_xml
from flexmap_tasks.formats.osm_xml_write import write_osm_xml
from flexmap_tasks.ingest.osm_roads import ingest_osm_roads
from flexmap_tasks.matching.collapse import collapse
from flexmap_tasks.matching.match import match
from flexmap_tasks.model.maps import LaneletMap, PlacedRoads
from flexmap_tasks.model.source import Source
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.store.store import Store
from flexmap_tasks.transfer.transfer import transfer
from tests.bench.measure import DATA, PROJECT, best_cpu_s, show
from tests.bench.town_copies import copies_of_map, copies_of_roads

PEER_CPU_S = 13.6
"""The original on Garching and another machine (REFERENCE.md), growing with the square of the map: not run here."""
COPIES = (1, 4, 16, 64, 256)


def run() -> None:
    """Read, match, carry over."""
    one_map, one_roads = _garching()
    with tempfile.TemporaryDirectory() as folder:
        _reading(Path(folder), one_map)
    _garching_alone(one_map, one_roads)
    _growth(one_map, one_roads)


def _garching() -> tuple[LaneletMap, PlacedRoads]:
    """The map and the roads as they meet on the route of the paper."""
    graph = map_update(load_config(FlexMapConfig, PROJECT / "configs" / "garching.yaml"))
    with tempfile.TemporaryDirectory() as folder:
        engine = Engine(Store.open(folder))
        artifacts = {name: o.artifact for name, o in run_local(engine.store, graph).items()}
        bound = {name: engine.bind(ref, artifacts) for name, ref in graph.nodes["transfer"].inputs.items()}
        return engine.load(bound["lanelet_map"], LaneletMap), engine.load(bound["roads"], PlacedRoads)


def _reading(folder: Path, one: LaneletMap) -> None:
    """XML into columns beside readers that make objects of it, on the same files."""
    files = {"Lanelet2": folder / "map.osm", "OpenStreetMap": folder / "town.osm"}
    many = replace(copies_of_map(one, 24).document, root={"version": "0.6"})
    files["Lanelet2"].write_bytes(write_osm_xml(many))
    files["OpenStreetMap"].write_bytes(gzip.decompress((DATA / "osm" / "kaiserslautern.osm.gz").read_bytes()))
    for kind, file in files.items():
        size = file.stat().st_size / 1e6
        readers = {"FlexMap": lambda f=file: read_osm_xml(f, f.name)} | _peers(kind)
        if kind == "OpenStreetMap":
            readers["FlexMap, roads only"] = lambda f=file: ingest_osm_roads(
                Source(f.name, f), OsmRoadsParams()
            )
        speed = {name: size / best_cpu_s(lambda r=read, f=file: r(f)) for name, read in readers.items()}
        show(
            f"{kind} XML of {size:.0f} MB into a whole model, CPU",
            [
                (name, f"{s:.0f} MB/s = {s / speed['FlexMap']:.2f}", "at least 60 MB/s" * (name == "FlexMap"))
                for name, s in speed.items()
            ],
        )


def _peers(kind: str) -> dict[str, Callable[..., Any]]:
    import osmium  # noqa: PLC0415 - peers are loaded by those who measure them
    from lxml import etree  # noqa: PLC0415

    def through_osmium(file: Path) -> list[Any]:
        return [(e.id, [(t.k, t.v) for t in e.tags]) for e in osmium.FileProcessor(str(file))]

    peers: dict[str, Callable[..., Any]] = {
        "lxml, tree": etree.parse,
        "pyosmium, elements and tags": through_osmium,
    }
    if kind == "Lanelet2":
        import lanelet2  # noqa: PLC0415

        projector = lanelet2.projection.UtmProjector(lanelet2.io.Origin(48.26, 11.66))
        peers["lanelet2, C++"] = lambda file: lanelet2.io.loadRobust(str(file), projector)
    return peers


def _garching_alone(one_map: LaneletMap, one_roads: PlacedRoads) -> None:
    lines = collapse(one_map, CollapseParams())
    matches = match(lines, one_map, one_roads, MatchParams()).matches
    matching = best_cpu_s(lambda: match(lines, one_map, one_roads, MatchParams()))
    carrying = best_cpu_s(lambda: transfer(one_map, lines, matches, one_roads, TransferParams()))
    lanelets = len(lines.members)
    rows = [
        (
            "match",
            f"{matching:.3f} s CPU = {lanelets / matching:.0f} lanelets/s",
            "at least 5,000 lanelets/s",
        ),
        ("transfer", f"{carrying:.3f} s CPU", ""),
        ("match and transfer", f"{matching + carrying:.3f} s CPU", "at most 0.3 s"),
    ]
    show(f"Garching, {lanelets} lanes", rows)


def _growth(one_map: LaneletMap, one_roads: PlacedRoads) -> None:
    """Copies side by side: collapse, match and transfer, once each (the largest take long)."""
    seconds, rows = [], []
    for count in COPIES:
        many_map, many_roads = copies_of_map(one_map, count), copies_of_roads(one_roads, count)
        before = time.process_time()
        lines = collapse(many_map, CollapseParams())
        between = time.process_time()
        matched = match(lines, many_map, many_roads, MatchParams())
        after = time.process_time()
        transfer(many_map, lines, matched.matches, many_roads, TransferParams())
        seconds.append(time.process_time() - before)
        lanelets, rate = len(lines.members), len(lines.members) / (after - between)
        text = f"{lanelets} lanes: {seconds[-1]:.2f} s CPU, {rate:.0f} lanelets/s in matching"
        rows.append((f"{count} copies", text, f"the peer: {PEER_CPU_S * count**2:.0f} s"))
    exponent = np.polyfit(np.log(COPIES[1:]), np.log(seconds[1:]), 1)[0]
    peak_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    rows.append(("exponent from 4 copies on", f"{exponent:.2f}", "at most 1.1"))
    rows.append(("the largest", f"{seconds[-1]:.1f} s CPU, peak {peak_gb:.2f} GB", "at most 60 s, 4 GB"))
    show("Collapse, match and transfer of copies side by side", rows)
