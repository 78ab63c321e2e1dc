"""The fleet's pages on Prefect's dashboard, as a person sees them in headless Chromium."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from fleet_server import Server
from playwright.sync_api import sync_playwright

WINDOW = {"width": 1280, "height": 900}
PATIENCE_MS = 240_000
"""The server may share its machine with a night of updates."""


def take(server: Server, run_id: str, folder: Path, words: list[str]) -> None:
    """Pictures of an update's run, its report and its table; all of `words` must be read on the report."""
    folder.mkdir(parents=True, exist_ok=True)
    wanted = {"key": {"any_": ["towns-fleet-report"]}}
    report = server.ask("/artifacts/filter", artifacts=wanted, sort="CREATED_DESC")[0]["id"]
    with sync_playwright() as driver:
        chromium = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        page = chromium.new_context(viewport=WINDOW, color_scheme="dark").new_page()
        page.goto(f"{server.url}/runs/flow-run/{run_id}")
        _wait_for(page, words[:1])
        page.wait_for_timeout(4_000)  # the graph draws itself
        page.screenshot(path=folder / "fleet_update.png")
        page.goto(f"{server.url}/artifacts/artifact/{report}")
        _wait_for(page, words)
        page.wait_for_timeout(1_000)
        page.screenshot(path=folder / "fleet_report.png")
        chromium.close()


def _wait_for(page: Any, words: list[str]) -> None:
    for word in words:
        page.get_by_text(word, exact=False).first.wait_for(timeout=PATIENCE_MS)
