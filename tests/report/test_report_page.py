"""The file itself: the same bytes for the same run, and nothing in it that text from a map could break."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from report_runs import made

from flexmap_tasks.model.arrays import strings
from flexmap_tasks.report.along import places_along
from flexmap_tasks.report.embed import Texts, millimetres, numbers, script_json
from flexmap_tasks.report.report import report


@given(st.recursive(st.text(), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)))
def test_embedded_json_says_the_same_and_cannot_end_a_script(value: Any) -> None:
    text = script_json(value)
    assert json.loads(text) == value
    assert not set("<>&\u2028\u2029") & set(text)


def test_half_a_surrogate_pair_does_not_stop_the_report() -> None:
    assert json.loads(script_json("a\ud800b")) == "a?b"


@given(st.lists(st.tuples(st.floats(-2e6, 2e6), st.floats(-2e6, 2e6)), max_size=20))
def test_places_keep_their_millimetre(places: list[tuple[float, float]]) -> None:
    xy = np.array(places, dtype=np.float64).reshape(-1, 2)
    back = np.frombuffer(base64.b64decode(millimetres(xy)["b"]), dtype="<i4").reshape(-1, 2) / 1000.0
    assert np.abs(back - xy).max(initial=0.0) <= 0.00051


def test_ids_beyond_double_precision_survive() -> None:
    ids = np.array([2**53 + 1, -(2**62), 7], dtype=np.int64)
    assert np.frombuffer(base64.b64decode(numbers(ids, "i8")["b"]), dtype="<i8").tolist() == ids.tolist()


def test_text_stands_in_the_page_once() -> None:
    texts = Texts()
    texts.column(strings(["a", "b", "a", None, ""]))
    assert texts.table() == ["a", "b", ""]


@given(st.lists(st.floats(0.1, 50.0), min_size=2, max_size=6), st.floats(0.0, 1.0))
def test_places_along_straight_lines_are_where_they_should_be(lengths: list[float], share: float) -> None:
    """Line i runs from (0, i) along x; what stands before it in the array does not matter."""
    xy = np.array([[x, i] for i, length in enumerate(lengths) for x in (0.0, length)])
    offset = np.arange(0, 2 * len(lengths) + 1, 2)
    line = np.arange(len(lengths))
    found = places_along(offset, xy, line, share * np.array(lengths))
    assert np.allclose(found, np.column_stack([share * np.array(lengths), line]), atol=1e-9)
    assert np.isnan(places_along(offset, xy, np.array([-1]), np.array([0.0]))).all()


def test_the_same_run_gives_the_same_bytes(garching: dict[str, Any]) -> None:
    first, second = (made(report, garching)["report.html"] for _ in range(2))
    assert first == second
    assert len(first) < 3_000_000


def test_the_policy_names_every_script_and_style_by_its_hash(garching: dict[str, Any]) -> None:
    html = made(report, garching)["report.html"].decode()
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', html)
    assert policy is not None
    rules = policy[1].replace("&#x27;", "'")
    assert "default-src 'none'" in rules
    assert "unsafe" not in rules
    parts = re.findall(r"<script>(.*?)</script>|<style>(.*?)</style>", html, re.DOTALL)
    assert len(parts) == 6
    for part in parts:
        digest = hashlib.sha256("".join(part).encode()).digest()
        assert f"'sha256-{base64.b64encode(digest).decode()}'" in rules
    assert not re.search(r"\son[a-z]+=|src=|innerHTML *=(?! *\"\")", html.split("<script>")[0])
