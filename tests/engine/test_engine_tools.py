"""The store answers where things come from, what differs, what is damaged and what may go."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
import toy
from work import files_of, run_toy

from flexmap_tasks.engine.diff import diff_releases
from flexmap_tasks.engine.explain import explain, explain_stage
from flexmap_tasks.engine.gc import collect, stats
from flexmap_tasks.engine.lineage import file_lineage
from flexmap_tasks.engine.released import find_release, released_file
from flexmap_tasks.engine.runs import read_runs
from flexmap_tasks.engine.sync import copy_missing
from flexmap_tasks.engine.verify import verify
from flexmap_tasks.errors import InputError
from flexmap_tasks.store.store import Store, object_key


@pytest.fixture
def numbers(tmp_path: Path) -> Path:
    file = tmp_path / "numbers.txt"
    file.write_text("1\n2\n3\n4\n")
    return file


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store.open(tmp_path / "store")


def grow_old(store: Store) -> None:
    for file in store.backend.root.rglob("*"):
        if file.is_file() and not file.is_relative_to(store.releases):
            os.utime(file, (0, 0))


def test_a_release_is_found_by_all_its_names(store, numbers, monkeypatch):
    release = run_toy(store, numbers)
    names = [
        "toy",
        f"toy/{release.id}",
        release.id[:6],
        str(release.folder),
        str(release.folder / "texts" / "low.txt"),
    ]
    assert {find_release(store, name).id for name in names} == {release.id}
    monkeypatch.chdir(release.folder)
    assert find_release(store, ".").id == release.id
    assert released_file(find_release(store, "."), "texts/low.txt") == "texts/low.txt"
    for unknown in ("nowhere", "zzzz", "../toy", "*"):
        with pytest.raises(InputError, match="is no release"):
            find_release(store, unknown)
    shutil.copytree(release.folder, release.folder.with_name(release.id[:6] + "0" * 10))
    with pytest.raises(InputError, match="names several releases"):
        find_release(store, release.id[:6])


def test_explain_names_stages_settings_inputs_and_code(store, numbers):
    release = find_release(store, run_toy(store, numbers, 3.0).id)
    facts = {f.name: f for f in explain(store, release)}
    assert list(facts) == ["read_numbers", "scale", "split", "add", "shift", "merge", "listing"]
    assert facts["scale"].params == {"factor": 3.0}
    assert [(i.name, i.origin) for i in facts["shift"].inputs] == [
        ("item", "split.parts"),
        ("offset", "scale"),
    ]
    assert [i.origin for i in facts["listing"].inputs] == ["merge, its keys"]
    assert facts["merge"].files == ("texts/high.txt", "texts/low.txt")
    assert "toy" in facts["scale"].modules()
    assert set(facts["shift"].record.items) == {"even", "odd"}
    with pytest.raises(InputError, match="its stages are read_numbers"):
        explain_stage(store, release, "nothing")


def test_lineage_ends_at_files(store, numbers):
    release = find_release(store, run_toy(store, numbers).id)
    origin = file_lineage(store, release, "texts/low.txt")
    assert origin.stages == ("merge", "shift", "split", "scale", "read_numbers")
    assert origin.sources["read_numbers.source"]["path"] == str(numbers)
    assert origin.sources["read_numbers.source"]["size"] == 8


def test_diff_names_the_cause_and_its_effects(store, numbers):
    old = find_release(store, run_toy(store, numbers).id)
    new = find_release(store, run_toy(store, numbers, 3.0).id)
    found = diff_releases(store, old, new)
    assert [(c.stage, c.what, c.why) for c in found.stages] == [
        ("add", "other result", ()),
        ("merge", "other result", ()),
        ("scale", "other result", ("factor: 2.0 -> 3.0",)),
        ("shift", "other result", ()),
    ]
    assert diff_releases(store, old, old).stages == ()
    numbers.write_text("1\n2\n3\n8\n")
    third = find_release(store, run_toy(store, numbers).id)
    assert diff_releases(store, old, third).sources == (("read_numbers.source", str(numbers), str(numbers)),)


def test_verify_finds_every_damage_and_a_run_heals_it(store, numbers):
    release = run_toy(store, numbers)
    before = files_of(release.folder)
    assert verify(store).damages == ()
    wrong = 0
    for part in ("objects", "actions", "runs"):
        for file in sorted(p for p in (store.backend.root / part).rglob("*") if p.is_file()):
            content = bytearray(file.read_bytes())
            content[len(content) // 2] ^= 4
            file.unlink()
            file.write_bytes(bytes(content))
            wrong += 1
    (release.folder / "list.txt").write_text("low")
    found = verify(store).damages
    assert len(found) == wrong + 1
    assert [d.where for d in found if not d.where.startswith(("objects", "actions", "runs"))] == [
        str(release.folder / "list.txt")
    ]
    assert (
        sum(d.healed for d in verify(store, repair=True).damages) == wrong
    )  # the release's content is gone too
    run_toy(store, numbers)
    assert files_of(release.folder) == before
    assert verify(store).damages == ()


def test_verify_restores_a_release_from_the_store(store, numbers):
    release = run_toy(store, numbers)
    before = files_of(release.folder)
    (release.folder / "list.txt").write_text("low")
    (release.folder / "texts" / "low.txt").unlink()
    assert len(verify(store, repair=True).damages) == 2
    assert files_of(release.folder) == before


def test_gc_keeps_releases_and_recent_runs_and_nothing_else(store, numbers, tmp_path):
    kept = run_toy(store, numbers, 2.0)
    for factor in (3.0, 4.0, 5.0):
        dropped = run_toy(store, numbers, factor)
        for file in sorted(dropped.folder.rglob("*"), reverse=True):
            file.rmdir() if file.is_dir() else file.unlink()
        dropped.folder.rmdir()
    grow_old(store)
    blobs = {entry.key for entry in store.backend.entries("objects")}
    dry = collect(store, keep_runs=1, keep_days=0, dry_run=True)
    assert {entry.key for entry in store.backend.entries("objects")} == blobs
    swept = collect(store, keep_runs=1, keep_days=0)
    assert (dry.blobs, dry.records, dry.runs) == (swept.blobs, swept.records, swept.runs)
    assert swept.blobs > 0
    assert swept.runs == 2
    assert [run.release for run in read_runs(store)] == [dropped.id, kept.id]
    for factor in (2.0, 5.0):  # the release and the last run need nothing to be made anew
        toy.CALLS.clear()
        run_toy(store, numbers, factor)
        assert toy.CALLS == []
    assert verify(store).damages == ()
    toy.CALLS.clear()
    run_toy(store, numbers, 3.0)
    assert "scale" in toy.CALLS


def test_gc_leaves_what_is_young_or_used_again(store, numbers):
    run_toy(store, numbers, 2.0)
    before = {entry.key for entry in store.backend.entries("objects")}
    for run in read_runs(store):
        store.backend.delete(run.path)
    (store.releases / "toy").rename(store.releases.parent / "moved")
    assert collect(store, keep_runs=0, keep_days=0).blobs == 0
    grow_old(store)
    run_toy(store, numbers, 2.0)
    (store.releases / "toy").rename(store.releases.parent / "moved again")
    for run in read_runs(store):
        store.backend.delete(run.path)
    assert collect(store, keep_runs=0, keep_days=0).blobs == 0
    assert {entry.key for entry in store.backend.entries("objects")} == before
    grow_old(store)
    collect(store, keep_runs=0, keep_days=0)
    assert list(store.backend.entries("objects")) == []


def test_gc_refuses_when_it_cannot_know_what_a_release_needs(store, numbers):
    release = run_toy(store, numbers)
    (release.folder / "manifest.json").write_text("{}")
    with pytest.raises(InputError, match="is damaged"):
        collect(store)


def test_copies_are_whole_and_only_what_is_missing(store, numbers, tmp_path):
    release = run_toy(store, numbers)
    other = Store.open(tmp_path / "other")
    first = copy_missing(store, other)
    assert (first.skipped, first.releases) == (0, 1)
    assert files_of(other.releases / "toy" / release.id) == files_of(release.folder)
    assert verify(other).damages == ()
    assert copy_missing(store, other).blobs == 0
    run_toy(store, numbers, 3.0)
    assert 0 < copy_missing(store, other).blobs < first.blobs
    (blob,) = (b for _, b in store.find(next(store.records()).key).output.files[:1])
    assert other.read_blob(blob) == store.read_blob(blob)
    store.backend.delete(object_key(blob.sha256))
    assert copy_missing(store, Store.open(tmp_path / "third")).skipped > 0


def test_stats_count_everything(store, numbers):
    run_toy(store, numbers)
    counted = {what: number for what, number, _ in stats(store)}
    assert counted["objects"] > 0
    assert counted["runs"] == 1
    assert counted["tmp"] == 0
