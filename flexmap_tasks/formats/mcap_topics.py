"""Which topic of a recording is meant: the only one that fits, or the one the user names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.mcap_records import Recording, Schema
from flexmap_tasks.formats.track_rows import printable

_NO_SCHEMA = Schema("", "", b"")
LISTED_TOPICS = 40
"""An error lists at most this many topics."""


@dataclass(frozen=True, slots=True)
class Topic:
    """Messages of one type and encoding under one name, from however many publishers.

    channels : channel ids
    count : number of messages
    """

    name: str
    kind: str
    encoding: str
    schema: Schema
    channels: frozenset[int]
    count: int

    def __str__(self) -> str:
        kind = printable(self.kind) or "no schema"
        where = "" if self.encoding == "cdr" else f" in {printable(self.encoding) or 'no encoding'}"
        return f"{self.label} ({kind}{where}, {self.count:,} messages)"

    @property
    def label(self) -> str:
        """The name as it may stand in a message."""
        return printable(self.name)


def topics_of(recording: Recording) -> list[Topic]:
    """All topics by name; a type `pkg/msg/Name` is called `pkg/Name`."""
    groups: dict[tuple[str, str, str], list[int]] = {}
    for number, channel in sorted(recording.channels.items()):
        kind = recording.schemas.get(channel.schema_id, _NO_SCHEMA).name.replace("/msg/", "/")
        groups.setdefault((channel.topic, kind, channel.encoding), []).append(number)
    out = []
    for (name, kind, encoding), ids in sorted(groups.items()):
        schema = recording.schemas.get(recording.channels[ids[0]].schema_id, _NO_SCHEMA)
        count = sum(recording.counts.get(number, 0) for number in ids)
        out.append(Topic(name, kind, encoding, schema, frozenset(ids), count))
    return out


def choose_topic(
    recording: Recording, kinds: Mapping[str, tuple[str, ...]], wanted: str | None, purpose: str, setting: str
) -> Topic:
    """The topic to read.

    kinds : message encodings that can be read, by type name
    wanted : the user's choice, if any
    purpose, setting : what is looked for and which setting names it, for messages

    Raises InputError that lists the topics when none or several fit.
    """
    every = topics_of(recording)
    fitting = [t for t in every if t.encoding in kinds.get(t.kind, ()) and t.count]
    if wanted is not None:
        named = [t for t in every if t.name == wanted]
        fitting = [t for t in fitting if t.name == wanted]
        if not named:
            raise InputError(recording.name, f"there is no topic {wanted}; {_listed(every)}")
        if not fitting:
            rule = f"{' and '.join(map(str, named))} holds no {purpose}; readable types are {_types(kinds)}"
            raise InputError(recording.name, rule)
    if not fitting:
        rule = f"no topic holds {purpose}; readable types are {_types(kinds)}; {_listed(every)}"
        raise InputError(recording.name, rule)
    if len(fitting) > 1:
        raise InputError(
            recording.name, f"several topics hold {purpose}: name one as `{setting}`; {_listed(fitting)}"
        )
    return fitting[0]


def _types(kinds: Mapping[str, tuple[str, ...]]) -> str:
    return ", ".join(f"{kind} ({'/'.join(encodings)})" for kind, encodings in kinds.items())


def _listed(topics: list[Topic]) -> str:
    if not topics:
        return "the file has no topics"
    more = f" and {len(topics) - LISTED_TOPICS} more" if len(topics) > LISTED_TOPICS else ""
    return f"topics are: {'; '.join(map(str, topics[:LISTED_TOPICS]))}{more}"
