"""Pictures of report and editor for the documentation: python -m tests.screenshots CONFIG STORE FOLDER."""

from __future__ import annotations

import shutil
import sys
import threading
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.store.store import Store
from flows.editor.editors import edit_server

WINDOW = {"width": 1400, "height": 900}
VIEWS = {"report_overview": ("1", "light"), "report_alignment": ("2", "light"), "report_lanes": ("4", "dark")}
READY = "html[data-ready=yes]"


def main(config_file: Path, store_folder: str, folder: Path) -> None:
    """The latest release of the map must be in the store."""
    config = load_config(FlexMapConfig, config_file)
    store = Store.open(store_folder)
    report = (Path(store_folder) / "releases" / config.map / "latest" / "report.html").resolve()
    folder.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as driver:
        chromium = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        for name, (key, scheme) in VIEWS.items():
            page = opened(chromium, report.as_uri(), scheme)
            page.keyboard.press(key)
            taken(page, folder / f"{name}.png")
        page = opened(chromium, report.as_uri(), "light")
        page.keyboard.press("5")
        page.keyboard.press("n")
        page.click("[data-tab=review]")
        taken(page, folder / "report_review.png")
        if config.alignment.control_points_file is not None:
            with edit_server(config, store) as server:
                threading.Thread(target=server.serve_forever, daemon=True).start()
                taken(opened(chromium, server.address, "light"), folder / "editor.png")
                server.shutdown()
        chromium.close()


def opened(chromium: Any, address: str, scheme: str) -> Any:
    """A page that has drawn."""
    page = chromium.new_context(viewport=WINDOW, color_scheme=scheme).new_page()
    page.goto(address)
    page.wait_for_selector(READY, state="attached", timeout=60_000)
    return page


def taken(page: Any, file: Path) -> None:
    """A picture once everything stands still."""
    page.wait_for_timeout(600)
    page.screenshot(path=file)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]))
