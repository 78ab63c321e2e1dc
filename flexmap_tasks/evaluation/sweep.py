"""One figure over growing noise: evaluations of one world at several noise levels and seeds, side by side."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

from flexmap_tasks.errors import InputError
from flexmap_tasks.evaluation import plots
from flexmap_tasks.evaluation.markdown import table

CURVES = {
    "F1 of matching, by metre": ("release", "nearest_way", "buffer_growing"),
    "error in the plane, RMSE (m)": ("map", "trajectory"),
}
FORMAT = 1


@dataclass(frozen=True, slots=True)
class SweepRun:
    """Figures of one evaluation: noise_m, seed, and values by name."""

    noise_m: float
    seed: int
    values: dict[str, float | None]


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """One figure at one noise level: mean, least and greatest over the seeds."""

    noise_m: float
    mean: float
    least: float
    most: float


def sweep_run(noise_m: float, seed: int, evaluation_json: bytes) -> SweepRun:
    """The figures that a sweep compares, from `evaluation.json`; InputError when that is none."""
    try:
        document: dict[str, Any] = json.loads(evaluation_json)
        measures = {m["name"]: m["value"] for m in document["measures"]}
        matching = {f"{m} f1": k["all"]["f1"] for m, k in document.get("matching", {}).items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError("evaluation.json", f"expected an evaluation of FlexMap ({error})") from None
    return SweepRun(noise_m, seed, measures | matching)


def sweep_report(runs: Iterable[SweepRun]) -> dict[str, bytes]:
    """`sweep.json`, `sweep.md` and `sweep.svg` of all runs, whatever their order."""
    ordered = sorted(runs, key=lambda run: (run.noise_m, run.seed))
    shown = {title: {name: curve(ordered, _key(name)) for name in names} for title, names in CURVES.items()}
    panels = {
        title: {name: points for name, points in curves.items() if points} for title, curves in shown.items()
    }
    document = {
        "format": FORMAT,
        "runs": [{"noise_m": r.noise_m, "seed": r.seed, "values": r.values} for r in ordered],
    }
    return {
        "sweep.json": (json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n").encode(),
        "sweep.md": _markdown(ordered, panels).encode(),
        "sweep.svg": plots.curves(
            {
                title: {
                    name: [(p.noise_m, p.mean, p.least, p.most) for p in points]
                    for name, points in curves.items()
                }
                for title, curves in panels.items()
            },
            "noise of OpenStreetMap (m)",
        ),
    }


def curve(runs: Sequence[SweepRun], name: str) -> list[CurvePoint]:
    """The figure over the noise, where it was measured."""
    levels: dict[float, list[float]] = {}
    for run in runs:
        value = run.values.get(name)
        if value is not None:
            levels.setdefault(run.noise_m, []).append(value)
    return [CurvePoint(n, fmean(v), min(v), max(v)) for n, v in sorted(levels.items())]


def _key(name: str) -> str:
    return f"{name}_planar_rmse" if name in ("map", "trajectory") else f"{name} f1"


def _markdown(runs: Sequence[SweepRun], panels: dict[str, dict[str, list[CurvePoint]]]) -> str:
    parts = ["# Sweep", "", f"{len(runs)} runs; mean (least to greatest) over the seeds.", ""]
    noises = sorted({run.noise_m for run in runs})
    for title, curves in panels.items():
        rows = [
            (name, *(_cell(next((p for p in points if p.noise_m == noise), None)) for noise in noises))
            for name, points in curves.items()
        ]
        parts += [f"## {title}", "", *table(("", *(f"{noise:g} m" for noise in noises)), rows)]
    return "\n".join(parts).rstrip() + "\n"


def _cell(point: CurvePoint | None) -> str:
    return "-" if point is None else f"{point.mean:.3f} ({point.least:.3f} to {point.most:.3f})"
