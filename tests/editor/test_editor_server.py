"""Who is answered and who is not, and what the server makes of nonsense."""

from __future__ import annotations

import http.client
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.errors import ConfigError, InputError
from flexmap_tasks.formats.control_points_csv import read_control_points
from flexmap_tasks.model.alignment import RigidMotion
from flexmap_tasks.model.projection import Projection
from flexmap_tasks.model.source import Source
from flexmap_tasks.store.store import Store
from flows.editor.editors import edit_server
from flows.editor.pairs import control_points_of, csv_of
from flows.editor.server import EditServer

PAIR = {"label": "a", "source": [1.0, 2.0], "target": [3.0, 4.0], "sigma": 0.1, "used": True}


@pytest.fixture
def server(serve: Callable[[FlexMapConfig], EditServer], config: FlexMapConfig) -> EditServer:
    return serve(config)


def request(
    server: EditServer, method: str, path: str, body: bytes | None = None, **headers: str
) -> tuple[int, bytes, dict[str, str]]:
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=20)
    sent = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.putrequest(method, path, skip_host="Host" in sent)
    if body is not None and "Content-Length" not in sent:
        sent["Content-Length"] = str(len(body))
    for name, value in sent.items():
        connection.putheader(name, value)
    connection.endheaders(body)
    reply = connection.getresponse()
    answer = reply.status, reply.read(), dict(reply.getheaders())
    connection.close()
    return answer


def ask(server: EditServer, what: str, body: Any, **headers: str) -> tuple[int, Any]:
    sent = {"Content_Type": "application/json"} | headers
    status, content, _ = request(server, "POST", f"/{server.token}/{what}", json.dumps(body).encode(), **sent)
    return status, json.loads(content)


def test_it_listens_on_the_loopback_alone(server: EditServer) -> None:
    assert server.server_address[0] == "127.0.0.1"
    status, content, headers = request(server, "GET", f"/{server.token}/")
    assert status == 200
    assert b"Content-Security-Policy" in content
    assert headers["Cache-Control"] == "no-store"
    assert headers["X-Frame-Options"] == "DENY"


@pytest.mark.parametrize(
    "path", ["/", "/wrong/", "//", "", "/../", "/%2e%2e/", "/{token}", "/{token}x/", "/%C3%BC/"]
)
def test_without_the_token_nobody_is_answered(server: EditServer, path: str) -> None:
    assert request(server, "GET", path.replace("{token}", server.token) or "/")[0] == 403


@pytest.mark.parametrize(
    "rest",
    ["../points.csv", "points.csv", "..%2f..%2fetc/passwd", "/etc/passwd", "save", "preview", "?x", "."],
)
def test_no_path_leads_anywhere(server: EditServer, rest: str) -> None:
    status, content, _ = request(server, "GET", f"/{server.token}/{rest}")
    assert status == 404
    assert b"root:" not in content


def test_other_origins_and_hosts_are_refused(server: EditServer) -> None:
    for headers in ({"Origin": "http://evil.example"}, {"Origin": "null"}, {"Host": "evil.example"}):
        assert request(server, "GET", f"/{server.token}/", **headers)[0] == 403
        assert ask(server, "preview", {"pairs": []}, **headers)[0] == 403
    assert ask(server, "preview", {"pairs": []}, Origin=server.origin)[0] == 200


def test_what_is_no_json_of_ours_is_refused(server: EditServer) -> None:
    path = f"/{server.token}/preview"
    assert request(server, "POST", path, b"{}", Content_Type="text/plain")[0] == 415
    assert request(server, "POST", path, b"{", Content_Type="application/json")[0] == 400
    assert request(server, "POST", path, b"[" * 100_000, Content_Type="application/json")[0] == 400
    big = {"Content_Type": "application/json", "Content-Length": str(1 << 40)}
    assert request(server, "POST", path, b"", **big)[0] == 413
    assert (
        request(server, "POST", path, b"", Content_Type="application/json", **{"Content-Length": "-1"})[0]
        == 413
    )
    assert request(server, "DELETE", path)[0] == 501
    assert "list" in ask(server, "save", {"pairs": "all"})[1]["error"]


def test_a_preview_says_what_points_do(server: EditServer, config: FlexMapConfig) -> None:
    few = ask(server, "preview", {"pairs": [PAIR]})[1]
    assert few["after_rmse_m"] == few["before_rmse_m"]
    assert few["left_out_m"] == [None]
    assert math.isclose(few["shift_m"][0], math.hypot(2, 2))


def test_a_preview_says_what_becomes_of_the_lanes(server: EditServer, config: FlexMapConfig) -> None:
    still = ask(server, "preview", {"pairs": []})[1]["lanes"]
    assert still == {"max_m": pytest.approx(0, abs=1e-3), "share_over_10cm": 0.0, "folded": 0, "lanelets": []}
    pulled = [{"label": f"p{i}", "source": [100.0 * x, 100.0 * y], "target": [150.0 * x, 100.0 * y], "sigma": 0.1, "used": True}
              for i, (x, y) in enumerate([(-3, -3), (3, -3), (3, 3), (-3, 3)])]  # fmt: skip
    lanes = ask(server, "preview", {"pairs": pulled})[1]["lanes"]
    assert lanes["max_m"] > 1
    assert 0 < lanes["share_over_10cm"] <= 1
    assert len(lanes["lanelets"]) > 100


def test_a_configuration_without_a_file_to_save_to_is_refused(config: FlexMapConfig, store: Store) -> None:
    bare = config.model_dump() | {"alignment": {"method": "rigid"}}
    with pytest.raises(ConfigError, match=r"control_points_file.*review_file"):
        edit_server(FlexMapConfig.model_validate(bare), store)


@pytest.mark.parametrize(
    "change",
    [
        {"label": ""}, {"label": "x" * 201}, {"label": "a\nb"}, {"label": "# no"}, {"label": 3}, {"label": " a"},
        {"sigma": 0}, {"sigma": True}, {"sigma": None}, {"sigma": 1e9}, {"used": 1}, {"source": [1]}, {"target": None},
        {"target": [1, "2"]}, {"source": [1, float("nan")]}, {"source": [1, 1e300]}, {"source": [float("inf"), 0]},
    ],
)  # fmt: skip
def test_nonsense_pairs_are_named(change: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="pair 2"):
        control_points_of([PAIR, PAIR | change])


@given(
    st.lists(
        st.tuples(st.text("abc,;\"' äß<", min_size=1, max_size=8), st.floats(-9e3, 9e3), st.floats(-9e3, 9e3)),
        min_size=1, max_size=6,
    )
)  # fmt: skip
def test_what_is_written_is_read_back(
    tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[str, float, float]]
) -> None:
    """Names, places to a tenth of a millimetre, sigma and use survive the file."""
    sent = [PAIR | {"label": f"n{name}n", "source": [x, y], "target": [y, x]} for name, x, y in rows]
    points = control_points_of(sent)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    motion = RigidMotion(turn, np.array([10.0, -5.0]), 1.0, 1.0, 0.0)
    projection = Projection.at(11.6, 48.2)
    file: Path = tmp_path_factory.mktemp("csv") / "p.csv"
    file.write_bytes(csv_of(points, motion, projection, "me 2026"))
    lines = read_control_points(Source("p.csv", file))
    assert [line.name for line in lines] == points.label.tolist()
    source = motion.apply_xy(np.array([line.source[0].values for line in lines]))
    target = projection.to_xy_m(np.array([line.target[0].values[::-1] for line in lines]))
    assert np.abs(source - points.source_xy_m).max() < 1e-4
    assert np.abs(target - points.target_xy_m).max() < 1e-4
