"""Curves over the noise."""

from __future__ import annotations

import json

import pytest

from flexmap_tasks.errors import InputError
from flexmap_tasks.evaluation.sweep import SweepRun, curve, sweep_report, sweep_run


def evaluation(f1: float | None, rmse: float) -> bytes:
    return json.dumps({
        "measures": [{"name": "map_planar_rmse", "value": rmse}, {"name": "trajectory_planar_rmse", "value": None}],
        "matching": {"release": {"all": {"f1": f1}}, "nearest_way": {"all": {"f1": 0.5}}},
    }).encode()  # fmt: skip


RUNS = [sweep_run(n, s, evaluation(1 - n / 10 - s / 100, n)) for n in (0.0, 2.0, 8.0) for s in (1, 2)]


def test_mean_and_range_over_the_seeds() -> None:
    points = curve(RUNS, "release f1")
    assert [p.noise_m for p in points] == [0, 2, 8]
    assert [p.mean for p in points] == pytest.approx([0.985, 0.785, 0.185])
    assert (points[1].least, points[1].most) == pytest.approx((0.78, 0.79))
    assert curve(RUNS, "trajectory_planar_rmse") == []


def test_report_does_not_depend_on_the_order_of_runs() -> None:
    report = sweep_report(RUNS)
    assert report == sweep_report(RUNS[::-1])
    assert len(json.loads(report["sweep.json"])["runs"]) == 6
    assert b"| release | 0.985 (0.980 to 0.990) |" in report["sweep.md"]
    assert b"nearest way" in report["sweep.svg"]
    assert b"buffer" not in report["sweep.md"]


def test_no_runs_and_no_evaluations() -> None:
    assert b"0 runs" in sweep_report([])["sweep.md"]
    assert b"0.500" in sweep_report([SweepRun(1.0, 1, {"release f1": 0.5})])["sweep.md"]
    for nonsense in (b"", b"[]", b"{}", b'{"measures": 3}'):
        with pytest.raises(InputError, match="evaluation of FlexMap"):
            sweep_run(0.0, 1, nonsense)
