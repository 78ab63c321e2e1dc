"""What is up for review in one map, shown with its reasons, and how decisions are saved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from flexmap_tasks.config import FlexMapConfig, ReportParams
from flexmap_tasks.engine.graph import Graph
from flexmap_tasks.engine.local import OnDone
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.review_decisions_csv import (
    HEADER,
    Row,
    checked,
    decisions_of,
    read_review_decisions,
    review_decisions_csv,
)
from flexmap_tasks.model.source import Source
from flexmap_tasks.pipeline import map_update
from flexmap_tasks.report.html import review_page
from flexmap_tasks.report.report import report_data
from flexmap_tasks.store.store import Store
from flows.editor.saved_file import SavedFile, who_and_when
from flows.editor.values import inputs_of

MOST_DECISIONS = 200_000
PAGE = "the page"
NOT_WAITED_FOR = ("bundle_findings", "cloud_findings")
"""What the page can do without: the whole cloud would have to be moved for it."""


class ReviewSession:
    """The review of one map. All methods may be called from several threads."""

    def __init__(self, config: FlexMapConfig, store: Store, file: Path, places: tuple[str, ...]) -> None:
        """`file` is what decisions are saved to; `places` are the pages that there are."""
        self._config, self._store, self._file, self._places = config, store, SavedFile(file), places

    def prepare(self, done: OnDone) -> None:
        """Compute what the page needs, so that who opens it need not wait; told of every stage as it ends."""
        inputs_of(self._store, self._graph(), "report", NOT_WAITED_FOR, done)

    def page(self) -> bytes:
        """The map as the decisions of the file make it, with all that is still open; computes what is not there."""
        base = self._file.digest()
        params = ReportParams(map=self._config.map, background=self._config.background)
        given, outcomes = inputs_of(self._store, self._graph(), "report", NOT_WAITED_FOR)
        data = report_data(**given, params=params)
        data["stages"] = [
            {"stage": o.name, "cached": o.cached, "seconds": round(o.seconds, 3)} for o in outcomes
        ]
        data["editor"] = {"base": base, "file": self._file.name}
        return review_page(self._config.map, data, self._places)

    def _graph(self) -> Graph:
        return map_update(_at_once(_with_what_is_there(self._config)))

    def save(self, sent: dict[str, Any]) -> dict[str, Any]:
        """Write all decisions to the file the pipeline reads; those without a time get the present one and a name.

        sent : decisions, by the names of the file's columns, all text; base, the digest of the file they build on
        """
        rows = _rows(sent.get("decisions"))
        who, when = who_and_when()
        rows = [row if row["when"] else row | {"who": who, "when": when} for row in rows]
        content = review_decisions_csv(decisions_of(rows))
        base = self._file.replace(content, sent.get("base"), self._checked)
        plural = "" if len(rows) == 1 else "s"
        said = f"Saved {len(rows)} decision{plural} to {self._file.name}; the next run carries them out."
        return {"said": said, "base": base, "decisions": rows}

    def _checked(self, path: Path) -> object:
        return read_review_decisions(Source(self._file.name, path))


def _rows(sent: Any) -> list[Row]:
    """What the page sent, if it is decisions; InputError says what is wrong with it."""
    if not isinstance(sent, list) or len(sent) > MOST_DECISIONS:
        raise InputError(PAGE, f"sent no list of at most {MOST_DECISIONS} decisions")
    return [_row(row, f"decision {i + 1}") for i, row in enumerate(sent)]


def _row(row: Any, where: str) -> Row:
    if not isinstance(row, dict) or set(row) != set(HEADER):
        raise InputError(PAGE, f"sent something that is no decision; it needs {', '.join(HEADER)}", where)
    for name, text in row.items():
        if not isinstance(text, str) or text.encode("utf-8", "replace").decode() != text:
            raise InputError(PAGE, f"sent a {name} that is no text", where)
    return checked(row, PAGE, where)


def _at_once(config: FlexMapConfig) -> FlexMapConfig:
    """The run without the errors on withheld GNSS, which cost several times the alignment itself."""
    evaluation = config.evaluation.model_copy(update={"held_out_block_m": 0.0, "held_out_rmse_max_m": None})
    return config.model_copy(update={"evaluation": evaluation})


def _with_what_is_there(config: FlexMapConfig) -> FlexMapConfig:
    """The run without the files that the editor has not written yet."""
    alignment, conflation = config.alignment, config.conflation
    if conflation.review_file is not None and not conflation.review_file.exists():
        conflation = conflation.model_copy(update={"review_file": None})
    points = alignment.control_points_file
    if points is not None and not points.exists() and alignment.method == "pose_graph":
        alignment = alignment.model_copy(update={"control_points_file": None})
    return config.model_copy(update={"alignment": alignment, "conflation": conflation})
