"""Items on a Dask cluster of real worker processes: the same bytes, and nothing is sent that is there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import toy

pytest.importorskip("distributed", reason="the extra `dask` is not installed")
from distributed import LocalCluster

from flexmap_tasks.engine import dask_items
from flexmap_tasks.engine.dask_items import DaskError, RemoteJob, compute_there
from flexmap_tasks.engine.execute import Engine
from flexmap_tasks.engine.items import DASK, prepare
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.errors import InputError
from flexmap_tasks.store.store import Store


@pytest.fixture(scope="module")
def cluster():
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
    ) as found:
        yield found
    dask_items._client.cache_clear()


@pytest.fixture
def numbers(tmp_path: Path) -> Path:
    file = tmp_path / "numbers.txt"
    file.write_text("1\n2\n3\n4\n9\n12\n")
    return file


def test_the_same_bytes_and_nothing_is_sent_twice(cluster, numbers, tmp_path, monkeypatch):
    here = run_local(Store.open(tmp_path / "here"), toy.toy_graph(numbers))
    monkeypatch.setenv(DASK, cluster.scheduler_address)
    store = Store.open(tmp_path / "there")
    toy.CALLS.clear()
    steps: list[tuple[str, int, int]] = []
    there = run_local(store, toy.toy_graph(numbers), on_item=lambda node, *n: steps.append((node.name, *n)))
    assert {n: (o.key, o.artifact) for n, o in there.items()} == {
        n: (o.key, o.artifact) for n, o in here.items()
    }
    assert not {"shift", "merge"} & set(toy.CALLS), "items were computed by the workers"
    assert {s for s in steps if s[0] == "shift"} == {("shift", 0, 2), ("shift", 1, 2), ("shift", 2, 2)}
    changed = run_local(store, toy.toy_graph(numbers, factor=3.0))
    assert changed["shift"].computed == 1, "only the item that the factor reaches"
    monkeypatch.setenv(DASK, "tcp://127.0.0.1:9")  # nobody listens: nothing may be asked
    store.backend.delete(f"actions/{there['shift'].key[:2]}/{there['shift'].key[2:]}.json")
    again = run_local(store, toy.toy_graph(numbers))
    assert (again["shift"].computed, again["shift"].artifact) == (0, here["shift"].artifact)


def test_an_error_of_an_item_is_the_error_of_the_run(cluster, tmp_path, monkeypatch):
    file = tmp_path / "numbers.txt"
    file.write_text("1\n2\n")
    monkeypatch.setenv(DASK, cluster.scheduler_address)
    graph = toy.toy_graph(file)
    graph.nodes["shift"] = replace(graph.nodes["shift"], stage=toy.refuse_odd)
    with pytest.raises(InputError, match="odd numbers are refused"):
        run_local(Store.open(tmp_path / "store"), graph)


def test_no_scheduler_is_one_clear_line(numbers, tmp_path, monkeypatch):
    monkeypatch.setenv(DASK, "tcp://127.0.0.1:9")
    monkeypatch.setattr(dask_items, "CONNECT_S", 1)
    with pytest.raises(DaskError, match="cannot be reached") as caught:
        run_local(Store.open(tmp_path / "store"), toy.toy_graph(numbers))
    assert "\n" not in str(caught.value)


def test_a_worker_with_other_code_refuses(numbers, tmp_path):
    store = Store.open(tmp_path / "store")
    graph = toy.toy_graph(numbers)
    outcomes = run_local(store, graph)
    engine, node = Engine(store), graph.nodes["shift"]
    bound = {
        n: engine.bind(ref, {k: o.artifact for k, o in outcomes.items()}) for n, ref in node.inputs.items()
    }
    item = bound["item"].artifact.sub("parts/").items()["even"]
    image, offset = engine.image(node, bound), {"offset": toy.Numbers(toy.np.zeros(1))}
    job = prepare(node, image, "even", item, {"offset": bound["offset"]}, offset)
    remote = RemoteJob(str(tmp_path / "store"), "toy", "shift", None, "item", job)
    assert compute_there(remote).output.files
    other = replace(job, image={**job.image, "code": {**job.image["code"], "toy": "0" * 64}})
    with pytest.raises(DaskError, match="other code"):
        compute_there(replace(remote, job=other))
