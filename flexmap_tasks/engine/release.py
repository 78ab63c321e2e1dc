"""Releases: folders a person takes away, every file checked on its way out of the store."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import secrets
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexmap_tasks.engine.graph import Graph, Ref
from flexmap_tasks.errors import StoreError
from flexmap_tasks.store.artifact import Artifact, Blob, canonical_json, digest_of, seal
from flexmap_tasks.store.backend import FolderBackend
from flexmap_tasks.store.store import Store

FORMAT = 1
RACES = 20
"""How often another process may come in between while a release is put into place."""


@dataclass(frozen=True, slots=True)
class Release:
    """A finished release. `fresh` is False when it was already there, whole."""

    folder: Path
    id: str
    fresh: bool


def make_candidate(
    store: Store, graph: Graph, artifacts: Mapping[str, Artifact], actions: Mapping[str, str], root: Path, name: str
) -> Release:  # fmt: skip
    """Write releases/<name>/<id>/ below `root` whole or not at all; `latest` stays where it is.

    The id is a digest of the manifest: the same content is the same release.
    """
    manifest = make_manifest(store, graph, artifacts, actions, name)
    content = canonical_json(manifest)
    release_id = digest_of(content)[:16]
    folder = root / name / release_id
    fresh = not is_whole(folder, manifest)
    try:
        if fresh:
            write_release(store, manifest, content, folder)
    except OSError as error:
        raise StoreError(f"release {folder}: cannot be written ({error.strerror})") from error
    return Release(folder, release_id, fresh)


def publish_release(
    store: Store, graph: Graph, artifacts: Mapping[str, Artifact], actions: Mapping[str, str], root: Path, name: str
) -> Release:  # fmt: skip
    """A candidate that no gate has to judge: written, and `latest` points to it."""
    release = make_candidate(store, graph, artifacts, actions, root, name)
    move_latest(release)
    return release


def move_latest(release: Release) -> None:
    """Let `latest` beside the release name it, in one step."""
    try:
        point_latest(release.folder)
    except OSError as error:
        raise StoreError(f"release {release.folder}: latest cannot be moved ({error.strerror})") from error


def push_release(store: Store, release: Release) -> None:
    """Beside a store that is no folder, put the release there as well, and let `latest.json` name it."""
    if isinstance(store.backend, FolderBackend):
        return
    name = release.folder.parent.name
    push_files(store, name, release.folder)
    latest = seal({"id": release.id})
    if store.backend.get(f"releases/{name}/latest.json") != latest:
        store.backend.put(f"releases/{name}/latest.json", latest, replace=True)


def push_files(store: Store, name: str, folder: Path) -> None:
    """The files of a release to beside the store, the manifest last: without it there is no release."""
    base = f"releases/{name}/{folder.name}"
    there = {entry.key: entry.size for entry in store.backend.entries(base)}
    if f"{base}/manifest.json" in there:
        return
    for path in sorted(p for p in folder.rglob("*") if p.is_file() and p != folder / "manifest.json"):
        key = f"{base}/{path.relative_to(folder).as_posix()}"
        if there.get(key) != path.stat().st_size:
            store.backend.put(key, path.read_bytes(), replace=True)
    store.backend.put(f"{base}/manifest.json", (folder / "manifest.json").read_bytes(), replace=True)


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
        record = store.peek(key)
        image = record.preimage if record else {}
        stages[stage] = {
            "action": key,
            "params": image.get("params", {}),
            "inputs": image.get("inputs", {}),
            "from": {name: str(ref) for name, ref in graph.nodes[stage].inputs.items()},
        }
    return {"format": FORMAT, "map": name, "files": files, "stages": stages}


def is_whole(folder: Path, manifest: Mapping[str, Any]) -> bool:
    """The folder holds this manifest and every file with the content it says."""
    try:
        if (folder / "manifest.json").read_bytes() != canonical_json(manifest):
            return False
        return not broken_files(folder, manifest)
    except OSError:
        return False


def broken_files(folder: Path, manifest: Mapping[str, Any]) -> list[str]:
    """Files of a release that are missing or hold something else."""
    return [file for file, entry in manifest["files"].items() if _digest(folder / file) != entry["sha256"]]


def restore(store: Store, folder: Path, manifest: Mapping[str, Any]) -> None:
    """Write a release anew from the store. Raises CorruptBlobError where the store does not hold it any more."""
    try:
        write_release(store, manifest, canonical_json(manifest), folder)
    except OSError as error:
        raise StoreError(f"release {folder}: cannot be written ({error.strerror})") from error


def _digest(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        return None


def _released_files(path: str, ref: Ref, artifact: Artifact) -> Iterator[tuple[str, Blob]]:
    """A path ending in `/` takes all files of the collection; "." raw files by their own names."""
    for file, blob in artifact.files:
        if path == ".":
            yield file, blob
        elif path.endswith("/"):
            yield path + file.removeprefix(f"{ref.name}/"), blob
        else:
            yield path, blob


def write_release(store: Store, manifest: Mapping[str, Any], content: bytes, folder: Path) -> None:
    """Write a release folder whole or not at all, every file checked on its way out of the store."""
    temporary = folder.parent / f".{folder.name}.{secrets.token_hex(4)}"
    try:
        for file, entry in manifest["files"].items():
            target = temporary / file
            target.parent.mkdir(parents=True, exist_ok=True)
            _write_file(target, store.read_blob(Blob(entry["sha256"], entry["size"])))
        _write_file(temporary / "manifest.json", content)
        _put_into_place(temporary, folder, manifest)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _put_into_place(temporary: Path, folder: Path, manifest: Mapping[str, Any]) -> None:
    """Another process may publish the same release at the same time: whoever is first is right."""
    for _ in range(RACES):
        if is_whole(folder, manifest):
            return
        with contextlib.suppress(FileNotFoundError):  # a broken one: files were deleted or changed by hand
            folder.rename(folder.parent / f".{folder.name}.broken.{secrets.token_hex(4)}")
        try:
            temporary.rename(folder)
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
        else:
            return
    raise StoreError(f"release {folder}: others keep writing it; run again")


def _write_file(path: Path, content: bytes) -> None:
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def point_latest(folder: Path) -> None:
    """Let `latest` beside the folder name it, in one step."""
    latest = folder.parent / "latest"
    if latest.is_symlink() and latest.readlink() == Path(folder.name):
        return
    temporary = folder.parent / f".latest.{secrets.token_hex(4)}"
    temporary.symlink_to(folder.name)
    temporary.replace(latest)
