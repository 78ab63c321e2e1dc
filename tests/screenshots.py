"""Pictures of report and editor for the README, of the demo: python -m tests.screenshots STORE FOLDER."""

from __future__ import annotations

import shutil
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
from playwright.sync_api import sync_playwright

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.store.store import Store
from flows.commands import PROJECT, demo_inputs
from flows.editor.editors import edit_server

WINDOW = {"width": 1400, "height": 900}
READY = "html[data-ready=yes]"
PICKED = (0.12, 0.4, 0.75)
"""Shares of the drive at which control points are picked."""


def main(store_folder: str, folder: Path) -> None:
    """The latest release of the demo must be in the store; nothing is saved."""
    demo = Path(store_folder) / "demo"
    config = load_config(FlexMapConfig, PROJECT / "configs" / "demo.yaml", demo_inputs(demo))
    release = (Path(store_folder) / "releases" / "demo" / "latest").resolve()
    folder.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as driver, edit_server(config, Store.open(store_folder)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        chromium = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        taken(opened(chromium, (release / "report.html").as_uri()), folder / "report.png")
        page = opened(chromium, f"{server.address}review")
        page.keyboard.press("n")
        page.click("[data-tab=review]")
        taken(page, folder / "review.png")
        page = opened(chromium, server.address)
        pick(page, places(release))
        taken(page, folder / "editor.png")
        chromium.close()
        server.shutdown()


def opened(chromium: Any, address: str) -> Any:
    """A page that has drawn."""
    page = chromium.new_context(viewport=WINDOW, color_scheme="light").new_page()
    page.goto(address, timeout=120_000)
    page.wait_for_selector(READY, state="attached", timeout=120_000)
    return page


def places(release: Path) -> list[tuple[float, float]]:
    """Some places of the drive, metres in the map frame."""
    track = pq.read_table(release / "gnss_track.parquet", columns=["x_m", "y_m"])
    rows = [int(share * track.num_rows) for share in PICKED]
    return [(track["x_m"][row].as_py(), track["y_m"][row].as_py()) for row in rows]


def pick(page: Any, wanted: Sequence[tuple[float, float]]) -> None:
    """Control points at these places, with the partners that the editor suggests."""
    box = page.locator("#map").bounding_box()
    told = []
    for share in (0.2, 0.8):
        x, y = box["x"] + share * box["width"], box["y"] + share * box["height"]
        page.mouse.move(x, y)
        words = page.inner_text("#readout").split()
        told.append((x, y, float(words[1]), float(words[3])))
    (x0, y0, a0, b0), (x1, y1, a1, b1) = told
    page.keyboard.press("a")
    for a, b in wanted:
        page.mouse.click(x0 + (a - a0) * (x1 - x0) / (a1 - a0), y0 + (b - b0) * (y1 - y0) / (b1 - b0))
        page.keyboard.press("Enter")
    page.keyboard.press("Escape")
    page.wait_for_timeout(4_000)


def taken(page: Any, file: Path) -> None:
    """A picture once everything stands still."""
    page.wait_for_timeout(600)
    page.screenshot(path=file)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
