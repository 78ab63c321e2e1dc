"""Stretches of the drive that are predicted worse than the limit are named."""

from __future__ import annotations

import numpy as np
import pytest

from flexmap_tasks.config import EvaluationParams
from flexmap_tasks.evaluation.sigma_findings import sigma_findings
from flexmap_tasks.model.pose_graph import GraphNodes


def nodes(sigma_m: np.ndarray) -> GraphNodes:
    """A node every 5 m, one SLAM pose in ten."""
    n = len(sigma_m)
    xyz, zero = np.column_stack([5.0 * np.arange(n), np.zeros((n, 2))]), np.zeros(n)
    sigma = np.column_stack([sigma_m, sigma_m, zero])
    return GraphNodes(10 * np.arange(n), xyz, zero, xyz, zero, sigma, zero, zero, xyz[:, :2], zero)


@pytest.mark.parametrize(
    ("over", "told"),
    [
        ([], []),
        ([0], ["0 m to 0 m along the drive (poses 0 to 0)"]),
        ([10, 11, 12, 14], ["50 m to 70 m along the drive (poses 100 to 140)"]),
        ([10, 11, 30, 31], ["50 m to 55 m", "150 m to 155 m"]),
        ([48, 49], ["240 m to 245 m along the drive (poses 480 to 490)"]),
    ],
)
def test_every_stretch_over_the_limit_is_named(over: list[int], told: list[str]) -> None:
    sigma = np.full(50, 0.05)
    sigma[over] = 0.25
    found = sigma_findings(nodes(sigma), EvaluationParams(sigma_max_m=0.2))
    assert [m.startswith(t) for m, t in zip(found.message.tolist(), told, strict=True)] == [True] * len(told)
    assert all("up to 0.250 m per axis, limit 0.2 m" in m for m in found.message.tolist())
    assert set(found.severity.tolist()) <= {"warning"}
    assert found.id.tolist() == [int(m.split("poses ")[1].split()[0]) for m in found.message.tolist()]


def test_without_a_limit_nothing_is_found() -> None:
    assert len(sigma_findings(nodes(np.full(5, 9.0)), EvaluationParams())) == 0
