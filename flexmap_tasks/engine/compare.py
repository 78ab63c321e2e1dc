"""Releases beside each other: settings that differ, figures, and which of them is best."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flexmap_tasks.engine.gate import Measures
from flexmap_tasks.engine.plan import flat
from flexmap_tasks.errors import InputError

LESS_IS_BETTER = (
    "held_out_error_", "deviation_after_", "control_point_residual_", "rigid_rmse", "predicted_sigma_",
    "lanes_differ", "findings_error", "findings_warning", "transfers_review",
)  # fmt: skip
MORE_IS_BETTER = (
    "held_out_within_", "match_rate", "match_score_", "self_scored_precision", "references_matched", "lanes_agree",
    "transfers_set", "revisit_agreement",
)  # fmt: skip
"""Beginnings of names. Every other figure describes; it is neither good nor bad."""

DECISIVE = ("held_out_error_rmse", "deviation_after_valid_rmse", "match_rate_by_length", "match_rate")
"""What the best one is chosen by: the first of these that differs. Errors on withheld GNSS come first, because what
an alignment was fitted to says little about how good it is."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of several releases; `best` numbers those that no other beats, empty where there is no better."""

    name: str
    unit: str
    values: tuple[float | None, ...]
    best: frozenset[int]

    @property
    def differs(self) -> bool:
        """Not all have the same value."""
        return len(set(self.values)) > 1


def compare_figures(qualities: Sequence[Measures | None]) -> list[Figure]:
    """All figures in the order in which the releases name them; None for a release without any."""
    names = dict.fromkeys(name for quality in qualities for name in quality or {})
    return [_figure(name, [(quality or {}).get(name, {}) for quality in qualities]) for name in names]


def _figure(name: str, measures: Sequence[Mapping[str, Any]]) -> Figure:
    unit = next(str(m["unit"]) for m in measures if "unit" in m)
    values = tuple(m.get("value") for m in measures)
    every = frozenset(range(len(values)))
    best = _best(name, values, every) if name.startswith((*LESS_IS_BETTER, *MORE_IS_BETTER)) else every
    return Figure(name, unit, values, best if best < every else frozenset())


def _best(name: str, values: Sequence[float | None], among: frozenset[int]) -> frozenset[int]:
    """Those of some releases that have the best value."""
    known = {i: value for i in among if (value := values[i]) is not None}
    if not known:
        return among
    wanted = min(known.values()) if name.startswith(LESS_IS_BETTER) else max(known.values())
    return frozenset(i for i, value in known.items() if value == wanted)


def best_of(
    figures: Iterable[Figure], among: Iterable[int], by: str | None = None
) -> tuple[frozenset[int], str]:
    """Which releases are best, and by which figures: `by`, else one of DECISIVE after the other until one is left.

    Nobody where no figure tells. Raises InputError for a `by` that is no figure, or only describes.
    """
    known = {figure.name: figure for figure in figures}
    if by is not None and by not in known:
        raise InputError(by, "is no figure of these releases; quality.json has all")
    if by is not None and not by.startswith((*LESS_IS_BETTER, *MORE_IS_BETTER)):
        raise InputError(by, "only describes; neither more nor less of it is better")
    told: list[str] = []
    left = frozenset(among)
    for name in (by,) if by is not None else DECISIVE:
        best = _best(name, known[name].values, left) if name in known else left
        if best < left:
            left, told = best, [*told, name]
    return (left, ", then ".join(told)) if told else (frozenset(), "")


def differing_settings(manifests: Sequence[Mapping[str, Any]]) -> dict[str, tuple[Any, ...]]:
    """Settings by "stage.key" that are not the same in all releases; None where a release has no such stage."""
    settings = [
        flat({stage: entry["params"] for stage, entry in manifest["stages"].items()})
        for manifest in manifests
    ]
    names = sorted({name for found in settings for name in found})
    values = {name: tuple(found.get(name) for found in settings) for name in names}
    return {name: row for name, row in values.items() if any(value != row[0] for value in row)}
