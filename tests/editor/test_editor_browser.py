"""Control points picked with the mouse, saved, and used by the next run."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.local import run_local
from flexmap_tasks.formats.artifacts import decode
from flexmap_tasks.model.alignment import ControlPoints
from flexmap_tasks.model.quality import Quality
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.store.store import ArtifactFiles, Store
from flows.editor.server import EditServer

Serve = Callable[[FlexMapConfig], EditServer]


def opened(page: Any, server: EditServer) -> Any:
    page.goto(server.address)
    page.wait_for_selector("html[data-ready=yes]", state="attached", timeout=30_000)
    return page


def to_screen(page: Any) -> Callable[[Any], tuple[float, float]]:
    """Where a place in metres lies on the screen, learnt from what the page says under the mouse."""
    box = page.locator("#map").bounding_box()
    told = []
    for share in (0.2, 0.8):
        x, y = box["x"] + share * box["width"], box["y"] + share * box["height"]
        page.mouse.move(x, y)
        words = page.inner_text("#readout").split()
        told.append((x, y, float(words[1]), float(words[3])))
    (x0, y0, a0, b0), (x1, y1, a1, b1) = told
    return lambda place: (
        x0 + (place[0] - a0) * (x1 - x0) / (a1 - a0),
        y0 + (place[1] - b0) * (y1 - y0) / (b1 - b0),
    )


def until(condition: Callable[[], bool]) -> None:
    """Waits for what the page shows; the page's own policy forbids to wait inside of it."""
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, "the page did not come to it"
        time.sleep(0.05)


def said(page: Any, words: str) -> bool:
    return words in page.inner_text("#message")


def shown_rmse(page: Any) -> float:
    return float(page.inner_text("#figures .chip:nth-child(2) b").split()[0])


def run(store: Store, config: FlexMapConfig) -> tuple[ControlPoints, Quality]:
    outcomes = run_local(store, map_update(config))
    points, quality = (
        decode(kind, ArtifactFiles(store, outcomes[stage].artifact), name)
        for kind, stage, name in (
            (ControlPoints, "control_points", "control_points"),
            (Quality, "evaluate", "quality"),
        )
    )
    return points, quality


def test_ten_points_picked_with_the_mouse_reach_the_next_run(
    page: Any, serve: Serve, config: FlexMapConfig, store: Store
) -> None:
    wanted, before = run(store, config)
    file = config.alignment.control_points_file
    assert file is not None
    file.unlink()
    opened(page, serve(config))
    assert page.locator("#rows tr").count() == 0
    place = to_screen(page)
    page.keyboard.press("a")
    for i in range(10):
        page.mouse.click(*place(wanted.source_xy_m[i]))
        page.mouse.click(*place(wanted.target_xy_m[i]))
    page.keyboard.press("Escape")
    until(lambda: page.locator("#rows tr").count() == 10)
    until(lambda: shown_rmse(page) < 3)
    page.wait_for_timeout(500)
    rmse = shown_rmse(page)
    page.click("#save")
    until(lambda: said(page, "saved 10 pairs"))
    assert page.is_disabled("#save")
    points, quality = run(store, config)
    assert quality.value("deviation_after_all_rmse") == pytest.approx(rmse, abs=0.0015)
    assert rmse < 0.5 * float(quality.value("deviation_before_all_rmse") or 0)
    assert np.hypot(*(points.target_xy_m - wanted.target_xy_m).T).max() < 2.0
    assert abs(rmse - float(before.value("deviation_after_all_rmse") or 0)) < 0.5
    assert page.complaints == []


def test_undo_redo_exclude_and_sigma(page: Any, serve: Serve, config: FlexMapConfig) -> None:
    opened(page, serve(config))
    first = shown_rmse(page)
    page.click("#rows tr:nth-child(3) input[type=checkbox]")
    until(lambda: shown_rmse(page) != first)
    assert shown_rmse(page) > first
    assert "lanelets change by more than 10 cm" in page.inner_text("#widths")
    page.keyboard.press("Control+z")
    until(lambda: shown_rmse(page) == first)
    assert page.is_disabled("#save")
    page.keyboard.press("Control+y")
    assert not page.is_checked("#rows tr:nth-child(3) input[type=checkbox]")
    page.fill("#rows tr:nth-child(1) input[type=number]", "0.25")
    page.keyboard.press("Tab")
    page.click("#save")
    until(lambda: said(page, "saved"))
    file = config.alignment.control_points_file
    assert file is not None
    lines = file.read_text().splitlines()
    assert ",0.25,yes," in lines[1]
    assert ",no," in lines[3]


def test_a_handle_is_dragged_and_a_pair_removed(page: Any, serve: Serve, config: FlexMapConfig) -> None:
    opened(page, serve(config))
    place, first = to_screen(page), shown_rmse(page)
    from flexmap_tasks.formats.control_points_csv import read_control_points  # noqa: PLC0415
    from flexmap_tasks.model.source import Source  # noqa: PLC0415

    file = config.alignment.control_points_file
    assert file is not None
    target = next(p for p in read_control_points(Source("p", file))[7].target if p.kind == "target_x_m")
    x, y = place(target.values)
    page.mouse.move(x, y)
    page.mouse.down()
    page.keyboard.down("Alt")
    page.mouse.move(x + 30, y + 20, steps=4)
    page.mouse.up()
    page.keyboard.up("Alt")
    until(lambda: shown_rmse(page) > first)
    page.keyboard.press("Delete")
    until(lambda: page.locator("#rows tr").count() == 9)
    assert page.complaints == []


def test_two_editors_are_told_apart(page: Any, serve: Serve, config: FlexMapConfig, tmp_path: Path) -> None:
    opened(page, serve(config))
    page.click("#rows tr:nth-child(1) .close")
    file = tmp_path / "points.csv"
    file.write_text(file.read_text() + "\n")
    theirs = file.read_bytes()
    page.click("#save")
    until(lambda: said(page, "changed by someone else"))
    assert file.read_bytes() == theirs
    assert not page.is_disabled("#save")


def test_what_the_pipeline_would_refuse_is_not_saved(
    page: Any, serve: Serve, config: FlexMapConfig, tmp_path: Path
) -> None:
    opened(page, serve(config))
    for _ in range(8):
        rows = page.locator("#rows tr").count()
        page.click("#rows tr:nth-child(1) .close")
        until(lambda rows=rows: page.locator("#rows tr").count() == rows - 1)
    before = (tmp_path / "points.csv").read_bytes()
    page.click("#save")
    until(lambda: page.locator("#message.bad").count() == 1)
    assert (tmp_path / "points.csv").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["points.csv"]


def test_hostile_names_are_text(page: Any, serve: Serve, config: FlexMapConfig, tmp_path: Path) -> None:
    file = tmp_path / "points.csv"
    lines = file.read_text().splitlines()
    lines[1] = '"<img src=x onerror=window.hacked=1>"' + lines[1][1:]
    lines[2] = "\u202e</script><script>window.hacked=1</script>" + lines[2][1:]
    file.write_text("\n".join(lines) + "\n")
    opened(page, serve(config))
    page.wait_for_timeout(200)
    assert page.evaluate("window.hacked") is None
    assert "<img src=x" in page.inner_text("#rows")
    assert page.inner_text("#title") == config.map
    assert page.complaints == []


def test_automatic_points_are_shown_and_overridden(
    page: Any, serve: Serve, config: FlexMapConfig, store: Store
) -> None:
    settings = config.model_dump(mode="json")
    settings["alignment"]["control_points"]["automatic"] = {"count": 8}
    config = FlexMapConfig.model_validate(settings)
    file = config.alignment.control_points_file
    assert file is not None
    file.unlink()
    opened(page, serve(config))
    count = page.locator("#rows tr").count()
    assert page.locator("#rows .auto").count() == count >= 3
    names = [text.split()[0:2] for text in page.locator("#rows td:nth-child(2)").all_inner_texts()]
    page.click("#rows tr:nth-child(1) input[type=checkbox]")
    page.click("#rows tr:nth-child(2) .close")
    page.click("#save")
    until(lambda: said(page, "saved 2 pairs"))
    lines = file.read_text().splitlines()
    assert len(lines) == 3
    assert all(",no," in line for line in lines[1:])
    points, _ = run(store, config)
    left_out = set(points.label[~points.used].tolist())
    assert {line.split(",")[0] for line in lines[1:]} <= left_out
    assert len(points) >= count, names
    assert page.complaints == []
