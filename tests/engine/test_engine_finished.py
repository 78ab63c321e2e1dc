"""That nothing changed is said only when nothing did."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
import toy

from flexmap_tasks.config import Params
from flexmap_tasks.engine import finished, sources
from flexmap_tasks.engine.finished import remember_finished, still_finished, watch
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.engine.release import publish_release
from flexmap_tasks.store.store import Store, object_key, record_path


class Settings(Params):
    map: str = "toy"
    file: Path
    factor: float = 2.0


@pytest.fixture
def settings(tmp_path) -> Settings:
    file = tmp_path / "numbers.txt"
    file.write_text("1\n2\n3\n4\n")
    return Settings(file=file)


@pytest.fixture
def store(tmp_path, monkeypatch) -> Store:
    monkeypatch.setattr(sources, "RACY_NS", 0)  # else every file of a test is too young
    monkeypatch.setattr(finished, "_LOADED_NS", time.time_ns() + 10**12)
    return Store.open(tmp_path / "store")


def run(store: Store, settings: Settings):
    graph = toy.toy_graph(settings.file, settings.factor)
    watched = watch(graph)
    outcomes = run_local(store, graph)
    actions = {n: o.key for n, o in outcomes.items()}
    release = publish_release(
        store, graph, {n: o.artifact for n, o in outcomes.items()}, actions, store.releases, "toy"
    )
    remember_finished(store, settings, graph, actions, release, watched)
    return release, outcomes


def test_the_same_run_again_is_known(store, settings):
    assert still_finished(store, settings, store.releases) is None
    release, outcomes = run(store, settings)
    known = still_finished(store, settings, store.releases)
    assert known.release.folder == release.folder
    assert (known.release.id, known.release.fresh, known.stages) == (release.id, False, len(outcomes))


def rewrite(path: Path, content: bytes) -> None:
    """Other bytes of the same length under the same time of last write."""
    stat = path.stat()
    path.chmod(0o644)
    path.write_bytes(content)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


def drop_first_blob(store, settings, release, outcomes):
    store.backend.delete(object_key(outcomes["add"].artifact.files[0][1].sha256))


def cut_first_blob(store, settings, release, outcomes):
    path = store.backend.root / object_key(outcomes["add"].artifact.files[0][1].sha256)
    path.chmod(0o644)
    os.truncate(path, 1)


def damage_record(store, settings, release, outcomes):
    path = store.backend.root / record_path(outcomes["add"].key)
    rewrite(path, path.read_bytes().replace(b"sum", b"sun"))


DOUBTS = {
    "source edited, its time set back": lambda store, settings, release, outcomes: rewrite(settings.file, b"4\n3\n2\n1\n"),
    "source gone": lambda store, settings, release, outcomes: settings.file.unlink(),
    "source replaced": lambda store, settings, release, outcomes: (settings.file.rename(f"{settings.file}2"), settings.file.write_text("1\n")),
    "blob gone": drop_first_blob,
    "blob cut": cut_first_blob,
    "record damaged": damage_record,
    "record gone": lambda store, settings, release, outcomes: store.backend.delete(record_path(outcomes["add"].key)),
    "released file gone": lambda store, settings, release, outcomes: (release.folder / "list.txt").unlink(),
    "released file edited": lambda store, settings, release, outcomes: rewrite(release.folder / "list.txt", b"high,lov"),
    "manifest edited": lambda store, settings, release, outcomes: rewrite(release.folder / "manifest.json", b"{}"),
    "latest moved": lambda store, settings, release, outcomes: (release.folder.parent / "latest").unlink(),
    "note damaged": lambda store, settings, release, outcomes: [store.backend.put(e.key, b"{}", replace=True) for e in store.backend.entries("finished")],
}  # fmt: skip


@pytest.mark.parametrize("doubt", DOUBTS)
def test_any_doubt_is_a_reason_to_plan(store, settings, doubt):
    release, outcomes = run(store, settings)
    DOUBTS[doubt](store, settings, release, outcomes)
    assert still_finished(store, settings, store.releases) is None


def test_other_settings_releases_and_libraries_are_other_runs(store, settings, tmp_path, monkeypatch):
    run(store, settings)
    assert still_finished(store, settings.model_copy(update={"factor": 3.0}), store.releases) is None
    assert still_finished(store, settings, tmp_path / "elsewhere") is None
    monkeypatch.setattr(finished, "library_versions", lambda: {"numpy": "99"})
    assert still_finished(store, settings, store.releases) is None


def test_code_that_came_is_a_reason_to_plan(store, settings, monkeypatch):
    run(store, settings)
    monkeypatch.setattr(finished, "code_files", lambda _package: [Path(__file__)])
    assert still_finished(store, settings, store.releases) is None


def test_files_too_young_to_tell_are_not_remembered(store, settings, monkeypatch):
    monkeypatch.setattr(sources, "RACY_NS", 10**15)
    run(store, settings)
    assert still_finished(store, settings, store.releases) is None


def test_what_came_from_a_server_grows_too_old(store, settings, monkeypatch):
    monkeypatch.setattr(finished, "_expires", lambda *_: "2020-01-01T00:00:00+00:00")
    run(store, settings)
    assert still_finished(store, settings, store.releases) is None
