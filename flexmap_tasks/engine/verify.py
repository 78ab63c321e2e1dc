"""Everything in the store read and checked, from the first byte to the last."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

from flexmap_tasks.engine.finished import FOLDER as FINISHED
from flexmap_tasks.engine.release import broken_files, restore
from flexmap_tasks.engine.released import Released, all_released
from flexmap_tasks.engine.runs import RUNS
from flexmap_tasks.errors import InputError
from flexmap_tasks.store.artifact import digest_of, unseal
from flexmap_tasks.store.backend import Entry
from flexmap_tasks.store.store import CorruptBlobError, Store, parse_record, record_path


@dataclass(frozen=True, slots=True)
class Damage:
    """Something that is not what it should be.

    where : key in the store, or path of a file; what : one line; healed : it was removed or written anew
    """

    where: str
    what: str
    healed: bool = False


@dataclass(frozen=True, slots=True)
class Checked:
    """How much was read, and what was wrong."""

    entries: int
    bytes: int
    damages: tuple[Damage, ...]


def verify(store: Store, *, repair: bool = False) -> Checked:
    """Re-hash every blob, record, note and released file.

    With `repair`, what is damaged in the store is removed, so that the next run makes it anew, and releases are
    restored from the store where it still holds their content.
    """
    damages: list[Damage] = []
    entries: list[Entry] = []
    for folder, sound in (
        ("objects", _sound_blob),
        ("actions", _sound_record),
        (RUNS, _sound_note),
        (FINISHED, _sound_note),
        ("memo", _sound_note),
    ):
        found = list(store.backend.entries(folder))
        entries += found
        for entry, good in zip(found, store.map(partial(_check, store, sound), found), strict=True):
            if not good:
                if repair:
                    store.backend.delete(entry.key)
                damages.append(Damage(entry.key, "does not hold what its name or checksum says", repair))
    for record in store.records() if not repair else ():
        if not store.has(record.output):
            stage = record.preimage.get("stage", "?")
            damages.append(Damage(record_path(record.key), f"what {stage} made is gone; a run makes it anew"))
    damages += _check_releases(store, repair=repair)
    return Checked(len(entries), sum(e.size for e in entries), tuple(damages))


def _check(store: Store, sound: object, entry: Entry) -> bool:
    assert callable(sound)  # noqa: S101 - one of the three below
    content = store.backend.fetch(entry.key)
    return content is None or bool(sound(entry.key, content))  # None: another process removed it meanwhile


def _sound_blob(key: str, content: bytes) -> bool:
    return digest_of(content) == key.removeprefix("objects/").replace("/", "")


def _sound_record(key: str, content: bytes) -> bool:
    record = parse_record(content)
    return record is not None and record_path(record.key) == key


def _sound_note(_key: str, content: bytes) -> bool:
    return unseal(content) is not None


def _check_releases(store: Store, *, repair: bool) -> Iterator[Damage]:
    try:
        for release in all_released(store):
            yield from _check_release(store, release, repair=repair)
    except InputError as error:
        yield Damage(error.source, error.rule)


def _check_release(store: Store, release: Released, *, repair: bool) -> Iterator[Damage]:
    if not release.intact:
        yield Damage(
            str(release.folder / "manifest.json"), "was changed; the release's id is no longer its own"
        )
        return
    broken = broken_files(release.folder, release.manifest)
    healed = False
    if broken and repair:
        try:
            restore(store, release.folder, release.manifest)
            healed = True
        except CorruptBlobError:  # the store has lost it as well: only a run can make it
            healed = False
    for file in broken:
        yield Damage(str(release.folder / file), "is missing or was changed since it was released", healed)
