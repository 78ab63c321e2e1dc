"""People's decisions on values, numbers of lanes and fragments, carried out; and those that no longer hold."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from math import inf

import numpy as np

from flexmap_tasks.engine.stage import stage
from flexmap_tasks.model.arrays import Bools, Ints, strings
from flexmap_tasks.model.conflation import Enriched, LaneCheck, Transfers
from flexmap_tasks.model.lanelets import lanelet_relations
from flexmap_tasks.model.maps import Findings, LaneletMap
from flexmap_tasks.model.osm import rows_of
from flexmap_tasks.model.review import COUNTS, ReviewDecisions
from flexmap_tasks.transfer.values import format_kmh, speed_kmh
from flexmap_tasks.transfer.write import attributed

UNUSED = "review-decision-unused"
Key = tuple[int, int, str, str, str]
"""Lanelet, way, key, the map's value and the one offered."""


@stage("reviewed")
def apply_review(
    enriched: Enriched,
    values: ReviewDecisions,
    lanes: ReviewDecisions,
    fragments: ReviewDecisions,
    unused_matches: ReviewDecisions,
) -> Enriched:
    """The enriched map with what was accepted written, and the tables saying who decided.

    A decision counts for a row that is up for review and has the same lanelet, key, old and new value and way; of
    several for one row the last one counts. One that meets no such row changes nothing and becomes a finding: the
    ground it was made on has changed, and the row, if it is still there, is open again.

    fragments : carried out by transfer already; unused_matches : decisions that met no piece of a lanelet
    """
    table, written, unused_values = _decided_values(enriched.transfers, values)
    check, table, unused_lanes = _decided_lanes(enriched.lane_check, table, lanes)
    unused = (unused_values, unused_lanes, _unused_fragments(table, fragments), unused_matches)
    return Enriched(
        map=_write(enriched.map, table, written),
        transfers=table,
        lane_check=check,
        findings=_with_unused(enriched.findings, unused),
    )


def _decided_values(table: Transfers, decisions: ReviewDecisions) -> tuple[Transfers, Ints, ReviewDecisions]:
    """The table with the decisions in it, the rows whose value is to be written, and the decisions that met none."""
    asked = np.flatnonzero((table.action == "review") & (table.key != "fragment"))
    row, unused = _met([(_key(table, i), i) for i in asked.tolist()], decisions)
    action, reason, new = table.action.copy(), table.reason.copy(), table.new.copy()
    written = []
    for i, d in row.items():
        accepted = decisions.accept[d] == "accept"
        value = _value(str(table.key[i]), str(decisions.value[d] or table.new[i]))
        if accepted and value is None:
            unused[d] = True
            continue
        writes = accepted and table.key[i] not in ("", *COUNTS)
        if writes:
            written.append(i)
            new[i] = value
        action[i] = "set" if writes else "keep"
        reason[i] = f"{'accepted' if accepted else 'rejected'} {decisions.by(d)}"
    settled = replace(table, action=action, reason=reason, new=new)
    return settled, np.array(sorted(written), dtype=np.int64), decisions.take(unused)


def _value(key: str, text: str) -> str | None:
    """What is written for a value as a person gave it; None where it cannot be: a limit must be a speed."""
    if key != "speed_limit":
        return text
    speed = speed_kmh(text, {})
    return format_kmh(speed) if speed is not None and 0 < speed < inf else None


def _decided_lanes(
    check: LaneCheck, table: Transfers, decisions: ReviewDecisions
) -> tuple[LaneCheck, Transfers, ReviewDecisions]:
    """The lane check with the decisions in it, on the rows of the table that tell the same too.

    "accept": the way is right, the map is to be redrawn; "reject": the map is right; a number: that many there are.
    """
    asked = [
        ((*_ids(check, i), "lanes", str(check.lanes_map[i]), str(check.lanes_osm[i])), i)
        for i in np.flatnonzero(check.review).tolist()
    ]
    row, unused = _met(asked, decisions)
    at = np.array(sorted(row), dtype=np.int64)
    ruling = [row[i] for i in at.tolist()]
    verdict, reason, review = check.verdict.copy(), check.reason.copy(), check.review.copy()
    for i, d in zip(at.tolist(), ruling, strict=True):
        wanted = int(decisions.value[d]) if decisions.value[d] else None
        right = wanted == check.lanes_map[i] if wanted is not None else decisions.accept[d] == "reject"
        verdict[i], review[i] = "agree" if right else "differ", False
        told = f"{wanted} lanes" if wanted is not None else "the map is right" if right else "OSM is right"
        reason[i] = f"{check.reason[i]}; {told}, decided {decisions.by(d)}"
    same = np.flatnonzero((table.key == "lanes") & (table.action == "review"))
    same = same[np.isin(table.lanelet_id[same], check.lanelet_id[at])]
    action, why = table.action.copy(), table.reason.copy()
    action[same] = "keep"
    why[same] = reason[rows_of(check.lanelet_id, table.lanelet_id[same])]
    return (
        replace(check, verdict=verdict, reason=reason, review=review),
        replace(table, action=action, reason=why),
        decisions.take(unused),
    )


def _unused_fragments(table: Transfers, decisions: ReviewDecisions) -> ReviewDecisions:
    told = np.flatnonzero((table.key == "fragment") & (table.action != "review"))
    return decisions.take(_met([(_key(table, i), i) for i in told.tolist()], decisions)[1])


def _met(rows: list[tuple[Key, int]], decisions: ReviewDecisions) -> tuple[dict[int, int], Bools]:
    """The last decision on each row that one speaks of, and which decisions speak of none."""
    place: dict[Key, list[int]] = {}
    for key, i in rows:
        place.setdefault(key, []).append(i)
    found = [place.get(decisions.key_of(d), []) for d in range(len(decisions))]
    return {i: d for d, at in enumerate(found) for i in at}, np.array([not at for at in found], dtype=bool)


def _ids(table: Transfers | LaneCheck, i: int) -> tuple[int, int]:
    return int(table.lanelet_id[i]), int(table.way_id[i])


def _key(table: Transfers, i: int) -> Key:
    return (*_ids(table, i), str(table.key[i]), str(table.old[i]), str(table.new[i]))


def _write(lanelet_map: LaneletMap, table: Transfers, rows: Ints) -> LaneletMap:
    relations = lanelet_map.document.relations
    lanelets = lanelet_relations(lanelet_map.document)
    at = rows_of(relations.id[lanelets], table.lanelet_id[rows])
    rows, at = rows[at >= 0], at[at >= 0]
    if not len(rows):
        return lanelet_map
    tags = relations.tags.with_values(lanelets[at], table.key[rows], table.new[rows])
    document = replace(lanelet_map.document, relations=replace(relations, tags=tags))
    return replace(lanelet_map, document=attributed(document))


def _with_unused(findings: Findings, unused: Iterable[ReviewDecisions]) -> Findings:
    rows = [(decisions, d) for decisions in unused for d in range(len(decisions))]
    texts = [_told(decisions, d) for decisions, d in rows]
    ids = np.array([decisions.lanelet_id[d] for decisions, d in rows], dtype=np.int64)
    new = ([UNUSED] * len(rows), ["info"] * len(rows), ["lanelet"] * len(rows))
    code, severity, primitive = (
        strings([*old, *more])
        for old, more in zip((findings.code, findings.severity, findings.primitive), new, strict=True)
    )
    message = strings([*findings.message, *texts])
    return Findings(code, severity, primitive, np.concatenate([findings.id, ids]), message)


def _told(decisions: ReviewDecisions, d: int) -> str:
    kind, key, offer = (str(text[d])[:80] for text in (decisions.kind, decisions.key, decisions.new))
    about = f"way {decisions.way_id[d]}" if kind == "match" else f"{key}={offer}"
    return f"the decision to {decisions.accept[d]} {about} ({kind}) meets no open row: its ground has changed"
