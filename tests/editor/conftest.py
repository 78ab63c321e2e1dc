"""An editor on the loopback, and a real browser before it."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.store.store import Store
from flows.editor.editors import edit_server
from flows.editor.server import EditServer


@pytest.fixture
def config(shared_data: Path, tmp_path: Path) -> FlexMapConfig:
    """The route in Garching with a control point file that a test may write."""
    folder = shared_data / "garching"
    shutil.copyfile(folder / "control_points_peer.csv", tmp_path / "points.csv")
    return FlexMapConfig.model_validate(
        {
            "map": "garching",
            "gnss": {"file": str(folder / "route_1_GPS.txt")},
            "slam": {"file": str(folder / "route1_pose_kitti.txt")},
            "lanelet_map": {"file": str(folder / "lanelet2_route_1.osm")},
            "alignment": {"method": "rubber_sheet", "control_points_file": str(tmp_path / "points.csv")},
        }
    )


@pytest.fixture(scope="session")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return Store.open(str(tmp_path_factory.mktemp("store")))


@pytest.fixture
def serve(store: Store) -> Iterator[Callable[[FlexMapConfig], EditServer]]:
    """Starts editors, and ends them."""
    servers: list[EditServer] = []

    def start(config: FlexMapConfig) -> EditServer:
        server = edit_server(config, store)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        servers.append(server)
        return server

    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


@pytest.fixture
def page() -> Iterator[Any]:
    """A page of a real browser; what it complains of is in `page.complaints`."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("no browser: chromium is not installed (apt-get install chromium)")
    with sync_api.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=found, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.complaints = []
        page.on(
            "console", lambda m: page.complaints.append(m.text) if m.type in ("error", "warning") else None
        )
        page.on("pageerror", lambda error: page.complaints.append(str(error)))
        yield page
        browser.close()
