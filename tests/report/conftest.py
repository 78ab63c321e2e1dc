"""A real browser with the network cut."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from report_runs import garching_inputs, made

from flexmap_tasks.report.report import report

sync_api = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed: pip install playwright"
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("no browser: chromium is not installed (apt-get install chromium)")
    with sync_api.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=found, args=["--no-sandbox", "--disable-gpu"])
        yield chromium
        chromium.close()


@pytest.fixture(scope="session")
def garching(shared_data: Path) -> dict[str, Any]:
    """What the report of Garching is made of."""
    return garching_inputs(shared_data / "garching")


class Opened:
    """A report in the browser, and everything the browser complained of or asked for."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.complaints: list[str] = []
        self.requests: list[str] = []
        page.on(
            "console", lambda m: self.complaints.append(m.text) if m.type in ("error", "warning") else None
        )
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))

    def pixels(self) -> list[int]:
        """All bytes of the map's canvas, summed per column of a coarse grid."""
        return list(self.page.evaluate(PIXELS))


PIXELS = """() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => {
    const canvas = document.querySelector('#map canvas');
    const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext('2d', { willReadFrequently: true });
    copy.drawImage(canvas, 0, 0);
    const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
    const sums = new Array(64).fill(0);
    for (let i = 0; i < data.length; i += 4) if (data[i + 3]) {
        sums[(i >> 2) % 64] += data[i] + 3 * data[i + 1] + 7 * data[i + 2] + data[i + 3];
    }
    done(sums);
})))"""


@pytest.fixture
def open_report(browser: Any, tmp_path: Path) -> Iterator[Any]:
    """Opens inputs of the report in a window of 1400 x 900 pixels."""
    windows = []

    def opened(inputs: dict[str, Any], address: str = "") -> Opened:
        file = tmp_path / "report.html"
        file.write_bytes(made(report, inputs)["report.html"])
        window = browser.new_context(
            viewport={"width": 1400, "height": 900}, offline=True, accept_downloads=True
        )
        windows.append(window)
        shown = Opened(window.new_page())
        shown.page.goto(file.as_uri() + address)
        shown.page.wait_for_selector("html[data-ready=yes]", state="attached", timeout=20_000)
        return shown

    yield opened
    for window in windows:
        window.close()
