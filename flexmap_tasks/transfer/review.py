"""People's decisions on values that were put up for review, carried out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexmap_tasks.engine.stage import stage
from flexmap_tasks.formats.review_decisions_csv import read_review_decisions
from flexmap_tasks.model.arrays import Ints, Strings, strings
from flexmap_tasks.model.conflation import Enriched, Transfers
from flexmap_tasks.model.lanelets import lanelet_relations
from flexmap_tasks.model.maps import Findings, LaneletMap
from flexmap_tasks.model.osm import rows_of
from flexmap_tasks.model.review import ReviewDecisions
from flexmap_tasks.model.source import Source

UNUSED = "review-decision-unused"


@stage("reviewed")
def apply_review(enriched: Enriched, source: Source) -> Enriched:
    """The enriched map with what was accepted written, and the table saying who decided.

    A decision counts for a row that is up for review and has the same lanelet, attribute, old and new value and
    way; of several for one row the last one counts. One that meets no such row changes nothing and becomes a
    finding: the ground it was made on has changed, and the row, if it is still there, is open again.
    """
    decisions = read_review_decisions(source)
    table = enriched.transfers
    row, used = _matched(table, decisions)
    action, reason, new = table.action.copy(), table.reason.copy(), table.new.copy()
    for d in np.flatnonzero(row >= 0).tolist():
        i, accepted = row[d], decisions.accept[d] == "accept"
        note = f" ({decisions.note[d]})" if decisions.note[d] else ""
        action[i] = "set" if accepted else "keep"
        reason[i] = f"{'accepted' if accepted else 'rejected'} by a person{note}"
        new[i] = decisions.value[d] or table.new[i] if accepted else table.new[i]
    settled = replace(table, action=action, reason=reason, new=new)
    written = np.unique(row[(row >= 0) & (decisions.accept == "accept")])
    return replace(
        enriched,
        map=_write(enriched.map, settled, written),
        transfers=settled,
        findings=_with_unused(enriched.findings, decisions, ~used),
    )


def _matched(table: Transfers, decisions: ReviewDecisions) -> tuple[Ints, np.ndarray]:
    """(n,) row that each decision settles, -1 where a later one does or there is none; and whether it met one."""
    asked = np.flatnonzero((table.action == "review") & (table.key != ""))
    place = {_key(table, i): i for i in asked.tolist()}
    row = np.array([place.get(_key(decisions, d), -1) for d in range(len(decisions))], dtype=np.int64)
    used = row >= 0
    last = {i: d for d, i in enumerate(row.tolist())}
    superseded = np.array([i >= 0 and last[i] != d for d, i in enumerate(row.tolist())], dtype=bool)
    return np.where(superseded, -1, row), used


def _key(table: Transfers | ReviewDecisions, i: int) -> tuple[int, int, str, str, str]:
    return (
        int(table.lanelet_id[i]),
        int(table.way_id[i]),
        str(table.key[i]),
        str(table.old[i]),
        str(table.new[i]),
    )


def _write(lanelet_map: LaneletMap, table: Transfers, rows: Ints) -> LaneletMap:
    relations = lanelet_map.document.relations
    lanelets = lanelet_relations(lanelet_map.document)
    at = rows_of(relations.id[lanelets], table.lanelet_id[rows])
    rows, at = rows[at >= 0], at[at >= 0]
    if not len(rows):
        return lanelet_map
    tags = relations.tags.with_values(lanelets[at], table.key[rows], table.new[rows])
    return replace(
        lanelet_map, document=replace(lanelet_map.document, relations=replace(relations, tags=tags))
    )


def _with_unused(findings: Findings, decisions: ReviewDecisions, unused: np.ndarray) -> Findings:
    rows = np.flatnonzero(unused)

    def column(old: Strings, new: list[str]) -> Strings:
        return strings([*old, *new])

    texts = [
        f"the decision to {decisions.accept[d]} {decisions.key[d][:80]}={decisions.new[d][:80]} meets no open row"
        for d in rows.tolist()
    ]
    return Findings(
        column(findings.code, [UNUSED] * len(rows)),
        column(findings.severity, ["info"] * len(rows)),
        column(findings.primitive, ["lanelet"] * len(rows)),
        np.concatenate([findings.id, decisions.lanelet_id[rows]]),
        column(findings.message, texts),
    )
