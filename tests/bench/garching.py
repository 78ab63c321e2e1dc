"""Garching, from recording to finished map, beside the original; and copies of it side by side."""

from __future__ import annotations

import tempfile

from flexmap_tasks.config import CollapseParams, FlexMapConfig, MatchParams, TransferParams
from flexmap_tasks.engine.execute import Engine
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.matching.collapse import collapse
from flexmap_tasks.matching.match import match
from flexmap_tasks.model.maps import LaneletMap, PlacedRoads
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.store.store import Store
from flexmap_tasks.transfer.transfer import transfer
from tests.bench.measure import PROJECT, best_cpu_s, show
from tests.bench.town_copies import copies_of_map, copies_of_roads

PEER_CPU_S = 13.0
"""The original on the same data and another machine (REFERENCE.md): not measured in this run."""


def run() -> None:
    """The whole route into an empty store, and copies of map and roads side by side."""

    config = load_config(FlexMapConfig, PROJECT / "configs" / "garching.yaml")

    def whole() -> None:
        with tempfile.TemporaryDirectory() as folder:
            run_local(Store.open(folder), map_update(config))

    cpu = best_cpu_s(whole)
    show(
        "Garching, recording to finished map, empty store",
        [
            ("CPU", f"{cpu:.2f} s", ""),
            ("share of the peer's 13 s", f"{cpu / PEER_CPU_S:.2f}", "at most 0.20"),
        ],
    )

    with tempfile.TemporaryDirectory() as folder:
        engine = Engine(Store.open(folder))
        outcomes = run_local(engine.store, map_update(config))
        graph = map_update(config)
        artifacts = {name: o.artifact for name, o in outcomes.items()}
        bound = {name: engine.bind(ref, artifacts) for name, ref in graph.nodes["transfer"].inputs.items()}
        map_ = engine.load(bound["lanelet_map"], LaneletMap)
        roads = engine.load(bound["roads"], PlacedRoads)

    def conflate(lanelets: LaneletMap, placed: PlacedRoads) -> None:
        lines = collapse(lanelets, CollapseParams())
        matched = match(lines, lanelets, placed, MatchParams())
        transfer(lanelets, lines, matched.matches, placed, TransferParams())

    rows, one = [], 0.0
    for count in (1, 4, 16):
        many_map, many_roads = copies_of_map(map_, count), copies_of_roads(roads, count)
        cpu = best_cpu_s(lambda m=many_map, r=many_roads: conflate(m, r))
        one = one or cpu
        goal = "at most 20" if count == 16 else ""
        rows.append((f"{count} copies", f"{cpu:.2f} s = {cpu / one:.1f} times one", goal))
    show("Collapse, match and transfer of copies side by side", rows)
