"""Finished runs: what every map was last made of, and what `gc` keeps besides releases."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from flexmap_tasks.engine.graph import Graph, SourceRef
from flexmap_tasks.engine.sources import shown_path, source_artifact
from flexmap_tasks.store.artifact import canonical_json, digest_of, seal, unseal
from flexmap_tasks.store.store import Store

FORMAT = 1
RUNS = "runs"


@dataclass(frozen=True, slots=True)
class Run:
    """A finished run.

    finished : RFC 3339, UTC; actions : action key by stage; release : id of what it made
    sources : files from outside by stage and input, as path, sha256 and size; path : where the store keeps it
    trial : one of several with other settings beside each other, never meant to be published by itself
    """

    map: str
    finished: str
    actions: Mapping[str, str]
    release: str | None
    sources: Mapping[str, Mapping[str, Any]]
    path: str
    trial: bool = False


def read_runs(store: Store, map_name: str | None = None) -> Iterator[Run]:
    """All runs of a map (or of all maps) that can be trusted, per map the newest first."""
    folder = f"{RUNS}/{map_name}" if map_name else RUNS
    paths = [entry.key for entry in store.backend.entries(folder)]
    for path in sorted(paths, key=lambda p: (p.split("/")[1], p), reverse=True):
        run = _parse(store.backend.get(path), path)
        if run is not None:
            yield run


def last_run(store: Store, map_name: str) -> Run | None:
    """The map's last finished run, trials left out."""
    return next((run for run in read_runs(store, map_name) if not run.trial), None)


def read_last_run(store: Store, map_name: str) -> dict[str, str]:
    """Action key per stage of the map's last finished run; empty when there is none."""
    last = last_run(store, map_name)
    return dict(last.actions) if last else {}


def write_last_run(
    store: Store,
    map_name: str,
    actions: Mapping[str, str],
    release: str | None = None,
    sources: Mapping[str, Mapping[str, Any]] | None = None,
    *,
    trial: bool = False,
) -> None:
    """Remember a finished run, unless the last one was the same."""
    told = {"actions": dict(actions), "release": release, "sources": dict(sources or {})}
    last = next(read_runs(store, map_name), None)
    if (
        last is not None
        and last.trial == trial
        and told
        == {
            "actions": last.actions,
            "release": last.release,
            "sources": last.sources,
        }
    ):
        return
    now = datetime.now(UTC)
    body = {"format": FORMAT, "map": map_name, "finished": now.isoformat(), **told}
    body |= {"trial": True} if trial else {}
    label = f"{now:%Y%m%dT%H%M%S.%fZ}-{digest_of(canonical_json(body))[:8]}"
    store.backend.put(f"{RUNS}/{map_name}/{label}.json", seal(body), replace=True)


def sources_of(store: Store, graph: Graph) -> dict[str, dict[str, Any]]:
    """The files a graph reads, by stage and input: what lineage ends at."""
    found: dict[str, dict[str, Any]] = {}
    for node in graph:
        for name, ref in node.inputs.items():
            if isinstance(ref, SourceRef):
                ((_, blob),) = source_artifact(store, ref.path).files
                path = shown_path(ref.path)
                found[f"{node.name}.{name}"] = {"path": path, "sha256": blob.sha256, "size": blob.size}
    return found


def _parse(content: bytes | None, path: str) -> Run | None:
    body = unseal(content)
    if body is None or body.get("format") != FORMAT:
        return None
    trial = bool(body.get("trial", False))
    return Run(body["map"], body["finished"], body["actions"], body["release"], body["sources"], path, trial)
