"""What is up for review, decided in the browser, saved, and carried out by the next run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_editor_browser import to_screen, until
from test_editor_server import ask, request

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.formats.artifacts import decode
from flexmap_tasks.formats.review_decisions_csv import HEADER, read_review_decisions
from flexmap_tasks.model.conflation import Enriched
from flexmap_tasks.model.maps import PlacedRoads
from flexmap_tasks.model.review import ReviewDecisions, ReviewedMatches
from flexmap_tasks.model.source import Source
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.store.store import ArtifactFiles, Store
from flows.editor.server import EditServer

Serve = Callable[[FlexMapConfig], EditServer]


@pytest.fixture
def reviewed(config: FlexMapConfig, shared_data: Path, tmp_path: Path) -> FlexMapConfig:
    """The route in Garching with OpenStreetMap, and a file of decisions that is not there yet."""
    settings = config.model_dump(mode="json")
    settings["osm"] = {"file": str(shared_data / "garching" / "osm_2023.osm")}
    settings["conflation"] = {"review_file": str(tmp_path / "decisions.csv")}
    return FlexMapConfig.model_validate(settings)


def opened(page: Any, server: EditServer) -> Any:
    page.goto(f"{server.address}review")
    ready(page)
    return page


def ready(page: Any) -> None:
    page.wait_for_selector("html[data-ready=yes]", state="attached", timeout=60_000)


def go_to_first(page: Any, kind: str, other_than: str = "") -> None:
    """Step to the first item of a kind, from the start, on another lanelet than that."""
    page.evaluate("location.hash = '#item=1'")
    until(lambda: page.locator("#inspector .question").count() == 1)
    for _ in range(200):
        lanelet = page.inner_text("#inspector h2")
        if kind in page.inner_text("#inspector .question small") and lanelet != other_than:
            return
        page.keyboard.press("n")
    raise AssertionError(f"no {kind} is up for review")


def decisions_in(config: FlexMapConfig) -> ReviewDecisions:
    file = config.conflation.review_file
    assert file is not None
    return read_review_decisions(Source(file.name, file))


def values(store: Store, config: FlexMapConfig, *wanted: tuple[str, str, Any]) -> list[Any]:
    outcomes = run_local(store, map_update(config))
    return [
        decode(kind, ArtifactFiles(store, outcomes[stage].artifact), name) for stage, name, kind in wanted
    ]


def saved(page: Any) -> None:
    page.keyboard.press("Control+s")
    until(lambda: "Saved" in page.inner_text("#said"))


def test_decisions_travel_into_the_next_release(
    page: Any, serve: Serve, reviewed: FlexMapConfig, store: Store
) -> None:
    opened(page, serve(reviewed))
    total = int(page.inner_text("#step").split()[0])
    go_to_first(page, "match")
    without_road = page.inner_text("#inspector h2")
    page.keyboard.press("x")
    go_to_first(page, "attribute", other_than=without_road)
    lanelet = page.inner_text("#inspector h2")
    key = page.inner_text("#inspector .question p bdi").strip()
    page.fill("#inspector .question .value", "70" if key == "speed_limit" else "gravel")
    page.fill("#inspector .question .note", 'seen "there", today')
    page.click("#inspector .question [data-decision=accept]")
    assert page.inner_text("#step").endswith(f"of {total}")
    saved(page)
    told = decisions_in(reviewed)
    assert sorted(told.kind.tolist()) == ["match", "value"]
    assert all(told.who)
    assert all(told.when)
    page.click("#said button")
    page.wait_for_event("load")
    ready(page)
    page.click("[data-tab=decisions]")
    assert page.locator("#panel .is-holds").count() == 2
    assert page.complaints == []
    reviewed_, enriched = values(
        store,
        reviewed,
        ("review_matches", "reviewed_matches", ReviewedMatches),
        ("apply_review", "reviewed", Enriched),
    )
    assert sum("rejected by a person" in r for r in reviewed_.matches.reason) == 1
    assert len(reviewed_.unused) == 0
    row = next(i for i, r in enumerate(enriched.transfers.reason) if "by a person" in r)
    assert str(enriched.transfers.lanelet_id[row]) == lanelet
    assert 'seen "there", today' in enriched.transfers.reason[row]
    relations = enriched.map.document.relations
    (at,) = np.flatnonzero(relations.id == int(lanelet)).tolist()
    assert relations.tags.of_element(at)[key] == enriched.transfers.new[row]


def test_another_way_is_chosen_by_a_click(
    page: Any, serve: Serve, reviewed: FlexMapConfig, store: Store
) -> None:
    opened(page, serve(reviewed))
    go_to_first(page, "match")
    page.keyboard.press("c")
    place = to_screen(page)
    (roads,) = values(store, without_review(reviewed), ("place_roads", "placed_roads", PlacedRoads))
    box, network = page.locator("#map").bounding_box(), roads.network
    way, x, y = next(
        (int(network.way_id[w]), x, y)
        for w, (a, b) in enumerate(zip(network.offset[:-1], network.offset[1:], strict=True))
        for x, y in [place((roads.xy_m[a : a + 2].mean(axis=0)).tolist())]
        if b - a >= 2
        and box["x"] + 60 < x < box["x"] + box["width"] - 60
        and box["y"] + 80 < y < box["y"] + 380
    )
    page.mouse.move(x, y)
    page.mouse.click(x, y)
    until(lambda: page.locator("#decided:visible").count() == 1)
    saved(page)
    (told,) = [decisions_in(reviewed)]
    assert told.kind.tolist() == ["match"]
    chosen = int(told.value[0] or told.way_id[0])
    (row,) = np.flatnonzero(network.way_id == chosen).tolist()
    course = roads.xy_m[network.offset[row] : network.offset[row + 1]]
    (shown,) = np.flatnonzero(network.way_id == way).tolist()
    target = roads.xy_m[network.offset[shown] : network.offset[shown] + 2].mean(axis=0)
    assert np.hypot(*(course - target).T).min() < 200
    assert page.complaints == []


def without_review(config: FlexMapConfig) -> FlexMapConfig:
    return config.model_copy(
        update={"conflation": config.conflation.model_copy(update={"review_file": None})}
    )


def test_undo_and_redo(page: Any, serve: Serve, reviewed: FlexMapConfig) -> None:
    opened(page, serve(reviewed))
    page.keyboard.press("n")
    page.keyboard.press("x")
    page.keyboard.press("x")
    assert page.inner_text("#decided") == "Save 2 decisions"
    page.keyboard.press("Control+z")
    assert page.inner_text("#decided") == "Save 1 decision"
    page.keyboard.press("Control+z")
    assert page.locator("#decided:visible").count() == 0
    page.keyboard.press("Control+y")
    assert page.inner_text("#decided") == "Save 1 decision"
    page.click("[data-tab=decisions]")
    page.click("#panel .close")
    assert page.locator("#decided:visible").count() == 0


def test_two_windows_of_one_editor_are_told_apart(page: Any, serve: Serve, reviewed: FlexMapConfig) -> None:
    server = serve(reviewed)
    opened(page, server)
    other = opened(page.context.browser.new_context().new_page(), server)
    for window in (page, other):
        window.keyboard.press("n")
        window.keyboard.press("x")
    saved(page)
    before = decisions_in(reviewed)
    other.keyboard.press("Control+s")
    until(lambda: "changed by someone else" in other.inner_text("#said.bad"))
    assert decisions_in(reviewed).when.tolist() == before.when.tolist()
    assert other.inner_text("#decided") == "Save 1 decision"
    page.keyboard.press("x")
    saved(page)
    assert len(decisions_in(reviewed)) == 2


ROW = dict.fromkeys(HEADER, "") | {"kind": "value", "lanelet_id": "1", "way_id": "2", "decision": "accept"}


@pytest.mark.parametrize(
    "sent",
    [None, "all", [1], [{}], [ROW | {"more": "x"}], [ROW | {"key": 3}], [ROW | {"kind": "odd"}], [ROW | {"key": "\ud800"}],
     [ROW | {"lanelet_id": "../x"}], [ROW | {"kind": "match"}], [ROW | {"note": "x" * 30_000}]],
)  # fmt: skip
def test_what_is_no_decision_is_not_saved(
    serve: Serve, reviewed: FlexMapConfig, tmp_path: Path, sent: Any
) -> None:
    status, told = ask(serve(reviewed), "decide", {"base": "", "decisions": sent})
    assert status == 200
    assert told["error"].startswith("the page")
    assert [p.name for p in tmp_path.iterdir()] == ["points.csv"]


def test_hostile_text_comes_back_as_it_was(serve: Serve, reviewed: FlexMapConfig, tmp_path: Path) -> None:
    server = serve(reviewed)
    texts = ["</script><script>window.hacked=1</script>", '=HYPERLINK("x")', "\u202eא", "a\r\nb,\"c'", "'=x"]
    rows = [ROW | {"key": "road_name", "old": text, "new": text, "note": text} for text in texts]
    assert "error" not in ask(server, "decide", {"base": "", "decisions": rows})[1]
    assert decisions_in(reviewed).new.tolist() == texts
    status, content, _ = request(server, "GET", f"/{server.token}/review")
    assert status == 200
    assert b"<script>window.hacked" not in content
    assert (tmp_path / "decisions.csv").stat().st_mode & 0o777 == 0o644


def test_who_does_not_know_the_token_or_comes_from_elsewhere_decides_nothing(
    serve: Serve, reviewed: FlexMapConfig, tmp_path: Path
) -> None:
    server, body = serve(reviewed), b'{"base":"","decisions":[]}'
    json_ = {"Content_Type": "application/json"}
    for path in ("/wrong/decide", "/decide", f"/{server.token}x/decide"):
        assert request(server, "POST", path, body, **json_)[0] == 403
        assert request(server, "GET", path.replace("decide", "review"))[0] == 403
    for headers in ({"Origin": "http://evil.example"}, {"Origin": "null"}, {"Host": "evil.example"}):
        assert request(server, "POST", f"/{server.token}/decide", body, **json_, **headers)[0] == 403
    for path in ("../decide", "decide/", "decide?x", "decisions.csv", "review/../decide", "%64ecide"):
        assert request(server, "POST", f"/{server.token}/{path}", body, **json_)[0] == 404
        assert request(server, "GET", f"/{server.token}/{path}")[0] == 404
    assert request(server, "POST", f"/{server.token}/decide", b"[]", **json_)[0] == 400
    assert not (tmp_path / "decisions.csv").exists()


def test_the_pages_know_each_other(page: Any, serve: Serve, reviewed: FlexMapConfig) -> None:
    server = serve(reviewed)
    opened(page, server)
    page.click(".nav >> text=Control points")
    ready(page)
    assert page.locator("body.editor").count() == 1
    page.click(".nav >> text=Review")
    ready(page)
    assert page.locator("#stepper").count() == 1
    assert page.complaints == []
