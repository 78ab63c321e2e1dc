"""Quality as figures with units and limits."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import ClassVar


@dataclass(frozen=True, slots=True)
class Measure:
    """One figure.

    name : what was measured; unit : "m", "1" for shares and ratios, "count", "deg"
    value : the figure, None where there was nothing to measure
    limit : what it is judged by, None where it is only reported; passed : None where it is not judged
    """

    name: str
    value: float | None
    unit: str
    limit: float | None = None
    passed: bool | None = None

    @classmethod
    def at_most(cls, name: str, value: float | None, unit: str, limit: float | None) -> Measure:
        """A figure that passes up to the limit; one that could not be measured does not pass."""
        passed = None if limit is None else value is not None and value <= limit
        return cls(name, value, unit, limit, passed)

    @classmethod
    def at_least(cls, name: str, value: float | None, unit: str, limit: float | None) -> Measure:
        """A figure that passes from the limit on; one that could not be measured does not pass."""
        passed = None if limit is None else value is not None and value >= limit
        return cls(name, value, unit, limit, passed)

    def __post_init__(self) -> None:
        if self.value is not None and not isfinite(self.value):
            raise ValueError(f"{self.name} is {self.value}; a figure that cannot be measured is None")


@dataclass(frozen=True, slots=True)
class Quality:
    """All figures of one run, in a fixed order."""

    as_json: ClassVar[bool] = True

    measures: tuple[Measure, ...]

    @property
    def passed(self) -> bool:
        """No judged figure fails."""
        return all(m.passed is not False for m in self.measures)

    def value(self, name: str) -> float | None:
        """The figure of that name; KeyError where there is none."""
        for measure in self.measures:
            if measure.name == name:
                return measure.value
        raise KeyError(name)
