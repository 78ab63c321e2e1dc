"""The usual figures of a column of distances."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.model.quality import Measure

STATISTICS = ("mean", "std", "rmse", "median", "p95", "max")


def statistics(values: Floats) -> dict[str, float | None]:
    """Mean, standard deviation of the population, root mean square, median, 95th percentile and maximum.

    All None without values. Values that are not finite count as absent.
    """
    found = values[np.isfinite(values)]
    if len(found) == 0:
        return dict.fromkeys(STATISTICS)
    rmse = np.sqrt(np.mean(found**2))
    figures = (found.mean(), found.std(), rmse, np.median(found), np.percentile(found, 95), found.max())
    return {name: float(figure) for name, figure in zip(STATISTICS, figures, strict=True)}


def measures_of(name: str, values: Floats, unit: str = "m") -> Iterator[Measure]:
    """One measure per statistic: `<name>_mean`, `<name>_std`, ..."""
    for statistic, figure in statistics(values).items():
        yield Measure(f"{name}_{statistic}", figure, unit)
