"""OpenStreetMap from a server on the loopback."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexmap_tasks.config import OsmFetchParams, OsmRoadsParams
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats import osm_fetch
from flexmap_tasks.formats.osm_fetch import OsmServerError
from flexmap_tasks.ingest.osm_fetch import fetch_osm, track_box
from flexmap_tasks.ingest.osm_roads import ingest_osm_roads
from flexmap_tasks.model.maps import GeoBox
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import GnssFixes

BOX = GeoBox(11.0, 48.0, 11.4, 48.2)
Answer = Callable[[BaseHTTPRequestHandler, str], tuple[int, bytes]]


class Server:
    """A server that answers with one function and remembers what it was asked."""

    def __init__(self) -> None:
        self.answer: Answer = lambda *_: (200, b"<osm/>")
        self.asked: list[tuple[str, str, str]] = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                body = self.rfile.read(int(self.headers.get("Content-Length", 0))).decode()
                outer.asked.append((self.path, body, self.headers["User-Agent"]))
                status, content = outer.answer(self, body)
                self.send_response(status)
                self.send_header("Content-Length", str(len(content)))
                self.end_headers()
                self.wfile.write(content)

            do_POST = do_GET  # noqa: N815

            def log_message(self, *_: object) -> None:
                return

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"http://127.0.0.1:{self.http.server_port}"


@pytest.fixture
def server() -> Iterator[Server]:
    running = Server()
    thread = threading.Thread(target=running.http.serve_forever, args=(0.02,))
    thread.start()
    yield running
    running.http.shutdown()
    thread.join()
    running.http.server_close()


def town(west: float, south: float, east: float, north: float) -> bytes:
    """A grid of nodes every 0.05 degrees and streets along the parallels; a street in the box comes whole."""
    steps = np.arange(0, 0.41, 0.05)
    inside = [(i, j) for i, lon in enumerate(11 + steps) for j, lat in enumerate(48 + steps[:5])
              if west <= lon <= east and south <= lat <= north]  # fmt: skip
    rows = sorted({j for _, j in inside})
    nodes = [(i, j) for i in range(9) for j in rows]
    text = "".join(
        f'<node id="{10 * j + i + 1}" version="1" lat="{48 + 0.05 * j}" lon="{11 + 0.05 * i}"/>'
        for i, j in nodes
    )
    for j in rows:
        refs = "".join(f'<nd ref="{10 * j + i + 1}"/>' for i in range(9))
        text += f'<way id="{j + 1}" version="1">{refs}<tag k="highway" v="primary"/></way>'
    return f'<osm version="0.6" generator="test">{text}</osm>'.encode()


def bbox(path: str) -> list[float]:
    return [float(v) for v in parse_qs(urlsplit(path).query)["bbox"][0].split(",")]


def roads_of(tmp_path: Path, files: dict[str, bytes]) -> list[int]:
    path = tmp_path / "extract.osm"
    path.write_bytes(files["extract.osm"])
    return ingest_osm_roads(Source("extract.osm", path), OsmRoadsParams()).way_id.tolist()


@pytest.mark.parametrize("endpoint", ["/api/0.6/map", "/api/0.6/", "/api/0.6"])
def test_map_call(server: Server, tmp_path: Path, endpoint: str) -> None:
    server.answer = lambda request, _: (200, town(*bbox(request.path)))
    files = fetch_osm(BOX, OsmFetchParams(endpoint=server.address + endpoint))
    assert list(files) == ["extract.osm"]
    assert files["extract.osm"] == town(11, 48, 11.4, 48.2)
    ((path, _, agent),) = server.asked
    assert path.startswith("/api/0.6/map?")
    assert bbox(path) == [11, 48, 11.4, 48.2]
    assert agent.startswith("flexmap/")
    assert roads_of(tmp_path, files) == [1, 2, 3, 4, 5]


def test_a_box_with_too_many_nodes_is_asked_for_in_parts(server: Server, tmp_path: Path) -> None:
    def answer(request: BaseHTTPRequestHandler, _: str) -> tuple[int, bytes]:
        west, south, east, north = bbox(request.path)
        if (east - west) * (north - south) > 0.021:
            return (
                400,
                b"You requested too many nodes (limit is 50000). Either request a smaller area, or use planet.osm",
            )
        return 200, town(west, south, east, north)

    server.answer = answer
    files = fetch_osm(BOX, OsmFetchParams(endpoint=server.address + "/map"))
    assert len(server.asked) == 5
    assert roads_of(tmp_path, files) == [1, 2, 3, 4, 5]
    assert files["extract.osm"].count(b"<node") == 45
    server.asked.clear()
    assert files == fetch_osm(BOX, OsmFetchParams(endpoint=server.address + "/map"))


def test_a_box_that_is_always_too_large_ends(server: Server) -> None:
    server.answer = lambda *_: (400, b"The maximum bbox size is 0.25, and your request was too large.")
    with pytest.raises(InputError, match="too large for this server"):
        fetch_osm(BOX, OsmFetchParams(endpoint=server.address + "/map"))
    assert len(server.asked) == osm_fetch.MAX_REQUESTS


def test_overpass(server: Server, tmp_path: Path) -> None:
    server.answer = lambda *_: (200, town(11, 48, 11.4, 48.2))
    files = fetch_osm(
        BOX, OsmFetchParams(endpoint=server.address + "/api/interpreter", api="overpass", timeout_s=30)
    )
    ((path, body, _),) = server.asked
    assert path == "/api/interpreter"
    query = parse_qs(body)["data"][0]
    assert "[timeout:30]" in query
    assert 'way["highway"](48.0000000,11.0000000,48.2000000,11.4000000)' in query
    assert query.endswith("out meta;")
    assert roads_of(tmp_path, files) == [1, 2, 3, 4, 5]


@pytest.mark.parametrize(
    ("status", "content", "again", "words"),
    [
        (429, b"slow down", True, "HTTP 429"),
        (503, b"", True, "HTTP 503"),
        (504, b"gateway", True, "try again later"),
        (400, b"bad syntax", False, "bad syntax"),
        (404, b"not here", False, "check endpoint"),
        (401, b"", False, "HTTP 401"),
        (200, b"<html>login</html>", False, "login"),
        (200, b"", False, "nothing"),
        (200, b'<osm version="0.6"><node id="1"', True, "cut off"),
        (200, b"<osm><remark> runtime error: Query timed out </remark></osm>", True, "Query timed out"),
    ],
)
def test_answers_that_are_no_extract(
    server: Server, status: int, content: bytes, again: bool, words: str
) -> None:
    server.answer = lambda *_: (status, content)
    with pytest.raises(InputError) as caught:
        fetch_osm(
            BOX, OsmFetchParams(endpoint=server.address.replace("//", "//me:secret@") + "/map?key=secret")
        )
    assert isinstance(caught.value, OsmServerError) == again
    assert words in str(caught.value)
    assert "secret" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_answer_without_end_is_cut(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(osm_fetch, "MAX_BYTES", 1 << 20)
    server.answer = lambda *_: (200, b"<osm>" + b" " * (2 << 20) + b"</osm>")
    with pytest.raises(InputError, match="smaller box"):
        fetch_osm(BOX, OsmFetchParams(endpoint=server.address))


def test_a_silent_and_an_absent_server(server: Server) -> None:
    waiting = threading.Event()
    server.answer = lambda *_: (200 if waiting.wait(5) else 500, b"<osm/>")
    with pytest.raises(OsmServerError, match="in time"):
        fetch_osm(BOX, OsmFetchParams(endpoint=server.address, timeout_s=0.1))
    waiting.set()
    with pytest.raises(OsmServerError, match="reached"):
        fetch_osm(BOX, OsmFetchParams(endpoint="http://127.0.0.1:9", timeout_s=1))


def test_an_endpoint_is_an_http_address() -> None:
    for endpoint in ("file:///etc/passwd", "ftp://x/y", "", "https://"):
        with pytest.raises(ValueError, match="endpoint"):
            OsmFetchParams(endpoint=endpoint)


def fixes(lon: list[float], lat: list[float], status: list[int] | None = None) -> GnssFixes:
    n, nothing = len(lon), np.full(len(lon), np.nan)
    return GnssFixes(
        np.array(lon), np.array(lat), nothing, nothing, nothing, nothing,
        np.array(status or [0] * n, dtype=np.int64), None,
    )  # fmt: skip


FETCH = OsmFetchParams(endpoint="https://example.org/map")


@given(
    st.lists(st.tuples(st.floats(10, 12), st.floats(-70, -68)), min_size=1, max_size=20), st.floats(0, 2000)
)
def test_the_box_holds_the_track_and_its_margin(places: list[tuple[float, float]], margin_m: float) -> None:
    lon, lat = (list(v) for v in zip(*places, strict=True))
    box = track_box(fixes([*lon, float("nan"), 0.0], [*lat, 3.0, 0.0], [*([0] * len(lon)), 0, -1]),
                    OsmFetchParams(endpoint="https://example.org", margin_m=margin_m))  # fmt: skip
    up = margin_m / 111_700
    assert box.south_deg <= min(lat) - up
    assert box.north_deg >= max(lat) + up
    aside = up / np.cos(np.radians(68))
    assert box.west_deg <= min(lon) - aside
    assert box.east_deg >= max(lon) + aside
    for side in (box.west_deg, box.south_deg, box.east_deg, box.north_deg):
        assert round(side, 4) == side
    assert box.north_deg - max(lat) < margin_m / 110_000 + 1.1e-4


def test_a_small_change_of_the_track_asks_for_the_same_box() -> None:
    assert track_box(fixes([11.00003], [48.00003]), FETCH) == track_box(fixes([11.00004], [48.00004]), FETCH)


@pytest.mark.parametrize(
    ("lon", "lat", "words"),
    [
        ([], [], "no fix"),
        ([float("nan")], [48.0], "no fix"),
        ([179.9995, -179.9995], [10.0, 10.0], "antimeridian"),
        ([179.9995], [10.0], "antimeridian"),
        ([10.0], [89.9], "pole"),
        ([10.0], [-85.0], "pole"),
        ([11.0, 1.0], [48.0, 1.0], "more than one drive"),
    ],
)
def test_tracks_no_server_can_be_asked_for(lon: list[float], lat: list[float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        track_box(fixes(lon, lat), FETCH)
