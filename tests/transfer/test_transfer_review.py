"""People's decisions: carried out, kept while the ground holds, open again when it has changed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.osm_xml import parse_osm_xml
from flexmap_tasks.formats.review_decisions_csv import read_review_decisions, review_decisions_csv
from flexmap_tasks.ingest.review_decisions import ingest_review_decisions
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.conflation import Enriched, LaneCheck, Transfers
from flexmap_tasks.model.maps import Findings, LaneletMap
from flexmap_tasks.model.review import Decided, ReviewDecisions
from flexmap_tasks.model.source import Source
from flexmap_tasks.transfer.review import apply_review

HEADER = "lanelet_id,way_id,key,old,new,decision,value,note,kind\n"
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
    check = LaneCheck(
        np.array([1, 2]), np.array([7, 8]), np.array([3, 1]), np.array([2, 1]), strings(["differ", "agree"]),
        np.array([True, False]), strings(["lanes=2, the map has 3", "lanes=1"]),
    )  # fmt: skip
    return Enriched(LaneletMap(document, np.zeros((0, 3)), none), table, check, none)


def source(tmp_path: Path, text: str) -> Source:
    path = tmp_path / "decisions.csv"
    path.write_bytes(text.encode())
    return Source(path.name, path)


def settled_by(before: Enriched, tmp_path: Path, text: str) -> Enriched:
    decided = ingest_review_decisions(source(tmp_path, text))
    return apply_review(before, decided.values, decided.lanes, decided.fragments, decided.matches)


def tags(value: Enriched, row: int) -> dict[str, str]:
    return value.map.document.relations.tags.of_element(row)


def test_what_is_accepted_is_written_and_what_is_rejected_is_not(tmp_path: Path) -> None:
    text = HEADER + "1,7,speed_limit,10,50,accept,,me,value\n2,7,road_name,,A,reject,,,value\n"
    settled = settled_by(enriched(), tmp_path, text)
    assert tags(settled, 0)["speed_limit"] == "50"
    assert "road_name" not in tags(settled, 1)
    assert settled.transfers.action.tolist() == ["set", "keep", "review"]
    assert settled.transfers.reason.tolist()[:2] == ["accepted by a person (me)", "rejected by a person"]
    assert len(settled.findings) == 0


def test_another_value_can_be_set_and_the_last_decision_counts(tmp_path: Path) -> None:
    text = HEADER + "2,8,road_name,,B,reject,,,value\r\n2,8,road_name,,B,accept,'=C,,value\r\n"
    settled = settled_by(enriched(), tmp_path, text)
    assert tags(settled, 1)["road_name"] == "=C"
    assert len(settled.findings) == 0


@pytest.mark.parametrize(
    "line",
    ["1,7,speed_limit,30,50,accept,,", "1,7,speed_limit,10,60,accept,,", "1,9,speed_limit,10,50,accept,,",
     "5,7,speed_limit,10,50,accept,,", "1,7,,10,50,accept,,"],
)  # fmt: skip
def test_a_decision_whose_ground_has_changed_comes_back(tmp_path: Path, line: str) -> None:
    before = enriched()
    settled = settled_by(before, tmp_path, HEADER + line + ",value\n")
    assert settled.transfers.action.tolist() == before.transfers.action.tolist()
    assert tags(settled, 0) == tags(before, 0)
    assert settled.findings.code.tolist() == ["review-decision-unused"]


def test_deciding_twice_is_deciding_once(tmp_path: Path) -> None:
    text = HEADER + "1,7,speed_limit,10,50,accept,,,value\n1,7,lanes,3,2,reject,,,lanes\n"
    once = settled_by(enriched(), tmp_path, text)
    again = settled_by(replace(once, findings=enriched().findings), tmp_path, text)
    assert tags(again, 0) == tags(once, 0)
    assert again.transfers.action.tolist() == once.transfers.action.tolist()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "line 1"), ("lanelet_id,key\n", "line 1"), (HEADER + "1,7,a,b,c,maybe,,,value\n", "line 2.*accept or reject"),
        (HEADER + "x,7,a,b,c,accept,,,value\n", "line 2.*lanelet_id"), (HEADER + "1,7,a,b,c,accept,,,odd\n", "kind"),
        (HEADER + "1,7,,,,accept,,,match\n", "s_from_m.*metres"), (HEADER + "1,7,lanes,3,2,accept,two,,lanes\n", "number"), (HEADER + "1,7,a\n", "line 2.*cells"),
        (HEADER + '1,7,"a\n', "CSV"), (HEADER + f"1,7,{'x' * 30_000},b,c,accept,,,value\n", "cell|field"),
        (HEADER + "1,99999999999999999999,a,b,c,accept,,,value\n", "way_id"), (HEADER.replace("old", "key"), "line 1"),
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


@pytest.mark.parametrize(
    ("decision", "verdict", "told"),
    [("accept,", "differ", "OSM is right"), ("reject,", "agree", "the map is right"), ("accept,3", "agree", "3 lanes"),
     ("accept,4", "differ", "4 lanes")],
)  # fmt: skip
def test_a_number_of_lanes_is_settled(tmp_path: Path, decision: str, verdict: str, told: str) -> None:
    settled = settled_by(enriched(), tmp_path, HEADER + f"1,7,lanes,3,2,{decision},,lanes\n")
    assert settled.lane_check.verdict.tolist() == [verdict, "agree"]
    assert told in settled.lane_check.reason[0]
    assert not settled.lane_check.review.any()
    assert tags(settled, 0) == tags(enriched(), 0)
    assert len(settled.findings) == 0


def test_lanes_that_were_counted_anew_are_open_again(tmp_path: Path) -> None:
    settled = settled_by(enriched(), tmp_path, HEADER + "1,7,lanes,4,2,reject,,,lanes\n")
    assert settled.lane_check.review.tolist() == [True, False]
    assert settled.findings.id.tolist() == [1]


@pytest.mark.parametrize(
    ("value", "written"), [("none", "10"), ("fast", "10"), ("30 mph", "48.28"), ("70", "70")]
)
def test_a_limit_is_a_speed_or_it_is_not_written(tmp_path: Path, value: str, written: str) -> None:
    settled = settled_by(enriched(), tmp_path, HEADER + f"1,7,speed_limit,10,50,accept,{value},,value\n")
    assert tags(settled, 0)["speed_limit"] == written
    assert len(settled.findings) == (written == "10")


def test_decisions_are_written_as_they_are_read(tmp_path: Path) -> None:
    text = HEADER + '1,7,speed_limit,10,50,accept,,"a ""b"", =c",value\n-3,7,\'=k,,,reject,,\'-x,value\n'
    read = read_review_decisions(source(tmp_path, text))
    again = read_review_decisions(source(tmp_path, review_decisions_csv(read).decode()))
    for name in ReviewDecisions.__slots__:
        assert getattr(again, name).tolist() == getattr(read, name).tolist() or name.startswith("s_"), name
    assert len(Decided.KINDS) == len(Decided.__slots__)
