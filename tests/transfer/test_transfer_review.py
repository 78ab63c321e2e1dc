"""People's decisions: carried out, kept while the ground holds, open again when it has changed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.osm_xml import parse_osm_xml
from flexmap_tasks.formats.review_decisions_csv import read_review_decisions
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.conflation import Enriched, LaneCheck, Transfers
from flexmap_tasks.model.maps import Findings, LaneletMap
from flexmap_tasks.model.source import Source
from flexmap_tasks.transfer.review import apply_review

HEADER = "lanelet_id,way_id,key,old,new,decision,value,note\n"
MAP = b"""<osm version="0.6"><relation id="1"><tag k="type" v="lanelet"/><tag k="speed_limit" v="10"/></relation>
<relation id="2"><tag k="type" v="lanelet"/></relation></osm>"""


def enriched() -> Enriched:
    document = parse_osm_xml(MAP, "map.osm")
    none = Findings(*(strings([]) for _ in range(3)), np.zeros(0, dtype=np.int64), strings([]))
    ids, way = np.array([1, 2, 2]), np.array([7, 7, 8])
    table = Transfers(
        ids, ids, strings(["speed_limit", "road_name", "road_name"]), strings(["10", "", ""]),
        strings(["50", "A", "B"]), way, np.ones(3, dtype=np.int64), strings([""] * 3), np.ones(3),
        strings(["review"] * 3), strings(["not certain"] * 3),
    )  # fmt: skip
    nothing = np.zeros(0, dtype=np.int64)
    check = LaneCheck(nothing, nothing, nothing, nothing, strings([]), strings([]))
    return Enriched(LaneletMap(document, np.zeros((0, 3)), none), table, check, none)


def source(tmp_path: Path, text: str) -> Source:
    path = tmp_path / "decisions.csv"
    path.write_bytes(text.encode())
    return Source(path.name, path)


def tags(value: Enriched, row: int) -> dict[str, str]:
    return value.map.document.relations.tags.of_element(row)


def test_what_is_accepted_is_written_and_what_is_rejected_is_not(tmp_path: Path) -> None:
    text = HEADER + "1,7,speed_limit,10,50,accept,,me\n2,7,road_name,,A,reject,,\n"
    settled = apply_review(enriched(), source(tmp_path, text))
    assert tags(settled, 0)["speed_limit"] == "50"
    assert "road_name" not in tags(settled, 1)
    assert settled.transfers.action.tolist() == ["set", "keep", "review"]
    assert settled.transfers.reason.tolist()[:2] == ["accepted by a person (me)", "rejected by a person"]
    assert len(settled.findings) == 0


def test_another_value_can_be_set_and_the_last_decision_counts(tmp_path: Path) -> None:
    text = HEADER + "2,8,road_name,,B,reject,,\r\n2,8,road_name,,B,accept,'=C,\r\n"
    settled = apply_review(enriched(), source(tmp_path, text))
    assert tags(settled, 1)["road_name"] == "=C"
    assert len(settled.findings) == 0


@pytest.mark.parametrize(
    "line",
    ["1,7,speed_limit,30,50,accept,,", "1,7,speed_limit,10,60,accept,,", "1,9,speed_limit,10,50,accept,,",
     "5,7,speed_limit,10,50,accept,,", "1,7,,10,50,accept,,"],
)  # fmt: skip
def test_a_decision_whose_ground_has_changed_comes_back(tmp_path: Path, line: str) -> None:
    before = enriched()
    settled = apply_review(before, source(tmp_path, HEADER + line + "\n"))
    assert settled.transfers.action.tolist() == before.transfers.action.tolist()
    assert tags(settled, 0) == tags(before, 0)
    assert settled.findings.code.tolist() == ["review-decision-unused"]


def test_deciding_twice_is_deciding_once(tmp_path: Path) -> None:
    file = source(tmp_path, HEADER + "1,7,speed_limit,10,50,accept,,\n")
    once = apply_review(enriched(), file)
    again = apply_review(replace(once, findings=enriched().findings), file)
    assert tags(again, 0) == tags(once, 0)
    assert again.transfers.action.tolist() == once.transfers.action.tolist()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "line 1"), ("lanelet_id,key\n", "line 1"), (HEADER + "1,7,a,b,c,maybe,,\n", "line 2.*accept or reject"),
        (HEADER + "x,7,a,b,c,accept,,\n", "line 2.*lanelet_id"), (HEADER + "1,7,a\n", "line 2.*cells"),
        (HEADER + '1,7,"a\n', "CSV"), (HEADER + f"1,7,{'x' * 30_000},b,c,accept,,\n", "cell|field"),
        (HEADER + "1,99999999999999999999,a,b,c,accept,,\n", "way_id"), (HEADER.replace("old", "key"), "line 1"),
    ],
)  # fmt: skip
def test_a_bad_file_is_one_clear_line(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        read_review_decisions(source(tmp_path, text))


def test_text_that_is_not_utf8_is_named(tmp_path: Path) -> None:
    path = tmp_path / "d.csv"
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="UTF-8"):
        read_review_decisions(Source("d.csv", path))
    with pytest.raises(InputError, match="cannot be read"):
        read_review_decisions(Source("e.csv", tmp_path / "e.csv"))
