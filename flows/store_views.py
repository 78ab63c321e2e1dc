"""Releases, their lineage and their differences, as a person reads them in the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from flexmap_tasks.engine.diff import ReleaseDiff
from flexmap_tasks.engine.explain import StageFacts
from flexmap_tasks.engine.lineage import FileOrigin, ValueOrigin
from flexmap_tasks.engine.map_diff import MapDiff
from flexmap_tasks.engine.released import Released
from flows.console import say

SHORT = 12
MANY = 40
"""Longer lists end with how many there are more."""


def show_release(release: Released, stages: Sequence[StageFacts]) -> None:
    """One line per stage."""
    say(
        f"release {release.id} of {release.map}: {len(release.manifest['files'])} files, {len(stages)} stages"
    )
    if not release.intact:
        say("its manifest was changed since it was released")
    for facts in stages:
        origin = ", ".join(dict.fromkeys(fact.origin for fact in facts.inputs)) or "nothing"
        say(f"{facts.name:<22}{facts.action[:SHORT]}  {_computed(facts)}  from {origin}")


def show_stage(facts: StageFacts) -> None:
    """Everything about a stage."""
    say(f"{facts.name}  action {facts.action}")
    say(f"  {_computed(facts)}")
    for fact in facts.inputs:
        say(f"  input {fact.name}: {fact.origin}  {fact.digest[:SHORT]}")
    for name, value in _flat(facts.params).items():
        say(f"  {name}: {value}")
    for file in facts.files:
        say(f"  released {file}")
    if facts.record is None:
        say("  its record is no longer in the store: code and libraries are not known")
        return
    for path, blob in facts.record.output.files:
        say(f"  wrote {path}  {blob.size} bytes  {blob.sha256[:SHORT]}")
    for part in ("code", "libraries"):
        for name, value in facts.record.preimage[part].items():
            say(f"  {part} {name}  {value[:SHORT]}")


def show_file(release: Released, origin: FileOrigin) -> None:
    """A released file, the stages behind it and the files behind these."""
    say(f"{origin.file} of release {release.id} of {release.map}, sha256 {origin.sha256}")
    for stage in origin.stages:
        said = release.manifest["stages"][stage]
        inputs = ", ".join(f"{name} from {source}" for name, source in sorted(said["from"].items()))
        say(f"  {stage:<22}{said['action'][:SHORT]}  {inputs}")
    _show_sources(origin)


def show_values(
    release: Released,
    lanelet: int,
    values: Sequence[ValueOrigin],
    origin: FileOrigin,
    settings: Mapping[str, Mapping[str, Any]],
) -> None:
    """Every value that OSM offered a lanelet, with the way, the match, the settings and the files behind it."""
    say(f"lanelet {lanelet} of release {release.id} of {release.map}")
    if not values:
        say("  nothing of this came from OpenStreetMap: it stands as in the map that was given")
    for value in values:
        row = value.transfer
        cut = (
            f" (cut from {row['source_lanelet_id']})" if row["source_lanelet_id"] != row["lanelet_id"] else ""
        )
        say(f"  {row['lanelet_id']}{cut} {row['key']}: {row['old']!r} -> {row['new']!r}  {row['action']}")
        say(f"    confidence {row['confidence']:.3f}  {row['reason']}")
        say(f"    way {row['way_id']} version {row['way_version']} of {row['way_timestamp']}")
        for match in value.matches:
            say(
                f"    match {match['s_from_m']:.1f}-{match['s_to_m']:.1f} m  {match['decision']}  "
                f"score {match['score']:.3f}  confidence {match['confidence']:.3f}  {match['reason']}"
            )
    for stage, params in settings.items():
        say(f"  settings of {stage}: flexmap explain {release.id} {stage} ({len(_flat(params))} values)")
    _show_sources(origin)


def show_diff(old: Released, new: Released, diff: ReleaseDiff) -> None:
    """What differs, the cause before its effects."""
    say(f"from {old.map}/{old.id} to {new.map}/{new.id}")
    for name, before, now in diff.sources:
        say(f"  file of {name}: {before} -> {now}")
    for change in diff.stages:
        why = f": {'; '.join(change.why)}" if change.why else ""
        say(f"  stage {change.stage}: {change.what}{why}")
    for name, was, value, unit in diff.figures:
        say(f"  {name}: {_number(was)} -> {_number(value)} {unit}")
    if diff.map is not None:
        _show_map(diff.map)
    if not (diff.sources or diff.stages):
        say("  no difference")


def _show_map(diff: MapDiff) -> None:
    say(
        f"  lanelets: {len(diff.added)} added{_some(diff.added)}, {len(diff.removed)} removed{_some(diff.removed)}"
    )
    say(
        f"  points of lines: {diff.nodes_added} added, {diff.nodes_removed} removed, {diff.moved} moved, "
        f"{diff.moved_mean_m:.3f} m in the mean, {diff.moved_max_m:.3f} m at most"
    )
    say(f"  attributes of lanelets: {len(diff.tags)} changed")
    for change in diff.tags[:MANY]:
        say(f"    {change.lanelet_id} {change.key}: {_text(change.old)} -> {_text(change.new)}")
    if len(diff.tags) > MANY:
        say(f"    and {len(diff.tags) - MANY} more")


def _show_sources(origin: FileOrigin) -> None:
    for name, source in sorted(origin.sources.items()):
        say(f"  file of {name}: {source['path']}  {source['size']} bytes  sha256 {source['sha256'][:SHORT]}")
    if not origin.sources:
        say("  the run that named the files from outside is no longer in the store")


def _computed(facts: StageFacts) -> str:
    record = facts.record
    if record is None:
        return "record gone"
    items = f", {len(record.items)} items" if record.items else ""
    return f"{record.seconds:.2f} s on {record.host} at {record.started[:19]}Z{items}"


def _some(ids: Iterable[int]) -> str:
    listed = list(ids)
    more = ", ..." if len(listed) > MANY // 4 else ""
    return f" ({', '.join(map(str, listed[: MANY // 4]))}{more})" if listed else ""


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _text(value: str | None) -> str:
    return "unset" if value is None else repr(value)


def _flat(value: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, item in value.items():
        out |= _flat(item, f"{prefix}{name}.") if isinstance(item, Mapping) else {f"{prefix}{name}": item}
    return out
