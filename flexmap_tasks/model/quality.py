"""Quality as figures with units and limits."""

from __future__ import annotations

from dataclasses import dataclass

@dataclass(frozen=True, slots=True)
class Measure:
    """One figure.

    name : what was measured; value, unit : the figure
    limit : what it is judged by, None where it is only reported; passed : None where there is no limit
    """

    name: str
    value: float | None
    unit: str
    limit: float | None = None
    passed: bool | None = None


@dataclass(frozen=True, slots=True)
class Quality:
    """All figures of one run, in a fixed order."""

    measures: tuple[Measure, ...]
