"""The engine recomputes what changed and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest
import toy

from flexmap_tasks.engine.execute import Engine
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.engine.plan import make_plan
from flexmap_tasks.engine.release import publish_release
from flexmap_tasks.engine.runs import read_last_run, write_last_run
from flexmap_tasks.store.store import Store


@pytest.fixture
def numbers(tmp_path: Path) -> Path:
    file = tmp_path / "numbers.txt"
    file.write_text("1\n2\n3\n4\n")
    return file


@pytest.fixture
def store(tmp_path: Path) -> Store:
    toy.CALLS.clear()
    return Store.open(tmp_path / "store")


def run(store: Store, numbers: Path, factor: float = 2.0):
    toy.CALLS.clear()
    outcomes = run_local(store, toy.toy_graph(numbers, factor))
    write_last_run(store, "toy", {n: o.key for n, o in outcomes.items()})
    return outcomes


def plan(store: Store, numbers: Path, factor: float = 2.0) -> dict[str, str]:
    made = make_plan(Engine(store), toy.toy_graph(numbers, factor), read_last_run(store, "toy"))
    return {s.node.name: s.state for s in made.steps}


def test_a_second_run_executes_nothing(store, numbers):
    first = run(store, numbers)
    assert sorted(toy.CALLS) == sorted(
        ["read_numbers", "scale", "split", "shift", "shift", "merge", "merge", "listing", "add"]
    )
    second = run(store, numbers)
    assert toy.CALLS == []
    assert all(o.cached for o in second.values())
    assert [o.artifact for o in first.values()] == [o.artifact for o in second.values()]
    assert set(plan(store, numbers).values()) == {"cached"}


def test_the_result_is_right(store, numbers, tmp_path):
    outcomes = run(store, numbers)
    graph = toy.toy_graph(numbers)
    artifacts = {n: o.artifact for n, o in outcomes.items()}
    release = publish_release(
        store, graph, artifacts, {n: o.key for n, o in outcomes.items()}, tmp_path / "r", "toy"
    )
    # offset = sum of scaled = 20; even + 20 -> high; odd + 0 -> low
    assert (release.folder / "texts" / "high.txt").read_text() == "22.0 24.0"
    assert (release.folder / "texts" / "low.txt").read_text() == " 1.0 3.0".strip()
    assert (release.folder / "list.txt").read_text() == "high,low"
    assert (tmp_path / "r" / "toy" / "latest").resolve() == release.folder


def test_a_parameter_reruns_only_what_depends_on_it(store, numbers):
    run(store, numbers)
    assert plan(store, numbers, 3.0) == {
        "read_numbers": "cached", "scale": "run", "split": "cached",
        "shift": "depends", "merge": "depends", "listing": "depends", "add": "depends",
    }  # fmt: skip
    run(store, numbers, 3.0)
    # the odd item is not touched by the offset: its shift stays cached, and so does the merge of what it fed
    assert sorted(toy.CALLS) == ["add", "merge", "scale", "shift"]


def test_the_plan_says_why(store, numbers):
    run(store, numbers)
    made = make_plan(Engine(store), toy.toy_graph(numbers, 3.0), read_last_run(store, "toy"))
    why = {s.node.name: s.why for s in made.steps}
    assert why["scale"] == "factor: 2.0 -> 3.0"
    numbers.write_text("1\n2\n")
    made = make_plan(Engine(store), toy.toy_graph(numbers), read_last_run(store, "toy"))
    assert made.steps[0].why == "file numbers.txt changed"


def test_same_bytes_upstream_cut_off_the_rest(store, numbers):
    run(store, numbers)
    numbers.write_text("4\n3\n2\n1\n")  # sorted by the stage: the same value
    states = plan(store, numbers)
    assert states.pop("read_numbers") == "run"
    assert set(states.values()) == {"depends"}
    run(store, numbers)
    assert toy.CALLS == ["read_numbers"]


@pytest.mark.parametrize("damage", ["flip", "truncate", "delete"])
def test_damaged_blobs_are_never_served_and_heal(store, numbers, damage):
    first = run(store, numbers)
    for file in sorted((store.backend.root / "objects").rglob("*")):
        if not file.is_file():
            continue
        content = bytearray(file.read_bytes())
        file.unlink()
        if damage == "flip":
            content[len(content) // 2] ^= 1
        if damage == "truncate":
            content = content[:-1]
        if damage != "delete":
            file.write_bytes(bytes(content))
        # a changed parameter forces the inputs of the stages below to be read
        run(store, numbers, factor=5.0)
        second = run(store, numbers)
        assert [o.artifact for o in first.values()] == [o.artifact for o in second.values()]


def test_damaged_records_are_misses(store, numbers):
    first = run(store, numbers)
    for i, file in enumerate(sorted((store.backend.root / "actions").rglob("*.json"))):
        content = bytearray(file.read_bytes())
        content[(i * 37) % len(content)] ^= 1 << (i % 8)
        file.unlink()
        file.write_bytes(bytes(content))
    second = run(store, numbers)
    assert toy.CALLS
    assert [o.artifact for o in first.values()] == [o.artifact for o in second.values()]


def test_releases_heal(store, numbers, tmp_path):
    outcomes = run(store, numbers)
    args = (store, toy.toy_graph(numbers), {n: o.artifact for n, o in outcomes.items()},
            {n: o.key for n, o in outcomes.items()}, tmp_path / "r", "toy")  # fmt: skip
    release = publish_release(*args)
    assert release.fresh
    assert not publish_release(*args).fresh
    (release.folder / "sum.parquet").unlink()
    assert publish_release(*args).fresh
    assert (release.folder / "sum.parquet").is_file()
