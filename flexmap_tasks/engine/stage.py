"""What a stage is: a pure function with a name and an artifact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Stage(Generic[P, T]):
    """A pure function from values (and one `params` model) to a value. Calling it just calls the function.

    function : parameters are the inputs by name; `params`, if there is one, is a frozen pydantic model
    artifact : base name of the files its value is stored in
    outside : it reads something that is no file (a server); retried, and aged by `max_age_days` of its params
    """

    function: Callable[P, T]
    artifact: str
    outside: bool = False

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> T:
        """Just call the function."""
        return self.function(*args, **kwargs)

    @property
    def name(self) -> str:
        """The function's name: the name of the stage everywhere."""
        return self.function.__name__


def stage(artifact: str, *, outside: bool = False) -> Callable[[Callable[P, T]], Stage[P, T]]:
    """Decorate a function as a stage that writes `artifact`."""

    def wrap(function: Callable[P, T]) -> Stage[P, T]:
        return Stage(function, artifact, outside)

    return wrap


AnyStage = Stage[Any, Any]
