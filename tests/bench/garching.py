"""Garching, from recording to finished map, beside the original."""

from __future__ import annotations

import tempfile

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.store.store import Store
from tests.bench.measure import PROJECT, best_cpu_s, show

PEER_CPU_S = 13.0
"""The original on the same data and another machine (REFERENCE.md): not measured in this run."""


def run() -> None:
    """The whole route into an empty store."""

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
