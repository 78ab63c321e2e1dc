"""The words of the dashboard: what a release leaves to a person, and a page about one run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.execute import Outcome
from flexmap_tasks.engine.gate import Verdict
from flexmap_tasks.engine.release import Release
from flexmap_tasks.formats.artifacts import decode
from flexmap_tasks.model.conflation import LaneCheck, Transfers
from flows.console import HEADLINES

ROWS = 200
"""The dashboard shows tables as a whole: longer ones are cut, the release holds all of it."""


class _Folder:
    """A release's files as the codec reads them."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def names(self) -> list[str]:
        """All paths, sorted."""
        return sorted(p.name for p in self._root.iterdir() if p.is_file())

    def read(self, name: str) -> bytes:
        """The content."""
        return (self._root / name).read_bytes()

    def local(self, name: str) -> Path:
        """The path."""
        return self._root / name

    def sub(self, prefix: str) -> _Folder:
        """The files below a folder."""
        return _Folder(self._root / prefix)


def decisions(folder: Path) -> list[dict[str, Any]]:
    """What a person should look at in a release: transfers in review, and lanes that differ."""
    return list(_decisions(folder))[:ROWS]


def _decisions(folder: Path) -> Iterator[dict[str, Any]]:
    files = _Folder(folder)
    if (folder / "transfer.parquet").is_file():
        t: Transfers = decode(Transfers, files, "transfer")
        for i in range(len(t.key)):
            if t.action[i] == "review":
                yield {
                    "lanelet": int(t.lanelet_id[i]), "what": str(t.key[i]), "map": str(t.old[i]),
                    "osm": str(t.new[i]), "way": int(t.way_id[i]), "why": str(t.reason[i]),
                }  # fmt: skip
    if (folder / "lane_check.parquet").is_file():
        c: LaneCheck = decode(LaneCheck, files, "lane_check")
        for i in range(len(c.verdict)):
            if c.verdict[i] == "differ":
                yield {
                    "lanelet": int(c.lanelet_id[i]), "what": "number of lanes", "map": str(c.lanes_map[i]),
                    "osm": str(c.lanes_osm[i]), "way": int(c.way_id[i]), "why": str(c.reason[i]),
                }  # fmt: skip


def report_markdown(
    config: FlexMapConfig, outcomes: Mapping[str, Outcome], release: Release, verdict: Verdict | None,
    quality: Sequence[Mapping[str, Any]], rows: Sequence[Mapping[str, Any]], *, trial: bool = False,
) -> str:  # fmt: skip
    """One page: what came out, what the gate said, what a person should look at."""
    state = "a trial" if trial else verdict.state if verdict else "published"
    computed = [o for o in outcomes.values() if not o.cached]
    lines = [
        f"# {config.map}: {release.id} is {state}",
        "",
        f"{len(outcomes) - len(computed)} of {len(outcomes)} stages cached; "
        f"{sum(o.seconds for o in computed):.1f} s computed, "
        f"{sum(o.seconds for o in outcomes.values() if o.cached):.1f} s saved.",
        "",
        *(f"- {reason}" for reason in (verdict.reasons if verdict else ())),
        "",
        "| figure | value | unit | limit |",
        "|---|---:|---|---:|",
        *(_row(m) for m in quality if m["name"] in HEADLINES or m["limit"] is not None),
        "",
        f"Recording `{config.gnss.file.name}`; files in `{release.folder.resolve()}`.",
        "",
        f"## To look at: {len(rows)}{' or more' if len(rows) == ROWS else ''}",
        "",
        "| lanelet | what | map | OSM | way | why |",
        "|---|---|---|---|---|---|",
        *("| " + " | ".join(_cell(row[c]) for c in row) + " |" for row in rows[:20]),
    ]
    return "\n".join(lines) + "\n"


def _row(measure: Mapping[str, Any]) -> str:
    value = "-" if measure["value"] is None else f"{measure['value']:.4g}"
    limit = (
        "" if measure["limit"] is None else f"{measure['limit']:g} {'ok' if measure['passed'] else 'MISSED'}"
    )
    return f"| {measure['name']} | {value} | {measure['unit']} | {limit} |"


def _cell(value: Any) -> str:
    return str(value).replace("|", "\\|").replace("\n", " ")
