"""Releases that are there: found by folder, file, map or id, and read by what their manifests say."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexmap_tasks.errors import InputError
from flexmap_tasks.store.artifact import digest_of
from flexmap_tasks.store.backend import FolderBackend
from flexmap_tasks.store.store import Store

MANIFEST = "manifest.json"
ID_LENGTH = 16


@dataclass(frozen=True, slots=True)
class Released:
    """A release on disk.

    manifest : what it says of itself; intact : the manifest is the one the id was made of
    """

    folder: Path
    manifest: Mapping[str, Any]
    intact: bool

    @property
    def id(self) -> str:
        """The name of its folder."""
        return self.folder.name

    @property
    def map(self) -> str:
        """The map it is of."""
        return str(self.manifest["map"])

    def read(self, file: str) -> bytes:
        """A file of the release, checked. Raises InputError where it is missing or was changed."""
        entry = self.manifest["files"].get(file)
        if entry is None:
            raise InputError(self.id, f"holds no {file}; it has {', '.join(sorted(self.manifest['files']))}")
        try:
            content = (self.folder / file).read_bytes()
        except OSError as error:
            raise InputError(str(self.folder / file), f"cannot be read ({error.strerror})") from error
        if digest_of(content) != entry["sha256"]:
            raise InputError(str(self.folder / file), "was changed since it was released; run flexmap verify")
        return content


def find_release(store: Store, name: str) -> Released:
    """The release that a person means: its folder, a file in it, `map`, `map/id`, or the beginning of an id."""
    path = Path(name)
    for folder in (path, *path.parents) if path.exists() else ():
        if (folder / MANIFEST).is_file():
            return _open(folder.resolve())
    by_map = store.releases / name / ("" if "/" in name else "latest")
    if (by_map / MANIFEST).is_file():
        return _open(by_map.resolve())
    found = [release for release in store.releases.glob(f"*/{name}*") if (release / MANIFEST).is_file()]
    found = [release for release in found if not release.is_symlink()] if name.isalnum() else []
    if len(found) == 1:
        return _open(found[0].resolve())
    rule = "names several releases; give more of the id" if found else "is no release"
    raise InputError(name, f"{rule}; give a folder, map, map/id or id below {store.releases}")


def released_file(release: Released, file: str) -> str:
    """The path inside of the release that `file` names, whether given from outside or from inside of it."""
    if file in release.manifest["files"]:
        return file
    path = Path(file).resolve()
    if path.is_relative_to(release.folder):
        return path.relative_to(release.folder).as_posix()
    raise InputError(file, f"is no file of release {release.id}")


def all_released(store: Store) -> Iterator[Released]:
    """Every release in the folder of releases. Raises InputError for a manifest that cannot be read."""
    for path in sorted(store.releases.glob(f"[!.]*/[!.]*/{MANIFEST}")):
        if not path.parent.is_symlink():
            yield _open(path.parent)


def manifests(store: Store) -> Iterator[Mapping[str, Any]]:
    """Manifests of all releases: those in the folder, and those beside a store that is no folder."""
    for release in all_released(store):
        yield release.manifest
    if not isinstance(store.backend, FolderBackend):
        for entry in store.backend.entries("releases"):
            if entry.key.endswith(f"/{MANIFEST}"):
                yield _parse(store.backend.get(entry.key) or b"", entry.key)


def _open(folder: Path) -> Released:
    try:
        content = (folder / MANIFEST).read_bytes()
    except OSError as error:
        raise InputError(str(folder / MANIFEST), f"cannot be read ({error.strerror})") from error
    return Released(
        folder, _parse(content, str(folder / MANIFEST)), digest_of(content)[:ID_LENGTH] == folder.name
    )


def _parse(content: bytes, name: str) -> Mapping[str, Any]:
    try:
        manifest: dict[str, Any] = json.loads(content)
        if all(isinstance(manifest[part], dict) for part in ("files", "stages")) and manifest["map"]:
            return manifest
    except (ValueError, KeyError, TypeError):
        pass
    raise InputError(name, "is damaged; publish the release again or remove its folder")
