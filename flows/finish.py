"""What every run does at its end, however it was run."""

from __future__ import annotations

from collections.abc import Mapping

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.execute import Outcome
from flexmap_tasks.engine.finished import Watched, remember_finished
from flexmap_tasks.engine.gate import pass_gate
from flexmap_tasks.engine.graph import Graph
from flexmap_tasks.engine.release import Release, make_candidate
from flexmap_tasks.engine.runs import sources_of, write_last_run
from flexmap_tasks.store.store import Store
from flows.metrics import write_metrics


def finish_run(
    store: Store,
    graph: Graph,
    outcomes: Mapping[str, Outcome],
    config: FlexMapConfig,
    watched: Watched,
    *,
    trial: bool = False,
) -> Release:
    """Make the release, let the gate decide whether it is published, and remember the run.

    The next plan can then say what changed, the next run that nothing did. A trial is only made: nobody decides
    about it, and `latest` stays where it is.
    """
    artifacts = {name: o.artifact for name, o in outcomes.items()}
    actions = {name: o.key for name, o in outcomes.items()}
    release = make_candidate(store, graph, artifacts, actions, store.releases, config.map)
    if trial:
        write_last_run(store, config.map, actions, release.id, sources_of(store, graph), trial=True)
        return release
    verdict = pass_gate(store, release, config.map, config.gate)
    write_last_run(store, config.map, actions, release.id, sources_of(store, graph))
    remember_finished(store, config, graph, actions, release, watched)
    write_metrics(store, verdict, outcomes)
    return release
