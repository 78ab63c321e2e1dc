"""An evaluation as Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from flexmap_tasks.model.quality import Measure

COLUMNS = ("precision", "recall", "recall_with_review", "f1", "lanelet_f1")
DIGITS = {"m": 3, "deg": 3, "1": 4, "count": 0}


def markdown(measures: Sequence[Measure], tables: Mapping[str, Any]) -> str:
    """Figures with their limits first, then the tables that are there."""
    parts = ["# Evaluation against the truth", ""]
    judged = [m for m in measures if m.passed is not None]
    failed = sum(m.passed is False for m in judged)
    parts += [f"{len(judged) - failed} of {len(judged)} judged figures pass.", ""]
    parts += table(("figure", "value", "unit", "limit", ""), map(_row, measures))
    if "matching" in tables:
        parts += _matching(tables["matching"], tables.get("run", {}))
        parts += ["## Decisions, metres", ""]
        outcomes = ("right", "wrong", "phantom", "missed")
        rows = ((said, *(f"{row[o]:.1f}" for o in outcomes)) for said, row in tables["review"].items())
        parts += table(("decision", *outcomes), rows)
    if "attributes" in tables:
        parts += _attributes(tables["attributes"])
    if "harm" in tables:
        parts += ["## Harm to the map", ""]
        parts += table(("what", "count"), ((name, str(n)) for name, n in tables["harm"].items()))
    return "\n".join(parts).rstrip() + "\n"


def _matching(methods: Mapping[str, Any], run: Mapping[str, Any]) -> list[str]:
    rows = [
        (
            method,
            kind,
            f"{s['length_m']:.0f}",
            *(_share(s[k]) for k in COLUMNS),
        )
        for method, kinds in methods.items()
        for kind, s in kinds.items()
    ]
    names = ("method", "class", "metres", "precision", "recall", "with review", "F1", "F1 by lanelet")
    out = ["## Matching by metre", "", *table(names, rows)]
    own = {"match_rate": "match rate", "self_scored_precision": "self-scored precision"}
    shown = [(label, _share(run[name]["value"])) for name, label in own.items() if name in run]
    if shown:
        out += ["The paper's own figures, which know no truth:", "", *table(("figure", "value"), shown)]
    return out


def _attributes(scores: Mapping[str, Any]) -> list[str]:
    columns = ("right_m", "missing_m", "wrong_m")
    rows = ((key, *(f"{s[c]:.1f}" for c in columns), _share(s["error"])) for key, s in scores.items())
    names = ("attribute", "right (m)", "missing (m)", "wrong (m)", "error")
    return ["## Attributes by metre", "", *table(names, rows)]


def _row(measure: Measure) -> tuple[str, ...]:
    digits = DIGITS.get(measure.unit, 3)
    verdict = {True: "pass", False: "FAIL", None: ""}[measure.passed]
    unit = "" if measure.unit in ("1", "count") else measure.unit
    return measure.name, _number(measure.value, digits), unit, _number(measure.limit, digits, ""), verdict


def _number(value: float | None, digits: int, absent: str = "-") -> str:
    return absent if value is None else f"{value:.{digits}f}"


def _share(value: float | None) -> str:
    return _number(value, 4)


def table(names: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table, and an empty one."""
    head = [f"| {' | '.join(names)} |", f"|{'---|' * len(names)}"]
    return [*head, *(f"| {' | '.join(row)} |" for row in rows), ""]
