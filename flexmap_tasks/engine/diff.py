"""What differs between two releases: settings, inputs, code, stages, figures and the map itself."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from flexmap_tasks.engine.explain import source_files
from flexmap_tasks.engine.map_diff import MapDiff, diff_maps
from flexmap_tasks.engine.plan import differences
from flexmap_tasks.engine.released import Released
from flexmap_tasks.formats.osm_xml import parse_osm_xml
from flexmap_tasks.store.store import ActionRecord, Store

MAP = "lanelet2_map.osm"
QUALITY = "quality.json"


@dataclass(frozen=True, slots=True)
class StageChange:
    """A stage that differs.

    what : added, removed, "same result" (another action, the same bytes) or "other result"
    why : one phrase per setting, module or library that differs; empty where only its inputs did
    """

    stage: str
    what: Literal["added", "removed", "same result", "other result"]
    why: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ReleaseDiff:
    """From one release to another.

    sources : (stage.input, old path, new path) where the content differs
    figures : (name, old, new, unit) of quality.json; map : None where a release has no map
    """

    stages: tuple[StageChange, ...]
    sources: tuple[tuple[str, str, str], ...]
    figures: tuple[tuple[str, float | None, float | None, str], ...]
    map: MapDiff | None


def diff_releases(store: Store, old: Released, new: Released) -> ReleaseDiff:
    """The changes from `old` to `new`."""
    stages = (_stage_change(store, old, new, name) for name in _union(old, new, "stages"))
    return ReleaseDiff(
        tuple(change for change in stages if change is not None),
        tuple(_sources(store, old, new)),
        tuple(_figures(old, new)),
        _map(old, new),
    )


def _union(old: Released, new: Released, part: str) -> list[str]:
    return sorted({*old.manifest[part], *new.manifest[part]})


def _stage_change(store: Store, old: Released, new: Released, name: str) -> StageChange | None:
    before, now = old.manifest["stages"].get(name), new.manifest["stages"].get(name)
    if before is None or now is None:
        return StageChange(name, "removed" if now is None else "added", ())
    if before["action"] == now["action"]:
        return None
    first, second = store.peek(before["action"]), store.peek(now["action"])
    same = first.output == second.output if first and second else False
    why = (
        differences(_image(first, before), _image(second, now)) if first and second else _params(before, now)
    )
    phrases = tuple(phrase for phrase in why if not phrase.startswith("input "))
    return StageChange(name, "same result" if same else "other result", phrases)


def _image(record: ActionRecord | None, said: Mapping[str, Any]) -> Mapping[str, Any]:
    return record.preimage if record else said


def _params(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What the manifests alone can tell: the records are gone from the store."""
    return differences({"params": before["params"]}, {"params": now["params"]})


def _sources(store: Store, old: Released, new: Released) -> list[tuple[str, str, str]]:
    before, now = source_files(store, old), source_files(store, new)
    out = []
    for name in sorted(before.keys() | now.keys()):
        a, b = before.get(name), now.get(name)
        if (a or {}).get("sha256") != (b or {}).get("sha256"):
            out.append((name, str(a["path"]) if a else "-", str(b["path"]) if b else "-"))
    return out


def _figures(old: Released, new: Released) -> list[tuple[str, float | None, float | None, str]]:
    if not all(QUALITY in release.manifest["files"] for release in (old, new)):
        return []
    before, now = _measures(old), _measures(new)
    names = [*now, *(name for name in before if name not in now)]
    return [
        (
            name,
            before.get(name, (None, ""))[0],
            now.get(name, (None, ""))[0],
            (now.get(name) or before[name])[1],
        )
        for name in names
        if before.get(name, (None, ""))[0] != now.get(name, (None, ""))[0]
    ]


def _measures(release: Released) -> dict[str, tuple[float | None, str]]:
    measures = json.loads(release.read(QUALITY))["measures"]
    return {measure["name"]: (measure["value"], measure["unit"]) for measure in measures}


def _map(old: Released, new: Released) -> MapDiff | None:
    if not all(MAP in release.manifest["files"] for release in (old, new)):
        return None
    return diff_maps(
        parse_osm_xml(old.read(MAP), f"{MAP} of {old.id}", lossless=False),
        parse_osm_xml(new.read(MAP), f"{MAP} of {new.id}", lossless=False),
    )
