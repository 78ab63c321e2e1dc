"""Recordings without time: what is laid right, refused or wrong when tracks share a part, and what bad GNSS is found."""

from __future__ import annotations

import time
from collections import Counter

import numpy as np

from flexmap_tasks.alignment.pose_graph import pose_graph
from flexmap_tasks.alignment.solve import MULTIPATH
from flexmap_tasks.config import PoseGraphParams
from flexmap_tasks.errors import AlignmentError
from flexmap_tasks.model.pose_graph import PoseGraph
from tests import ways
from tests.bench.measure import show
from tests.drives import HERE, Bias, Driven, Noise, driven, untimed

NOISES = (Noise(), Noise(place_m=0.02, yaw_rad=2e-3, scale=1.01, white_m=0.05))
WAYS: dict[str, ways.Way | None] = {
    "equal blocks": None,
    "uneven blocks": ways.uneven,
    "streets at any angle": ways.irregular,
    "country roads": ways.winding,
}
LENGTH_M, RIGHT_M, SEEDS = 3000.0, 3.0, 3


def run() -> None:
    """Overlap, then other drives, bad stretches and growth."""
    _overlap()
    _others()
    _stretches()
    _growth()


def _overlap() -> None:
    rows = []
    for name, way in WAYS.items():
        for share in (0.3, 0.5, 0.75):
            tally = Counter(
                _judged(driven(LENGTH_M, seed, NOISES[seed % 2], way=way), share, how)
                for seed in range(SEEDS)
                for how in ("SLAM early", "SLAM late", "SLAM within", "GNSS within")
            )
            rows.append((f"{name}, {share:.0%} of the shorter track", _said(tally), "none wrong"))
    show("Tracks that share a part of the way", rows)


def _judged(drive: Driven, share: float, how: str) -> str:
    slam_m, gnss_m = ways.apart(float(drive.along[-1]), share)[how]
    part = untimed(ways.cut(drive, slam_m, gnss_m))
    graph = _solved(part)
    if graph is None:
        return "refused"
    inside = (part.along >= gnss_m[0]) & (part.along <= gnss_m[1])
    error = _error(part, graph)[inside[graph.nodes.row]]
    return "right" if np.percentile(error, 95) < RIGHT_M else "wrong"


def _others() -> None:
    tally: Counter[str] = Counter()
    for way in WAYS.values():
        for seed in range(SEEDS):
            for lengths in ((1500, 1500), (3000, 1000), (800, 3000), (400, 3000)):
                one, other = (driven(m, seed + 1000 * k, way=way) for k, m in enumerate(lengths))
                graph = _solved(untimed(one._replace(gnss=other.gnss)))
                tally["refused" if graph is None else "wrong"] += 1
    show("GNSS of another drive", [("pairs", _said(tally), "none wrong")])


def _stretches() -> None:
    places = {
        "in the middle": (1000.0, ()),
        "beside an outage": (1000.0, ((850.0, 1000.0),)),
        "at the start": (0.0, ()),
    }
    rows, false = [], 0
    for name, (start, gaps) in places.items():
        for size in (1.0, 2.0):
            tally: Counter[str] = Counter()
            for k, way in enumerate(WAYS.values()):
                for long_m in (50.0, 100.0, 200.0):
                    angle = 2.0 * k + long_m
                    bias = Bias(start, start + long_m, size * np.cos(angle), size * np.sin(angle))
                    tally[_found(driven(2000.0, k, gaps=gaps, biases=(bias,), way=way), bias)] += 1
            rows.append((f"{size:g} m off, {name}", _said(tally), ""))
    for seed in range(SEEDS):
        for way in WAYS.values():
            graph = _solved(untimed(driven(2000.0, 50 + seed, NOISES[seed % 2], way=way)))
            false += graph is not None and bool((graph.gnss_use.reason == MULTIPATH).any())
    rows.append(("false alarms", f"{false} of {SEEDS * len(WAYS)}", "at most 1 in 60"))
    show("Stretches of GNSS that stand off, without time", rows)


def _found(drive: Driven, bias: Bias) -> str:
    graph = _solved(untimed(drive))
    if graph is None:
        return "refused"
    way, off = ways.fix_along_m(drive), graph.gnss_use.reason == MULTIPATH
    bad = (way > bias.start_m) & (way < bias.stop_m) & (graph.gnss_use.used | off)
    return "found" if off[bad].mean() > 0.8 else "in part" if off[bad].any() else "missed"


def _growth() -> None:
    rows, first = [], 0.0
    for length_km in (5, 15, 50, 150):
        drive = untimed(driven(1e3 * length_km, 1))
        before = time.process_time()
        graph = _solved(drive)
        cpu = time.process_time() - before
        first = first or cpu
        error = "refused" if graph is None else f"median error {np.median(_error(drive, graph)):.3f} m"
        rows.append((f"{length_km} km", f"{cpu:.1f} s CPU, {error}", f"about {first * length_km / 5:.0f} s"))
    show("Growth without time", rows)


def _solved(drive: Driven) -> PoseGraph | None:
    try:
        return pose_graph(drive.slam, drive.gnss, HERE, None, None, PoseGraphParams())
    except AlignmentError:
        return None


def _error(drive: Driven, graph: PoseGraph) -> np.ndarray:
    return np.hypot(*(graph.nodes.xyz_m - drive.xyz[graph.nodes.row])[:, :2].T)


def _said(tally: Counter[str]) -> str:
    return ", ".join(f"{tally[word]} {word}" for word in sorted(tally))
