"""What `flexmap release` does."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from rich.table import Table

from flexmap_tasks.engine import gate
from flexmap_tasks.engine.compare import differing_settings
from flexmap_tasks.engine.release import Release
from flexmap_tasks.engine.released import find_release
from flexmap_tasks.engine.runs import read_runs
from flexmap_tasks.errors import InputError
from flexmap_tasks.store.store import Store
from flows import console
from flows.comparison import compared, write_comparison


def list_releases(store: Store, map_name: str) -> None:
    """All releases of a map with what was decided about them."""
    published, verdicts = gate.published_release(store, map_name), gate.read_verdicts(store, map_name)
    trials = _trials(store, map_name)
    table = Table(box=None)
    for column in ("release", "state", "by", "decided", "why"):
        table.add_column(column, overflow="fold")
    for name in _known(store, map_name):
        verdict = verdicts.get(name)
        state = _state(verdict, name == published, name in trials)
        why = "; ".join(verdict.reasons) if verdict else ""
        table.add_row(
            name, state + (" (latest)" if name == published else ""), verdict.by if verdict else "",
            verdict.decided if verdict else _written(store, map_name, name), why.replace("[", r"\["),
        )  # fmt: skip
    console.show(table)


def show(store: Store, map_name: str, release_id: str | None) -> None:
    """One release: the verdict, and its headline figures beside those of what is published."""
    published = gate.published_release(store, map_name)
    name = find(store, map_name, release_id or published or "")
    verdict = gate.read_verdict(store, map_name, name)
    console.say(
        f"{map_name} {name}: {verdict.state if verdict else 'no verdict'}{' (latest)' * (name == published)}"
    )
    for reason in verdict.reasons if verdict else ():
        console.say(f"  {reason}")
    ours = gate.read_quality(store, map_name, name) or {}
    theirs = (gate.read_quality(store, map_name, published) if published else None) or {}
    table = Table(box=None)
    for column in ("figure", "value", "published", "unit"):
        table.add_column(column, justify="left" if column in ("figure", "unit") else "right")
    for measure, row in ours.items():
        if measure in console.HEADLINES or row["limit"] is not None:
            table.add_row(measure, _value(row), _value(theirs.get(measure)), row["unit"])
    console.show(table)
    console.say(str(store.releases / map_name / name))


def compare(
    store: Store, map_name: str, wanted: Sequence[str], table: Path | None, best_by: str | None
) -> None:
    """Releases beside each other."""
    names = [find(store, map_name, name) for name in wanted] or _known(store, map_name)
    if len(names) < 2:
        raise InputError(map_name, f"has {len(names)} releases to compare; two are needed")
    found = [find_release(store, f"{map_name}/{name}").manifest for name in names]
    settings = differing_settings(found)
    published = gate.published_release(store, map_name)
    facts, trials = [], _trials(store, map_name)
    for i, name in enumerate(names):
        verdict = gate.read_verdict(store, map_name, name)
        state = "latest" if name == published else _state(verdict, latest=False, trial=name in trials)
        facts.append({"release": name, "state": state, **{key: row[i] for key, row in settings.items()}})
    comparison = compared(store, map_name, facts, best_by)
    console.show_comparison(comparison)
    if table is not None:
        write_comparison(comparison, table)


def publish(store: Store, map_name: str, release_id: str) -> None:
    """Let `latest` name a release, whatever the gate said."""
    name = find(store, map_name, release_id)
    gate.publish_by_hand(store, map_name, name, gate.published_release(store, map_name))
    gate.make_latest(store, _release(store, map_name, name))
    console.say(f"{map_name}: release {name} is published")


def rollback(store: Store, map_name: str, release_id: str | None) -> None:
    """Go back to the release published before, or to a given one."""
    published = gate.published_release(store, map_name)
    if published is None:
        raise InputError(map_name, "nothing is published; there is nothing to go back from")
    target = find(store, map_name, release_id) if release_id else None
    verdict = gate.withdraw(store, map_name, published, target)
    gate.make_latest(store, _release(store, map_name, verdict.release))
    console.say(f"{map_name}: release {verdict.release} is published again, {published} is withdrawn")


def find(store: Store, map_name: str, prefix: str) -> str:
    """The release whose id begins with `prefix`. Raises InputError when there is none, or more than one."""
    found = [name for name in _known(store, map_name) if name.startswith(prefix)] if prefix else []
    if len(found) != 1:
        raise InputError(
            map_name,
            f"{len(found)} releases begin with {prefix!r}; `flexmap release list {map_name}` shows all",
        )
    return found[0]


def _known(store: Store, map_name: str) -> list[str]:
    """Ids of the releases that are there, the latest decided last."""
    root = store.releases / map_name
    there = (
        [p.name for p in root.iterdir() if (p / "manifest.json").is_file() and p.name != "latest"]
        if root.is_dir()
        else []
    )
    decided = gate.read_verdicts(store, map_name)
    return sorted(there, key=lambda n: (decided[n].decided if n in decided else "", n))


def _trials(store: Store, map_name: str) -> set[str | None]:
    return {run.release for run in read_runs(store, map_name) if run.trial}


def _state(verdict: gate.Verdict | None, latest: bool, trial: bool) -> str:
    if verdict is not None:
        return verdict.state
    return "published" if latest else "trial" if trial else ""


def _release(store: Store, map_name: str, release_id: str) -> Release:
    return Release(store.releases / map_name / release_id, release_id, fresh=False)


def _written(store: Store, map_name: str, release_id: str) -> str:
    stat = Path(store.releases, map_name, release_id, "manifest.json").stat()
    return datetime.fromtimestamp(stat.st_mtime, UTC).isoformat(timespec="seconds")


def _value(measure: object) -> str:
    value = measure.get("value") if isinstance(measure, dict) else None
    return "-" if value is None else f"{value:.4g}"
