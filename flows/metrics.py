"""Figures of a map's last run as OpenMetrics text, for Prometheus and its kin: <store>/metrics/<map>.prom."""

from __future__ import annotations

import time
from collections.abc import Mapping

from flexmap_tasks.engine.execute import Outcome
from flexmap_tasks.engine.gate import SEVERITY, Verdict, read_quality
from flexmap_tasks.store.store import Store


def write_metrics(store: Store, verdict: Verdict, outcomes: Mapping[str, Outcome]) -> None:
    """Write the figures whole or not at all."""
    text = metrics_text(verdict, outcomes, _quality(store, verdict), time.time())
    store.backend.put(f"metrics/{verdict.map}.prom", text, replace=True)


def metrics_text(
    verdict: Verdict, outcomes: Mapping[str, Outcome], quality: Mapping[str, float], now_s: float
) -> bytes:
    """OpenMetrics 1.0: durations and bytes by stage, hits, the gate's verdict, quality by measure."""
    from prometheus_client import CollectorRegistry, Gauge  # noqa: PLC0415 - a run with nothing to do goes without
    from prometheus_client.openmetrics.exposition import generate_latest  # noqa: PLC0415

    registry = CollectorRegistry()

    def gauge(name: str, what: str, label: str, values: Mapping[str, float]) -> None:
        metric = Gauge(f"flexmap_{name}", what, ("map", label), registry=registry)
        for key, value in values.items():
            metric.labels(verdict.map, key).set(value)

    computed = {n: 0.0 if o.cached else o.seconds for n, o in outcomes.items()}
    saved = {n: o.seconds if o.cached else 0.0 for n, o in outcomes.items()}
    sizes = {n: float(sum(b.size for _, b in o.artifact.files)) for n, o in outcomes.items()}
    gauge("stage_compute_seconds", "Time the stage took in this run.", "stage", computed)
    gauge("stage_saved_seconds", "Time the stage did not take because its result was there.", "stage", saved)
    gauge("stage_cached", "1 when nothing ran.", "stage", {n: float(o.cached) for n, o in outcomes.items()})
    gauge("stage_output_bytes", "Size of the stage's result.", "stage", sizes)
    gauge(
        "release", "1 for what the gate decided.", "state", {s: float(s == verdict.state) for s in SEVERITY}
    )
    gauge("quality", "Figures of quality.json in their own units.", "measure", quality)
    finished = Gauge(
        "flexmap_run_finished_timestamp_seconds", "When the run ended.", ("map",), registry=registry
    )
    finished.labels(verdict.map).set(now_s)
    text: bytes = generate_latest(registry)  # type: ignore[no-untyped-call]
    return text


def _quality(store: Store, verdict: Verdict) -> dict[str, float]:
    measures = read_quality(store, verdict.map, verdict.release) or {}
    return {name: float(m["value"]) for name, m in measures.items() if m.get("value") is not None}
