"""Which failures of a stage are tried again, without a server: the task's own rules."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from prefect.client.schemas.objects import State

from flexmap_tasks import tasks
from flexmap_tasks.engine.execute import Engine
from flexmap_tasks.engine.graph import Graph, SourceRef
from flexmap_tasks.engine.stage import Stage
from flexmap_tasks.errors import FlexMapError, InputError
from flexmap_tasks.formats.osm_fetch import OsmServerError
from flexmap_tasks.model.source import Source
from flexmap_tasks.store.store import Store


def runs_of(tmp_path: Path, error: FlexMapError) -> tuple[tasks.StageRuns, Any]:
    """A walk over one stage that fails with an error."""

    def fails(source: Source) -> dict[str, bytes]:
        raise error

    file = tmp_path / "a.txt"
    file.write_text("1")
    graph = Graph()
    graph.run(Stage(fails, "nothing", outside=True), source=SourceRef(file))
    runs = tasks.StageRuns(Engine(Store.open(tmp_path / "store")), graph, "map")
    return runs, graph.nodes["fails"]


@pytest.fixture(autouse=True)
def _no_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tasks, "_show_items", lambda *_: lambda _done, _all: None)


@pytest.mark.parametrize(
    ("error", "again"),
    [
        (OsmServerError("osm.example", "is busy"), [True] * tasks.OUTSIDE_RETRIES + [False]),
        (InputError("a.mcap", "is cut off"), [False]),
    ],
)
def test_a_server_is_asked_again_and_a_wrong_input_is_not(
    tmp_path: Path, error: FlexMapError, again: list[bool]
):
    runs, node = runs_of(tmp_path, error)
    task = runs._task(node)
    assert task.retries > tasks.OUTSIDE_RETRIES, "else Prefect logs a traceback that there is not"
    said = []
    for _ in again:
        state: State[Any] = runs.run_stage(node)
        assert state.is_failed()
        assert state.message == str(error)
        said.append(task.retry_condition_fn(task, None, state))  # type: ignore[misc]
    assert said == again
