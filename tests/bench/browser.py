"""The report in a headless browser on this machine, without a GPU: first paint, frames while panning, size of the file.

Wall clock, for that is what a person waits for; the best of three.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any

from tests.bench.measure import DATA, PROJECT, console, show

LANELETS = 10_000
MOVES, STEP_PX = 150, 7
FRAMES = """() => { window.frames_ = []; const tick = (t) => { window.frames_.push(t); requestAnimationFrame(tick); };
    requestAnimationFrame(tick); }"""


def run() -> None:
    """Garching, and the same town side by side until there are 10,000 lanelets."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        console.print("no browser: chromium is not installed (apt-get install chromium); nothing to measure")
        return
    sys.path.insert(0, str(PROJECT / "tests" / "report"))
    from report_large import many  # noqa: PLC0415 - the runs of the tests of the report
    from report_runs import garching_inputs  # noqa: PLC0415

    inputs = garching_inputs(DATA / "garching")
    copies = -(-LANELETS // len(inputs["lane_check"].lanelet_id))
    with tempfile.TemporaryDirectory() as folder:
        rows = _measured(chromium, Path(folder) / "garching.html", inputs, "Garching", "1 s")
        large = many(inputs, copies)
        rows += _measured(chromium, Path(folder) / "large.html", large, f"{LANELETS:,} lanelets", "3 s")
    show("The report in a browser", rows)


def _measured(
    chromium: str, file: Path, inputs: dict[str, Any], name: str, paint_goal: str
) -> list[tuple[str, str, str]]:
    from report_runs import made  # noqa: PLC0415 - see above

    from flexmap_tasks.report.report import report  # noqa: PLC0415

    file.write_bytes(made(report, inputs)["report.html"])
    seen = [_opened(chromium, file) for _ in range(3)]
    driven_km = _driven_km(inputs)
    size_mb = file.stat().st_size / 1e6
    return [
        (f"{name}: first paint", f"{min(s[0] for s in seen):.2f} s", f"at most {paint_goal}"),
        (f"{name}: map drawn, panel filled", f"{min(s[1] for s in seen):.2f} s", ""),
        (f"{name}: frames while panning and zooming", f"{max(s[2] for s in seen):.0f} a second", "over 30"),
        (f"{name}: longest wait between two frames", f"{min(s[3] for s in seen) * 1e3:.0f} ms", ""),
        (f"{name}: size ({driven_km:.1f} km)", f"{size_mb:.2f} MB", "below 15 MB for 5 km"),
    ]


def _driven_km(inputs: dict[str, Any]) -> float:
    from flexmap_tasks.geometry.polyline import arc_length_m  # noqa: PLC0415 - see above

    return float(arc_length_m(inputs["slam"].xyz_m[:, :2])[-1]) / 1e3


def _opened(chromium: str, file: Path) -> tuple[float, float, float, float]:
    """Seconds to the first paint and until all is there, frames a second, and the longest wait in seconds."""
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 - see above

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.goto(file.as_uri())
        page.wait_for_selector("html[data-ready=yes]", state="attached", timeout=120_000)
        page.wait_for_timeout(300)
        paint_ms = page.evaluate("performance.getEntriesByName('first-contentful-paint')[0].startTime")
        done_ms = page.evaluate("performance.getEntriesByType('navigation')[0].domContentLoadedEventEnd")
        page.keyboard.press("4")
        box = page.locator("#map").bounding_box()
        assert box is not None
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(x, y)
        page.evaluate(FRAMES)
        page.mouse.down()
        for i in range(MOVES):
            page.mouse.move(x + (i % 50 - 25) * STEP_PX, y + (i % 30 - 15) * STEP_PX)
        page.mouse.up()
        for i in range(6):
            page.mouse.wheel(0, 120 if i % 2 else -120)
            page.wait_for_timeout(120)
        times = page.evaluate("window.frames_")
        browser.close()
    waits = [(b - a) / 1e3 for a, b in pairwise(times)]
    return paint_ms / 1e3, done_ms / 1e3, len(waits) / sum(waits), max(waits)
