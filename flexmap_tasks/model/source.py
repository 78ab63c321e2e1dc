"""A file that comes from outside."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Source:
    """An input file as a value: stages hand it to `formats`, which alone look inside.

    name : the name for messages to the user
    path : where its bytes can be read; not part of its identity
    """

    name: str
    path: Path
