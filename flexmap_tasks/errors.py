"""Every error a user can cause or meet, each with one clear line.

FlexMapError                  the root: `str(error)` is the line a person reads; exit code 2
├── InputError                a file, an element of it, or a value in it breaks a rule
│   ├── ConfigError           the configuration itself
│   ├── AlignmentError        tracks or control points that cannot be aligned
│   └── CoverageError         inputs that do not belong to the same place
├── StoreError                the artifact store cannot be read or written
└── NotPublishedError         the gate did not publish a candidate
    ├── HeldError             it waits for a person; exit code 3
    └── RejectedError         it must not be used; exit code 4
"""

from __future__ import annotations


class FlexMapError(Exception):
    """Root of all errors that are reported to a person without a traceback."""

    exit_code = 2


class InputError(FlexMapError):
    """Something in an input breaks a rule.

    source : name of the file, topic or parameter as the user knows it
    rule   : what was expected, what was found, what to do
    where  : line, element or row inside the source
    """

    def __init__(self, source: str, rule: str, where: str | None = None) -> None:
        self.source, self.rule, self.where = source, rule, where
        super().__init__(source, rule, where)

    def __str__(self) -> str:
        return f"{self.source} {self.where}: {self.rule}" if self.where else f"{self.source}: {self.rule}"


class ConfigError(InputError):
    """The configuration breaks a rule; `source` names the file, `where` the key."""


class AlignmentError(InputError):
    """Tracks or control points from which no trustworthy alignment can be made."""


class CoverageError(InputError):
    """Inputs that describe different places."""


class StoreError(FlexMapError):
    """The artifact store cannot be read or written as it must be."""


class NotPublishedError(FlexMapError):
    """A run came to its end, but the gate did not publish what it made."""


class HeldError(NotPublishedError):
    """The candidate waits for a person's decision."""

    exit_code = 3


class RejectedError(NotPublishedError):
    """The candidate missed a limit that rejects it."""

    exit_code = 4
