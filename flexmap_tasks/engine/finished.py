"""A finished run, remembered so that the next one sees within milliseconds that nothing changed.

This is no second description of the DAG. A run that ended with a release leaves a sealed note under the digest of
its settings: which files it watched with their size, times and inode, the versions of the libraries, the actions,
and the release. While all of that still holds, and every record, blob and released file is there, planning could
only say again that all is cached. Any doubt, however small, is a reason to plan.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from flexmap_tasks.config import Params
from flexmap_tasks.engine.graph import Graph, SourceRef
from flexmap_tasks.engine.libraries import library_versions
from flexmap_tasks.engine.release import Release
from flexmap_tasks.engine.sources import Look, is_old, look
from flexmap_tasks.store.artifact import canonical_json, digest_of, seal, unseal
from flexmap_tasks.store.store import Store

FORMAT = 1
FOLDER = "finished"
NO_CODE = (".pyc", ".nbi", ".nbc")
"""What Python and numba keep beside the sources."""

_LOADED_NS = time.time_ns()
_PACKAGE = Path(__file__).resolve().parents[1]


@dataclass(frozen=True, slots=True)
class Watched:
    """The files a run depends on, as they were before any of them was read; `steady` if all are old enough."""

    inputs: Mapping[str, Look]
    code: Mapping[str, Look]
    steady: bool

    @property
    def files(self) -> dict[str, Look]:
        """All of them."""
        return {**self.inputs, **self.code}


@dataclass(frozen=True, slots=True)
class Finished:
    """A run that need not be planned again."""

    release: Release
    stages: int


def watch(graph: Graph) -> Watched:
    """To be asked before a run begins: what it will read, and whether its stamps can be trusted."""
    now = time.time_ns()
    paths = {str(r.path) for node in graph for r in node.inputs.values() if isinstance(r, SourceRef)}
    inputs = {path: look(path) for path in paths}
    code = {str(path): look(path) for path in code_files(_PACKAGE)}
    steady = all(is_old(seen, now) for seen in inputs.values())
    steady = steady and all(is_old(seen, _LOADED_NS) for seen in code.values())
    return Watched(_there(inputs), _there(code), steady)


def remember_finished(
    store: Store, config: Params, graph: Graph, actions: Mapping[str, str], release: Release, watched: Watched
) -> None:  # fmt: skip
    """Leave the note for the next run; without one it plans."""
    if not watched.steady:
        return
    root = release.folder.parent
    body = {
        "format": FORMAT,
        "files": watched.files,
        "code": [str(path) for path in code_files(_PACKAGE)],
        "versions": _versions(),
        "actions": dict(actions),
        "expires": _expires(store, graph, actions),
        "map": config.model_dump(mode="json").get("map"),
        "release": {"id": release.id, "latest": _latest(root)},
        "released": {str(path): look(path) for path in sorted(release.folder.rglob("*")) if path.is_file()},
        "folder": str(release.folder),
    }
    content = seal(body)
    if store.backend.get(_path(config, root.parent)) != content:
        store.backend.put(_path(config, root.parent), content, replace=True)


def still_finished(store: Store, config: Params, releases: Path) -> Finished | None:
    """The run with these settings if it would be the same again; None on any doubt."""
    body = unseal(store.backend.get(_path(config, releases)))
    if body is None or body.get("format") != FORMAT or body["versions"] != _versions():
        return None
    if body["code"] != [str(path) for path in code_files(_PACKAGE)] or _expired(body["expires"]):
        return None
    watched = {**body["files"], **body["released"]}
    if any(look(path) != seen for path, seen in watched.items()):
        return None
    folder = Path(body["folder"])
    release = body["release"]
    if _latest(folder.parent) != release["latest"] or not _has_manifest(folder, release["id"]):
        return None
    if not store.find_all(body["actions"].values()):
        return None
    return Finished(Release(folder, release["id"], fresh=False), len(body["actions"]))


def _path(config: Params, releases: Path) -> str:
    settings = {"settings": config.model_dump(mode="json"), "releases": str(releases.absolute())}
    return f"{FOLDER}/{digest_of(canonical_json(settings))}.json"


def code_files(package: Path) -> list[Path]:
    """Everything in a package that can change what it does."""
    found: list[Path] = []
    for folder, folders, files in os.walk(package):
        folders[:] = sorted(name for name in folders if name != "__pycache__")
        found.extend(Path(folder, name) for name in sorted(files) if not name.endswith(NO_CODE))
    return found


def _there(looks: Mapping[str, Look]) -> dict[str, Look]:
    return {path: seen for path, seen in looks.items() if seen}


def _versions() -> dict[str, str]:
    return {**library_versions(), "python": sys.version}


def _latest(folder: Path) -> str | None:
    latest = folder / "latest"
    return str(latest.readlink()) if latest.is_symlink() else None


def _has_manifest(folder: Path, release_id: str) -> bool:
    try:
        return digest_of((folder / "manifest.json").read_bytes())[: len(release_id)] == release_id
    except OSError:
        return False


def _expires(store: Store, graph: Graph, actions: Mapping[str, str]) -> str | None:
    """When the first result that came from a server becomes too old."""
    times: list[datetime] = []
    for node in graph:
        days = getattr(node.params, "max_age_days", None) if node.stage.outside else None
        record = store.find(actions[node.name]) if days is not None else None
        if record is not None and days is not None:
            times.append(datetime.fromisoformat(record.started) + timedelta(days=days))
    return min(times).isoformat() if times else None


def _expired(expires: str | None) -> bool:
    return expires is not None and datetime.now(UTC) > datetime.fromisoformat(expires)
