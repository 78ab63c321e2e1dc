"""The fleet's page on the dashboard."""

from __future__ import annotations

from flows.fleet_plan import Row
from flows.fleet_update import page, summary


def test_the_page_links_runs_keeps_its_columns_and_says_what_is_cut() -> None:
    rows = [
        Row("town0", "failed", reason="a|b.mcap: is cut off", run="123", recording="a|b.mcap"),
        Row("town1", "published", "0123abcd", "", 2.0, 1.0, "night1.mcap", "456"),
        Row("town2", "unchanged", "4567cdef"),
    ]
    figures = {"town0": ["", "", "", ""], "town1": ["0.21", "0.98", "1", "7"]}
    lines = page("towns", rows, rows[:2], figures).splitlines()
    assert lines[0] == f"# towns: {summary(rows)}" == "# towns: 1 failed, 1 published, 1 unchanged"
    assert lines[2] == "2.0 s computed, 1.0 s saved."
    columns = lines[4].count("|")
    assert [line.replace(r"\|", "").count("|") for line in lines[6:8]] == [columns, columns]
    assert "[town1](/runs/flow-run/456)" in lines[7]
    assert "| 0.21 | 0.98 | 1 | 7 |" in lines[7]
    assert lines[-1].startswith("1 more are not shown")
