"""Inputs that failed and have not changed since: a fleet does not try them again every night."""

from __future__ import annotations

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.finished import Watched
from flexmap_tasks.engine.libraries import library_versions
from flexmap_tasks.errors import FlexMapError, InputError
from flexmap_tasks.store.artifact import canonical_json, digest_of, seal, unseal
from flexmap_tasks.store.store import Store

FORMAT = 1


def remember_failure(store: Store, config: FlexMapConfig, watched: Watched, error: FlexMapError) -> None:
    """Note an input's fault. What a server, a disk or a file still being written may have caused is not noted."""
    fetched = config.osm is not None and config.osm.fetch is not None
    if isinstance(error, InputError) and watched.steady and not fetched:
        body = {"format": FORMAT, "of": _mark(config, watched), "reason": str(error)}
        store.backend.put(_path(config), seal(body), replace=True)


def known_failure(store: Store, config: FlexMapConfig, watched: Watched) -> str | None:
    """The reason why the same files, settings and code failed before; None when it is worth a try."""
    body = unseal(store.backend.get(_path(config)))
    if body is None or body.get("format") != FORMAT or body["of"] != _mark(config, watched):
        return None
    return str(body["reason"])


def _mark(config: FlexMapConfig, watched: Watched) -> str:
    files = {path: list(look) for path, look in watched.files.items()}
    versions = library_versions()
    return digest_of(canonical_json([config.model_dump(mode="json"), files, versions]))


def _path(config: FlexMapConfig) -> str:
    return f"failures/{config.map}.json"
