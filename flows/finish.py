"""What every run does at its end, however it was run."""

from __future__ import annotations

from collections.abc import Mapping

from flexmap_tasks.engine.execute import Outcome
from flexmap_tasks.engine.graph import Graph
from flexmap_tasks.engine.plan import write_last_run
from flexmap_tasks.engine.release import Release, publish_release
from flexmap_tasks.store.store import Store


def finish_run(store: Store, graph: Graph, outcomes: Mapping[str, Outcome], map_name: str) -> Release:
    """Publish the release and remember the run, so that the next plan can say what changed."""
    artifacts = {name: o.artifact for name, o in outcomes.items()}
    actions = {name: o.key for name, o in outcomes.items()}
    release = publish_release(store, graph, artifacts, actions, store.backend.local("releases"), map_name)
    write_last_run(store, map_name, actions)
    return release
