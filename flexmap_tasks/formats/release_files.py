"""A release folder's values, as they were released."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.artifacts import Files, decode
from flexmap_tasks.model.conflation import LaneCheck, Matches, Transfers
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.quality import Quality
from flexmap_tasks.model.tracks import Trajectory

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Released:
    """What a release holds beside its maps; None where the run had no such step."""

    aligned: Trajectory
    projection: Projection
    matches: Matches | None
    transfers: Transfers | None
    lane_check: LaneCheck | None
    quality: Quality | None


def read_released(folder: Path) -> Released:
    """Raises InputError for a folder that is no release, and for files of another version of the program."""
    return Released(
        _needed(folder, "slam_track_after", Trajectory),
        _needed(folder, "projection", Projection),
        _value(folder, "matches", Matches),
        _value(folder, "transfer", Transfers),
        _value(folder, "lane_check", LaneCheck),
        _value(folder, "quality", Quality),
    )


@dataclass(frozen=True, slots=True)
class _Folder:
    """Files of a folder whose path begins with `prefix`."""

    root: Path
    prefix: str = ""

    def names(self) -> list[str]:
        paths = (p.relative_to(self.root).as_posix() for p in self.root.rglob("*") if p.is_file())
        return sorted(p.removeprefix(self.prefix) for p in paths if p.startswith(self.prefix))

    def read(self, name: str) -> bytes:
        return self.local(name).read_bytes()

    def local(self, name: str) -> Path:
        return self.root / f"{self.prefix}{name}"

    def sub(self, prefix: str) -> Files:
        return _Folder(self.root, f"{self.prefix}{prefix}")


def _value(folder: Path, name: str, kind: type[T]) -> T | None:
    if not any((folder / f"{name}{end}").exists() for end in ("", ".parquet", ".json")):
        return None
    try:
        value: Any = decode(kind, _Folder(folder), name)
    except (OSError, ValueError, KeyError, TypeError) as error:
        rule = f"expected what this version of FlexMap releases ({error}); run the update again"
        raise InputError(str(folder / name), rule) from None
    return value if isinstance(value, kind) else None


def _needed(folder: Path, name: str, kind: type[T]) -> T:
    value = _value(folder, name, kind)
    if value is None:
        raise InputError(str(folder), f"expected a release folder, found no {name} in it")
    return value
