"""The gate: which candidate becomes what `latest` points to.

A run makes a candidate, releases/<map>/<id>/. The gate judges it by its quality.json and by what is published now:
published, held for a person, or rejected. What was decided, by whom and why is a sealed record of its own,
verdicts/<map>/<id>.json, because a release holds nothing but content. A person's word stands until a person
changes it; what is published stays published when limits get tighter.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any, Literal

from flexmap_tasks.config import GateLimit, GateParams
from flexmap_tasks.engine.release import Release, move_latest, push_release
from flexmap_tasks.errors import InputError
from flexmap_tasks.store.artifact import seal, unseal
from flexmap_tasks.store.backend import FolderBackend
from flexmap_tasks.store.store import Store

FORMAT = 1
FOLDER = "verdicts"

State = Literal["published", "held", "rejected", "withdrawn"]
Measures = Mapping[str, Mapping[str, Any]]
"""A quality.json by the names of its figures."""

MISSED: dict[str, State] = {"publish": "published", "hold": "held", "reject": "rejected"}
SEVERITY: tuple[State, ...] = ("published", "held", "rejected")


@dataclass(frozen=True, slots=True)
class Verdict:
    """What was decided about one release.

    reasons : one line each; by : "gate" or "person"; decided : RFC 3339, UTC
    against : the release that was published when this one was judged
    previous : the release that was published before this one, to which a rollback returns
    """

    map: str
    release: str
    state: State
    reasons: tuple[str, ...] = ()
    by: Literal["gate", "person"] = "gate"
    decided: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    against: str | None = None
    previous: str | None = None


def make_latest(store: Store, release: Release) -> None:
    """Let `latest` name the release, here and beside a store that is no folder."""
    move_latest(release)
    push_release(store, release)


def published_release(store: Store, map_name: str) -> str | None:
    """The release that `latest` names; None when nothing is published."""
    if isinstance(store.backend, FolderBackend):
        latest = store.releases / map_name / "latest"
        return latest.readlink().name if latest.is_symlink() else None
    body = unseal(store.backend.get(f"releases/{map_name}/latest.json"))
    return str(body["id"]) if body else None


def pass_gate(store: Store, candidate: Release, map_name: str, params: GateParams) -> Verdict:
    """Judge the candidate, and let `latest` name it when it is published."""
    verdict = decide(store, candidate, map_name, params, published_release(store, map_name))
    if verdict.state == "published":
        make_latest(store, candidate)
    return verdict


def judge(quality: Measures, before: Measures | None, params: GateParams) -> tuple[State, tuple[str, ...]]:
    """The worst that any limit says, and every limit that is missed; `before` is what is published now."""
    state: State = "published"
    reasons: list[str] = []
    for limit in params.limits:
        found = list(_misses(limit, quality, before))
        reasons += found
        if found:
            state = max(state, MISSED[limit.otherwise], key=SEVERITY.index)
    if params.missed_quality != "publish":
        missed = [m for m in quality.values() if m.get("passed") is False]
        reasons += [f"{m['name']} {_show(m)} misses evaluation's limit {m['limit']:g}" for m in missed]
        if missed:
            state = max(state, MISSED[params.missed_quality], key=SEVERITY.index)
    return state, tuple(reasons)


def decide(
    store: Store, candidate: Release, map_name: str, params: GateParams, published: str | None
) -> Verdict:
    """The verdict about a candidate, recorded before it counts; `published` is what `latest` names now."""
    known = read_verdict(store, map_name, candidate.id)
    if known is not None and (known.by == "person" or candidate.id == published):
        if known.state == "published" and candidate.id != published:
            known = replace(known, previous=published)
            write_verdict(store, known)
        return known
    before = read_quality(store, map_name, published) if published and published != candidate.id else None
    quality = read_quality(store, map_name, candidate.id)
    state, reasons = judge(quality or {}, before, params)
    if candidate.id == published:  # from before there was a gate
        state, reasons = "published", ()
    verdict = Verdict(map_name, candidate.id, state, reasons, against=published)
    if state == "published" and candidate.id != published:
        verdict = replace(verdict, previous=published)
    if known is None or replace(known, decided=verdict.decided) != verdict:
        write_verdict(store, verdict)
    return verdict


def read_quality(store: Store, map_name: str, release_id: str) -> Measures | None:
    """The figures of a release by name; None when it has none that can be read."""
    content = read_released(store, map_name, release_id, "quality.json")
    try:
        return {m["name"]: m for m in json.loads(content)["measures"]} if content is not None else None
    except (ValueError, KeyError, TypeError):
        return None


def read_released(store: Store, map_name: str, release_id: str, file: str) -> bytes | None:
    """A file of a release: from the folder of releases, else from beside the store."""
    try:
        return (store.releases / map_name / release_id / file).read_bytes()
    except OSError:
        return store.backend.get(f"releases/{map_name}/{release_id}/{file}")


def read_verdict(store: Store, map_name: str, release_id: str) -> Verdict | None:
    """What was decided about a release; None when nothing was, or the record is damaged."""
    body: dict[str, Any] | None = unseal(store.backend.get(_path(map_name, release_id)))
    if body is None or body.pop("format", None) != FORMAT:
        return None
    body["reasons"] = tuple(body["reasons"])
    return Verdict(**body)


def write_verdict(store: Store, verdict: Verdict) -> None:
    """Record a verdict in place of the last one about the same release."""
    body = {name: getattr(verdict, name) for name in Verdict.__slots__}
    content = seal({**body, "reasons": list(verdict.reasons), "format": FORMAT})
    store.backend.put(_path(verdict.map, verdict.release), content, replace=True)


def read_verdicts(store: Store, map_name: str) -> dict[str, Verdict]:
    """All verdicts about a map by release, the earliest first."""
    names = [
        entry.key.rpartition("/")[2].removesuffix(".json")
        for entry in store.backend.entries(f"{FOLDER}/{map_name}")
    ]
    found = [v for v in (read_verdict(store, map_name, name) for name in names) if v is not None]
    return {v.release: v for v in sorted(found, key=lambda v: (v.decided, v.release))}


def publish_by_hand(store: Store, map_name: str, release_id: str, published: str | None) -> Verdict:
    """A person publishes a release, whatever the gate said. Raises InputError when it is published already."""
    if release_id == published:
        raise InputError(map_name, f"release {release_id} is published already")
    verdict = Verdict(
        map_name,
        release_id,
        "published",
        ("published by a person",),
        "person",
        against=published,
        previous=published,
    )
    write_verdict(store, verdict)
    return verdict


def withdraw(store: Store, map_name: str, published: str, to: str | None) -> Verdict:
    """A person takes the published release back; the verdict about the release that counts from now on.

    to : that release; None for the one published before. Raises InputError when there is none.
    """
    target = to or _earlier(store, map_name, published)
    if target is None:
        raise InputError(
            map_name, f"no release was published before {published}; there is nothing to go back to"
        )
    if target == published:
        raise InputError(map_name, f"release {target} is published already")
    known = read_verdict(store, map_name, published)
    reason = f"withdrawn by a person in favour of {target}"
    write_verdict(
        store,
        Verdict(
            map_name, published, "withdrawn", (reason,), "person", previous=known.previous if known else None
        ),
    )
    back = read_verdict(store, map_name, target)
    verdict = Verdict(
        map_name, target, "published", (f"back in place of {published}",), "person",
        against=published, previous=back.previous if back else None,
    )  # fmt: skip
    write_verdict(store, verdict)
    return verdict


def _earlier(store: Store, map_name: str, release_id: str) -> str | None:
    """The release published before this one, those that were withdrawn since left out."""
    seen = {release_id}
    verdict = read_verdict(store, map_name, release_id)
    while verdict is not None and verdict.previous is not None and verdict.previous not in seen:
        earlier = verdict.previous
        seen.add(earlier)
        verdict = read_verdict(store, map_name, earlier)
        if verdict is None or verdict.state == "published":
            return earlier
    return None


def _misses(limit: GateLimit, quality: Measures, before: Measures | None) -> Iterator[str]:
    name, measure = limit.measure, quality.get(limit.measure, {})
    value = measure.get("value")
    if value is None:
        yield f"{name} was not measured, but has a limit"
        return
    if limit.max is not None and value > limit.max:
        yield f"{name} {_show(measure)} is over {limit.max:g}"
    if limit.min is not None and value < limit.min:
        yield f"{name} {_show(measure)} is under {limit.min:g}"
    was = (before or {}).get(name, {}).get("value")
    if was is None:
        return
    if limit.max_rise is not None and value > was + limit.max_rise:
        yield f"{name} rose from {was:.4g} to {_show(measure)}, by more than {limit.max_rise:g}"
    if limit.max_fall is not None and value < was - limit.max_fall:
        yield f"{name} fell from {was:.4g} to {_show(measure)}, by more than {limit.max_fall:g}"


def _show(measure: Mapping[str, Any]) -> str:
    unit = measure.get("unit", "")
    text = "-" if measure.get("value") is None else f"{measure['value']:.4g}"
    return text if unit in ("1", "count", "") else f"{text} {unit}"


def _path(map_name: str, release_id: str) -> str:
    return f"{FOLDER}/{map_name}/{release_id}.json"
