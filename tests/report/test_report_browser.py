"""The report as a person meets it: opened from disk in a real browser without a network."""

from __future__ import annotations

import csv
import dataclasses
import io
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pydantic import ValidationError
from report_large import many
from report_runs import garching as garching_config
from report_runs import inputs_of, made

from flexmap_tasks.config import TilesParams
from flexmap_tasks.formats.review_decisions_csv import decisions_of
from flexmap_tasks.model.alignment import Warp
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.bend import Bend
from flexmap_tasks.model.conflation import RoadChanges
from flexmap_tasks.model.osm import Tags
from flexmap_tasks.model.pose_graph import HeldOut
from flexmap_tasks.model.review import Decided
from flexmap_tasks.report.report import report
from flexmap_tasks.report.review_items import review_items

HOSTILE = [
    "<script>window.hacked = 1</script>",
    "</script><script>window.hacked = 1</script>",
    "<!--<script>",
    "<img src=x onerror='window.hacked = 1'>",
    '"\' onmouseover="window.hacked=1" x=\'',
    "\u202eright to left\u202c שלום مرحبا",
    "\u2028line\u2029paragraph\x00\x1b[31m",
    '=HYPERLINK("http://evil")',
    "x" * 10_000,
    "\ud800 half a pair",
]
LAYERS = [
    "roads", "before", "after", "lanes", "changed", "sheet", "gnss", "slam_before", "slam_after", "links", "points",
    "review", "findings", "ties",
]  # fmt: skip


@pytest.fixture
def shown(open_report: Callable[..., Any], garching: dict[str, Any]) -> Any:
    return open_report(garching)


def test_it_opens_from_disk_without_a_complaint_or_a_request(shown: Any) -> None:
    assert shown.complaints == []
    assert [url for url in shown.requests if not url.startswith(("file:", "data:"))] == []
    assert shown.page.inner_text("#title") == "garching"
    assert "7.92 → 1.85" in shown.page.inner_text("#figures")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_layer_draws(shown: Any, scheme: str) -> None:
    shown.page.emulate_media(color_scheme=scheme)
    boxes = {
        box.get_attribute("id").removeprefix("layer-")
        for box in shown.page.query_selector_all("#layers input")
    }
    assert boxes == set(LAYERS)
    for box in shown.page.query_selector_all("#layers input:checked"):
        box.uncheck()
    assert not any(shown.pixels())
    seen = []
    for name in LAYERS:
        shown.page.check(f"#layer-{name}")
        seen.append(shown.pixels())
        assert any(seen[-1]), f"{name} draws nothing"
        shown.page.uncheck(f"#layer-{name}")
    assert len({tuple(s) for s in seen}) == len(LAYERS)
    assert shown.complaints == []


def adjusted(inputs: dict[str, Any]) -> dict[str, Any]:
    """As if a pose graph had moved the drive, GNSS had been withheld, and OSM had changed."""
    slam, motion = inputs["slam"], inputs["warp"].motion
    n, zero = len(slam), np.zeros(len(slam))
    source = np.ascontiguousarray(slam.xyz_m[:, :2])
    target = motion.apply_xy(source) + np.column_stack([zero + 1.0, np.linspace(0, 3, n)])
    bend = Bend.level(
        source, target, zero + motion.angle_rad, zero + 1, zero, np.linspace(0.01, 0.4, n), zero, zero + 8.0
    )
    rows = np.arange(0, n, 2)
    error = np.linspace(0.02, 0.3, len(rows))
    ways, words = inputs["roads"].way_id[:4], strings(["", "", "", "50"])
    lonlat = inputs["roads"].lonlat_deg[inputs["roads"].offset[:4]]
    changes = RoadChanges(
        ways, strings(["geometry", "gone", "new", "tag"]), strings(["", "", "", "maxspeed"]), words,
        strings(["", "", "", HOSTILE[0]]), np.array([7.5, np.nan, np.nan, np.nan]), np.array([1, 2, 0, 4]), np.array([2, 0, 1, 5]),
        strings(["2020-01-01T00:00:00Z"] * 4), strings(["2024-01-01T00:00:00Z"] * 4), strings(["", "", "", "665 823"]),
        lonlat[:, 0], lonlat[:, 1],
    )  # fmt: skip
    return inputs | {
        "warp": Warp(motion, None, bend=bend), "held_out": HeldOut(rows, rows * 1.0, error, error * 0.8), "changes": changes,
    }  # fmt: skip


def test_a_pose_graph_shows_its_corrections_sigma_and_reliability(
    open_report: Callable[..., Any], garching: dict[str, Any]
) -> None:
    shown = open_report(adjusted(garching))
    for box in shown.page.query_selector_all("#layers input:checked"):
        box.uncheck()
    for name in ("sigma", "corrections", "ties", "changes"):
        shown.page.check(f"#layer-{name}")
        assert any(shown.pixels()), f"{name} draws nothing"
        shown.page.uncheck(f"#layer-{name}")
    shown.page.click("[data-tab=reliability]")
    assert shown.page.locator("#panel canvas").count() == 2
    shown.page.click("[data-tab=changes]")
    assert [(r["what"], r["now"]) for r in _export(shown)][3] == ("tag", HOSTILE[0])
    assert shown.complaints == []


def test_changes_of_osm_are_reviewed_and_kept(
    open_report: Callable[..., Any], garching: dict[str, Any]
) -> None:
    shown = open_report(adjusted(garching))
    shown.page.keyboard.press("p")
    assert "OSM change" in shown.page.inner_text("#inspector .question small")
    assert HOSTILE[0] in shown.page.inner_text("#inspector .question")
    shown.page.keyboard.press("y")
    with shown.page.expect_download() as waiting:
        shown.page.keyboard.press("Control+s")
    (row,) = csv.DictReader(io.StringIO(Path(waiting.value.path()).read_text("utf-8-sig"), newline=""))
    assert (row["kind"], row["key"], row["new"], row["decision"]) == (
        "change",
        "maxspeed",
        HOSTILE[0],
        "accept",
    )
    nothing = decisions_of([])
    decided = Decided(nothing, nothing, nothing, nothing, decisions_of([row]))
    again = open_report(adjusted(garching) | {"decided": decided})
    assert again.page.locator("#stepper span").inner_text().split()[0] == str(
        int(shown.page.inner_text("#figures .is-review b"))
    )
    again.page.click("[data-tab=decisions]")
    assert again.page.locator("#panel .is-holds").count() == 1
    assert again.complaints == []


def test_views_switch_layers_and_legends(shown: Any) -> None:
    shown.page.keyboard.press("4")
    assert shown.page.is_checked("#layer-lanes")
    assert not shown.page.is_checked("#layer-points")
    legend = shown.page.inner_text("#legend")
    assert all(word in legend for word in ("agree", "differ", "unknown", "unmatched"))
    assert shown.page.get_attribute("[data-view='3']", "aria-pressed") == "true"


def test_search_shows_a_lanelet_with_both_values_and_their_source(
    shown: Any, garching: dict[str, Any]
) -> None:
    table = garching["transfers"]
    row = np.flatnonzero((table.action == "set") & (table.key == "speed_limit") & (table.old != ""))[0]
    shown.page.fill("#search", str(table.lanelet_id[row]))
    shown.page.keyboard.press("Enter")
    text = shown.page.inner_text("#inspector")
    assert f"{table.way_id[row]}" in text
    assert f"v{table.way_version[row]}, {table.way_timestamp[row][:10]}" in text
    assert table.reason[row] in text
    cells = (
        shown.page.locator("#inspector .tags tr", has_text="speed_limit")
        .first.locator("td")
        .all_inner_texts()
    )
    assert [c.strip() for c in cells] == [table.old[row], table.new[row]]
    assert f"lanelet={table.lanelet_id[row]}" in shown.page.evaluate("location.hash")


def test_search_finds_names_and_says_when_there_is_nothing(shown: Any) -> None:
    shown.page.fill("#search", "boltzmann")
    assert shown.page.locator("#found button").count() == 12
    shown.page.fill("#search", "no such thing anywhere")
    assert shown.page.inner_text("#found") == "Nothing found"


def test_a_click_on_the_map_selects_what_is_there(shown: Any, garching: dict[str, Any]) -> None:
    wanted = int(garching["lane_check"].lanelet_id[0])
    shown.page.fill("#search", str(wanted))
    shown.page.keyboard.press("Enter")
    shown.page.keyboard.press("Escape")
    assert "What this run did" in shown.page.inner_text("#inspector")
    box = shown.page.locator("#map").bounding_box()
    shown.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert "Lanelet" in shown.page.inner_text("#inspector .heading")


def test_keys_step_through_the_review(shown: Any, garching: dict[str, Any]) -> None:
    total = int(
        (garching["matches"].decision == "review").sum()
        + (garching["transfers"].action == "review").sum()
        + (garching["lane_check"].verdict == "differ").sum()
    )
    shown.page.keyboard.press("n")
    assert f"Review 1 of {total}" in shown.page.inner_text("#inspector .question")
    first = shown.page.inner_text("#inspector h2")
    shown.page.keyboard.press("n")
    shown.page.keyboard.press("p")
    assert shown.page.inner_text("#inspector h2") == first
    shown.page.keyboard.press("p")
    assert shown.page.inner_text("#step") == f"{total} of {total}"


def test_an_address_leads_back_to_place_and_selection(
    open_report: Callable[..., Any], garching: dict[str, Any]
) -> None:
    one = int(garching["lane_check"].lanelet_id[5])
    shown = open_report(garching, f"#at=10.0,20.0,1.50&lanelet={one}")
    assert shown.page.inner_text("#inspector h2") == str(one)
    assert shown.page.evaluate("location.hash") == f"#at=10.0,20.0,1.50&lanelet={one}"
    shown.page.evaluate("location.hash = '#at=x,<script>&lanelet=nothing&item=9999999'")
    shown.page.wait_for_timeout(100)
    assert shown.complaints == []


def test_the_filter_rules_layer_and_table(shown: Any, garching: dict[str, Any]) -> None:
    table = garching["transfers"]
    shown.page.select_option("#filter-key", "road_surface")
    shown.page.click("#filter-actions [data-action=set]")
    shown.page.click("#filter-actions [data-action=review]")
    rows = (table.key == "road_surface") & (table.action == "review")
    assert shown.page.inner_text("#filter-count").startswith(f"{rows.sum()} decisions on")
    shown.page.click("[data-tab=transfers]")
    assert len(_export(shown)) == rows.sum()


def test_tables_sort_filter_and_export_all_rows(shown: Any, garching: dict[str, Any], tmp_path: Path) -> None:
    shown.page.click("[data-tab=lanes]")
    check = garching["lane_check"]
    rows = _export(shown)
    assert [(r["lanelet"], r["verdict"], r["why"]) for r in rows] == [
        (str(i), v, w) for i, v, w in zip(check.lanelet_id, check.verdict, check.reason, strict=True)
    ]
    shown.page.locator("#panel th", has_text="lanelet").click()
    assert [int(r["lanelet"]) for r in _export(shown)] == sorted(check.lanelet_id.tolist())
    shown.page.fill("#table-filter", "agree")
    assert {r["verdict"] for r in _export(shown)} == {"agree"}


def test_every_tab_opens(shown: Any) -> None:
    for name in ("quality", "transfers", "review", "lanes", "points", "findings"):
        shown.page.click(f"[data-tab={name}]")
        assert shown.page.locator("#panel tbody td").count() > 3, name
    shown.page.click("[data-tab=deviation]")
    assert shown.page.locator("#panel canvas").count() == 2
    assert shown.complaints == []


@pytest.mark.parametrize("width", [1400, 900, 640])
def test_nothing_lies_over_anything_else(shown: Any, width: int) -> None:
    shown.page.set_viewport_size({"width": width, "height": 900})
    shown.page.keyboard.press("n")
    shown.page.wait_for_timeout(200)
    boxes = {
        name: shown.page.locator(name).bounding_box() for name in ("#stage", "#inspector", "#drawer", "#side")
    }
    there = {name: box for name, box in boxes.items() if box is not None}
    assert len(there) >= 3
    for name, a in there.items():
        assert a["width"] >= 150, name
        assert a["height"] >= 150, name
        assert a["x"] + a["width"] <= width + 1
        for other, b in there.items():
            apart = a["x"] + a["width"] <= b["x"] + 1 or b["x"] + b["width"] <= a["x"] + 1
            apart |= a["y"] + a["height"] <= b["y"] + 1 or b["y"] + b["height"] <= a["y"] + 1
            assert apart or other == name, (name, other)


def test_hostile_text_is_shown_as_text(open_report: Callable[..., Any], garching: dict[str, Any]) -> None:
    shown = open_report(poisoned(garching))
    for i in range(len(HOSTILE)):
        shown.page.fill("#search", str(int(garching["roads"].way_id[i])))
        shown.page.keyboard.press("Enter")
        text = shown.page.locator("#inspector").inner_text()
        start = HOSTILE[i].replace("\ud800", "?").replace("\x00", "\ufffd")[:12].split("\u2028")[0]
        assert start.strip() in text or "\u2028" in HOSTILE[i], HOSTILE[i][:30]
    shown.page.keyboard.press("n")
    for tab in ("transfers", "review", "findings", "lanes", "points"):
        shown.page.click(f"[data-tab={tab}]")
    assert shown.page.evaluate("window.hacked") is None
    assert shown.page.locator("img").count() == 0
    assert shown.page.evaluate("document.documentElement.scrollWidth") <= 1400
    assert shown.complaints == []


def test_formulas_are_defused_in_exports(open_report: Callable[..., Any], garching: dict[str, Any]) -> None:
    shown = open_report(poisoned(garching))
    shown.page.click("#filter-actions [data-action=review]")
    shown.page.click("[data-tab=transfers]")
    cells = [cell for row in _export(shown) for cell in row.values()]
    assert any("HYPERLINK" in cell for cell in cells)
    assert not [cell for cell in cells if cell.startswith(("=", "+", "@"))]


def test_ten_thousand_lanelets_open_and_select(
    open_report: Callable[..., Any], garching: dict[str, Any]
) -> None:
    shown = open_report(many(garching, 23))
    last = str(int(garching["lane_check"].lanelet_id[0]) + 22 * 1_000_000_000)
    shown.page.fill("#search", last)
    shown.page.keyboard.press("Enter")
    assert shown.page.inner_text("#inspector h2") == last
    assert any(shown.pixels())
    assert shown.complaints == []


def test_a_run_without_maps_shows_its_drive(
    open_report: Callable[..., Any], garching: dict[str, Any]
) -> None:
    names = ("control_points", "source_map", "final_map", "roads", "matches", "transfers", "lane_check",
             "map_findings", "transfer_findings")  # fmt: skip
    shown = open_report(garching | dict.fromkeys(names))
    assert any(shown.pixels())
    shown.page.keyboard.press("n")
    shown.page.keyboard.press("3")
    assert shown.complaints == []


def _export(shown: Any) -> list[dict[str, str]]:
    with shown.page.expect_download() as waiting:
        shown.page.click("#export")
    text = Path(waiting.value.path()).read_text(encoding="utf-8-sig")
    return list(csv.DictReader(io.StringIO(text, newline="")))


def poisoned(inputs: dict[str, Any]) -> dict[str, Any]:
    """Hostile text wherever a map can bring text in."""

    def cycle(n: int) -> Any:
        return strings(HOSTILE[i % len(HOSTILE)] for i in range(n))

    roads, transfers, check = inputs["roads"], inputs["transfers"], inputs["lane_check"]
    tags = roads.tags
    poisoned_tags = Tags(
        tags.offset, tags.key, strings(HOSTILE[i % len(HOSTILE)] for i in tags.owner().tolist())
    )
    findings, points = inputs["transfer_findings"], inputs["control_points"]
    return inputs | {
        "roads": dataclasses.replace(roads, tags=poisoned_tags, timestamp=cycle(len(roads))),
        "transfers": dataclasses.replace(
            transfers,
            new=cycle(len(transfers.new)),
            old=cycle(len(transfers.new)),
            reason=cycle(len(transfers.new)),
            key=strings("<b>" + k for k in transfers.key),
            way_timestamp=cycle(len(transfers.new)),
        ),
        "lane_check": dataclasses.replace(check, reason=cycle(len(check.reason))),
        "transfer_findings": dataclasses.replace(
            findings, message=cycle(len(findings)), code=cycle(len(findings))
        ),
        "control_points": dataclasses.replace(points, label=cycle(len(points)), reason=cycle(len(points))),
    }


def test_a_decision_made_in_the_report_reaches_the_next_release(
    shown: Any, garching: dict[str, Any], shared_data: Path, tmp_path: Path
) -> None:
    kinds = review_items(garching["matches"], garching["transfers"], garching["lane_check"]).kind
    first = int(np.flatnonzero(kinds == "value")[0])
    shown.page.evaluate(f"location.hash = '#item={first + 1}'")
    shown.page.locator(".decide").wait_for()
    shown.page.keyboard.press("y")
    assert shown.page.inner_text("#decided") == "Save 1 decision"
    with shown.page.expect_download() as waiting:
        shown.page.click("#decided")
    file = tmp_path / "decisions.csv"
    file.write_bytes(Path(waiting.value.path()).read_bytes())
    config = garching_config(shared_data / "garching", conflation={"review_file": str(file)})
    after = inputs_of(config, "report")["report"]["transfers"]
    accepted = [reason.startswith("accepted by a person") for reason in after.reason]
    assert sum(accepted) == 1
    assert (after.action == "review").sum() == (garching["transfers"].action == "review").sum() - 1
    assert shown.complaints == []


@pytest.fixture
def tile_server() -> Iterator[tuple[str, list[str]]]:
    """A server of grey tiles, and the paths it was asked for."""
    asked: list[str] = []
    buffer = io.BytesIO()
    Image.new("RGB", (256, 256), (90, 120, 90)).save(buffer, "PNG")

    class Tiles(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            self.send_response(200)
            self.send_header("Content-Type", "image/png")
            self.end_headers()
            self.wfile.write(buffer.getvalue())

        def log_message(self, *args: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Tiles)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}/t/{{z}}/{{x}}/{{y}}.png", asked
    server.shutdown()
    server.server_close()


def test_a_background_is_asked_for_only_when_it_is_switched_on(
    browser: Any, garching: dict[str, Any], tmp_path: Path, tile_server: tuple[str, list[str]]
) -> None:
    url, asked = tile_server
    background = TilesParams(url=url, attribution="<b>tiles</b> of a test")
    params = garching["params"].model_copy(update={"background": background})
    file = tmp_path / "report.html"
    file.write_bytes(made(report, garching | {"params": params})["report.html"])
    page = browser.new_context(viewport={"width": 1400, "height": 900}).new_page()
    seen: list[str] = []
    page.on("console", lambda message: seen.append(message.text))
    page.on("request", lambda request: seen.append(request.url))
    page.goto(file.as_uri() + "#at=0,0,1")
    page.wait_for_selector("html[data-ready=yes]", state="attached", timeout=20_000)
    assert asked == []
    page.check("#layer-background")
    page.wait_for_timeout(800)
    z, x, y = (int(part.removesuffix(".png")) for part in asked[0].removeprefix("/t/").split("/"))
    frame = garching["projection"]
    lon, lat = frame.to_lonlat_deg(np.zeros((1, 2)))[0]
    assert z == 18
    assert abs(x - (lon + 180) / 360 * 2**z) < 6
    assert abs(y - (1 - np.arcsinh(np.tan(np.radians(lat))) / np.pi) / 2 * 2**z) < 6
    assert "<b>tiles</b> of a test" in page.inner_text("#legend")
    assert all(line.startswith(("file:", "data:", url.split("{")[0])) for line in seen)


@pytest.mark.parametrize(
    "url",
    ["javascript:alert(1)//{z}{x}{y}", "https://a/{z}/{x}", "https://a;script-src *//{z}{x}{y}", "file:///{z}/{x}/{y}",
     "https://a b/{z}/{x}/{y}", "https://u:p@a/{z}/{x}/{y}", 'https://a/{z}/{x}/{y}"'],
)  # fmt: skip
def test_what_is_no_address_of_tiles_is_refused(url: str) -> None:
    with pytest.raises(ValidationError):
        TilesParams(url=url)
