"""Reruns with other settings beside each other: one trial per combination, sharing all that does not depend."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.gate import judge, published_release, read_quality
from flexmap_tasks.engine.runs import read_runs
from flexmap_tasks.errors import ConfigError, FlexMapError, StoreError
from flexmap_tasks.formats.config_file import change_config, parse_values
from flexmap_tasks.store.store import Store
from flows.comparison import Comparison, compared
from flows.fleet_jobs import overrides

MOST = 1000
"""More combinations than this are taken for a mistake."""

WOULD = {"published": "would publish", "held": "would hold", "rejected": "would reject"}


@dataclass(frozen=True, slots=True)
class Trial:
    """One combination of settings, and the whole configuration that it makes."""

    settings: Mapping[str, Any]
    config: FlexMapConfig


@dataclass(frozen=True, slots=True)
class Tried:
    """What became of a trial begun at a time; `release` is empty where it failed, `fault` says why."""

    trial: Trial
    started: datetime
    release: str
    fault: str = ""


def parse_grid(given: Iterable[str]) -> dict[str, list[Any]]:
    """`key.path=value,value,...` per setting. Raises ConfigError."""
    grid: dict[str, list[Any]] = {}
    for text in given:
        key, equals, values = text.partition("=")
        if not (key and equals):
            raise ConfigError("--grid", f"expected key.path=value,value,..., got {text!r}")
        if key in grid:
            raise ConfigError("--grid", f"{key} stands twice")
        grid[key] = parse_values(values, f"--grid {key}")
    return grid


def trials_of(config: FlexMapConfig, grid: Mapping[str, Sequence[Any]]) -> list[Trial]:
    """Every combination, all of them checked before any of them runs. Raises ConfigError."""
    empty = next((key for key, values in grid.items() if not values), None)
    if empty is not None or not grid:
        raise ConfigError("--grid", f"{empty} has no values" if empty else "names no setting")
    count = math.prod(len(values) for values in grid.values())
    if count > MOST:
        raise ConfigError("--grid", f"makes {count} combinations; {MOST} at most")
    combinations = [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]
    trials = [Trial(settings, change_config(config, overrides(settings))) for settings in combinations]
    if any(trial.config.map != config.map for trial in trials):
        raise ConfigError("--grid", "trials are made for one map; `map` cannot vary")
    return trials


def compare_trials(
    store: Store, config: FlexMapConfig, tried: Sequence[Tried], by: str | None = None
) -> Comparison:
    """Settings, what the gate would say, what ran for each and what did not have to, figures."""
    facts = [_facts(store, config, one) for one in tried]
    usable = [i for i, row in enumerate(facts) if row["gate"] != WOULD["rejected"] and row["release"]]
    return compared(store, config.map, facts, by, usable)


def _facts(store: Store, config: FlexMapConfig, tried: Tried) -> dict[str, Any]:
    ran, cached, seconds, saved = _account(store, config.map, tried.release, tried.started)
    return {
        **tried.trial.settings,
        "release": tried.release,
        "gate": f"failed: {tried.fault}" if tried.fault else _gate(store, tried),
        "stages_run": ran,
        "stages_cached": cached,
        "computed_s": round(seconds, 3),
        "saved_s": round(saved, 3),
    }


def _gate(store: Store, tried: Tried) -> str:
    config = tried.trial.config
    published = published_release(store, config.map)
    before = read_quality(store, config.map, published) if published and published != tried.release else None
    state, _ = judge(read_quality(store, config.map, tried.release) or {}, before, config.gate)
    return "is published" if published == tried.release else WOULD[state]


def _account(store: Store, map_name: str, release: str, since: datetime) -> tuple[int, int, float, float]:
    """Stages that ran since a time and that did not, seconds of both."""
    run = next((run for run in read_runs(store, map_name) if release and run.release == release), None)
    records = [store.peek(key) for key in run.actions.values()] if run else []
    fresh = [r.seconds for r in records if r and datetime.fromisoformat(r.started) >= since]
    old = [r.seconds for r in records if r and datetime.fromisoformat(r.started) < since]
    return len(fresh), len(old), sum(fresh), sum(old)


def try_here(trials: Sequence[Trial], run: Callable[[FlexMapConfig], str]) -> list[Tried]:
    """Run every trial by `run`, which returns the release; one that fails stops no other."""
    tried = []
    for trial in trials:
        started = datetime.now(UTC)
        try:
            tried.append(Tried(trial, started, run(trial.config)))
        except StoreError:
            raise
        except FlexMapError as error:
            tried.append(Tried(trial, started, "", str(error).replace("\n", " ")))
    return tried
