"""Releases: folders a person takes away, every file checked on its way out of the store."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexmap_tasks.engine.graph import Graph, Ref
from flexmap_tasks.errors import StoreError
from flexmap_tasks.store.artifact import Artifact, Blob, canonical_json, digest_of
from flexmap_tasks.store.store import Store, parse_record, record_path

FORMAT = 1


@dataclass(frozen=True, slots=True)
class Release:
    """A finished release. `fresh` is False when it was already there, whole."""

    folder: Path
    id: str
    fresh: bool


def publish_release(
    store: Store, graph: Graph, artifacts: Mapping[str, Artifact], actions: Mapping[str, str], root: Path, name: str
) -> Release:  # fmt: skip
    """Write releases/<name>/<id>/ below `root` whole or not at all, and point `latest` to it.

    The id is a digest of the manifest: the same content is the same release.
    """
    manifest = make_manifest(store, graph, artifacts, actions, name)
    content = canonical_json(manifest)
    release_id = digest_of(content)[:16]
    folder = root / name / release_id
    fresh = not is_whole(folder, manifest)
    try:
        if fresh:
            _write(store, manifest, content, folder)
        _point_latest(folder)
    except OSError as error:
        raise StoreError(f"release {folder}: cannot be written ({error.strerror})") from error
    return Release(folder, release_id, fresh)


def make_manifest(
    store: Store, graph: Graph, artifacts: Mapping[str, Artifact], actions: Mapping[str, str], name: str
) -> dict[str, Any]:  # fmt: skip
    """Every file with its digest and the action that made it; no times, no machine."""
    files: dict[str, dict[str, Any]] = {}
    for path, ref in graph.release:
        for file, blob in _released_files(path, ref, ref.select(artifacts[ref.node])):
            files[file] = {
                "sha256": blob.sha256,
                "size": blob.size,
                "stage": ref.node,
                "action": actions[ref.node],
            }
    stages = {}
    for stage, key in actions.items():
        record = parse_record(store.backend.get(record_path(key)))
        image = record.preimage if record else {}
        stages[stage] = {"action": key, "params": image.get("params", {}), "inputs": image.get("inputs", {})}
    return {"format": FORMAT, "map": name, "files": files, "stages": stages}


def is_whole(folder: Path, manifest: Mapping[str, Any]) -> bool:
    """The folder holds this manifest and every file in its right size."""
    try:
        if (folder / "manifest.json").read_bytes() != canonical_json(manifest):
            return False
        return all(
            (folder / file).stat().st_size == entry["size"] for file, entry in manifest["files"].items()
        )
    except OSError:
        return False


def _released_files(path: str, ref: Ref, artifact: Artifact) -> Iterator[tuple[str, Blob]]:
    """A path ending in `/` takes all files of the collection; "." raw files by their own names."""
    for file, blob in artifact.files:
        if path == ".":
            yield file, blob
        elif path.endswith("/"):
            yield path + file.removeprefix(f"{ref.name}/"), blob
        else:
            yield path, blob


def _write(store: Store, manifest: Mapping[str, Any], content: bytes, folder: Path) -> None:
    temporary = folder.parent / f".{folder.name}.{secrets.token_hex(4)}"
    try:
        for file, entry in manifest["files"].items():
            target = temporary / file
            target.parent.mkdir(parents=True, exist_ok=True)
            _write_file(target, store.read_blob(Blob(entry["sha256"], entry["size"])))
        _write_file(temporary / "manifest.json", content)
        if folder.exists():  # a broken one: files were deleted or changed by hand
            folder.rename(folder.parent / f".{folder.name}.broken.{secrets.token_hex(4)}")
        temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _write_file(path: Path, content: bytes) -> None:
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _point_latest(folder: Path) -> None:
    latest = folder.parent / "latest"
    if latest.is_symlink() and latest.readlink() == Path(folder.name):
        return
    temporary = folder.parent / f".latest.{secrets.token_hex(4)}"
    temporary.symlink_to(folder.name)
    temporary.replace(latest)
