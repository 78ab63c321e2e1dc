"""A file that comes from outside."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

BUCKET = "s3:/"
"""How the address of a file in a bucket begins where paths are kept: s3://bucket/key is a `Path` without its second
slash. No other path that is resolved begins so."""


def bucket_url(path: Path | str) -> str | None:
    """The address in a bucket that a path stands for; None for a file on this machine."""
    text = str(path)
    return f"s3://{text.removeprefix(BUCKET).lstrip('/')}" if text.startswith(BUCKET) else None


@dataclass(frozen=True, slots=True)
class Source:
    """An input file as a value: stages hand it to `formats`, which alone look inside.

    name : the name for messages to the user
    path : where its bytes can be read; not part of its identity
    """

    name: str
    path: Path
