"""Write what was decided into the map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexmap_tasks.config import TransferParams
from flexmap_tasks.model.arrays import Ints, Strings, strings
from flexmap_tasks.model.conflation import LaneCheck, Transfers
from flexmap_tasks.model.maps import OSM_ATTRIBUTION, LaneletMap
from flexmap_tasks.model.osm import OsmDocument, OsmRelations, Tags, rows_of
from flexmap_tasks.transfer.cuts.cut import RULE, NewIds, Pieces, joined_tags, ranges


def written(
    cut: LaneletMap, pieces: Pieces, values: Transfers, check: LaneCheck, params: TransferParams
) -> LaneletMap:
    """The map with every value whose action is "set", and what else was asked for."""
    as_rule = {rule.target for rule in params.rules if rule.element == "speed_limit_rule"}
    chosen = values.action == "set"
    ruled = chosen & np.isin(values.key.astype(str), sorted(as_rule))
    document = _with_tags(cut.document, pieces, values, np.flatnonzero(chosen & ~ruled), check, params)
    document = _with_rules(document, values, np.flatnonzero(ruled))
    return cut if document is cut.document else replace(cut, document=attributed(document))


def attributed(document: OsmDocument) -> OsmDocument:
    """The document with what the licence of OpenStreetMap's data (ODbL) wants to be read, on the root of its XML."""
    own = document.root.get("attribution", "")
    if OSM_ATTRIBUTION in own:
        return document
    text = f"{own}; {OSM_ATTRIBUTION}" if own else OSM_ATTRIBUTION
    return replace(document, root={**document.root, "attribution": text})


def _with_tags(
    document: OsmDocument,
    pieces: Pieces,
    values: Transfers,
    at: Ints,
    check: LaneCheck,
    params: TransferParams,
) -> OsmDocument:
    ids, keys, texts = values.lanelet_id[at], values.key[at], values.new[at]
    if params.provenance_tags:
        ids = np.concatenate([ids, ids])
        keys = np.concatenate([keys, strings(f"source:{key}" for key in keys)])
        texts = np.concatenate([texts, _provenance(values, at)])
    if params.lane_check_tags:
        ids = np.concatenate([ids, check.lanelet_id])
        keys = np.concatenate([keys, strings(["lane_check"] * len(check.lanelet_id))])
        texts = np.concatenate([texts, check.verdict])
    if not len(ids):
        return document
    relations = document.relations
    rows = pieces.relation_row[rows_of(pieces.lanelet_id, ids)]
    return replace(document, relations=replace(relations, tags=relations.tags.with_values(rows, keys, texts)))


def _provenance(values: Transfers, at: Ints) -> Strings:
    """Where each value comes from, such as "OpenStreetMap way 100 v3 2023-11-01T00:00:00Z"."""
    columns = (values.way_id[at].tolist(), values.way_version[at].tolist(), values.way_timestamp[at].tolist())
    return strings(f"OpenStreetMap way {w} v{v} {t}".rstrip() for w, v, t in zip(*columns, strict=True))


def _with_rules(document: OsmDocument, values: Transfers, at: Ints) -> OsmDocument:
    """One speed limit rule per way and limit, named by the lanelets it holds for.

    Lanelet2 takes the limit from `sign_type` where no sign is drawn (regulatory element speed_limit).
    """
    if not len(at):
        return document
    ids, rules = NewIds(document), {}
    for i in at[np.lexsort((values.lanelet_id[at], values.way_id[at]))].tolist():
        key = (int(values.way_id[i]), str(values.new[i]))
        if key not in rules:
            rules[key] = ids.new(RULE, key[0], float(key[1]))
    lanelet = rows_of(document.relations.id, values.lanelet_id[at])
    named = [rules[int(w), str(v)] for w, v in zip(values.way_id[at], values.new[at], strict=True)]
    source = _provenance(values, at)
    said = {rule: str(text) for rule, text in zip(named, source, strict=True)}
    tags = [
        {
            "type": "regulatory_element",
            "subtype": "speed_limit",
            "sign_type": f"{limit} km/h",
            "source": said[rule],
        }
        for (_, limit), rule in rules.items()
    ]
    relations = _appended(
        _with_members(document.relations, lanelet, named), list(rules.values()), tags, document
    )
    return replace(document, relations=relations)


def _with_members(relations: OsmRelations, rows: Ints, rules: list[int]) -> OsmRelations:
    """Each of the given relations (rows, unique) gets one rule more, after its members."""
    size = np.diff(relations.offset)
    size[rows] += 1
    offset, _ = ranges(np.zeros(len(size), dtype=np.int64), size)
    place = offset[rows + 1] - 1
    old = np.ones(int(offset[-1]), dtype=bool)
    old[place] = False
    columns = []
    news = (strings(["relation"] * len(rows)), np.array(rules), strings(["regulatory_element"] * len(rows)))
    for column, new in zip(
        (relations.member_type, relations.member_ref, relations.member_role), news, strict=True
    ):
        out = np.empty(len(old), dtype=column.dtype)
        out[old], out[place] = column, new
        columns.append(out)
    return replace(
        relations, offset=offset, member_type=columns[0], member_ref=columns[1], member_role=columns[2]
    )


def _appended(
    relations: OsmRelations, ids: list[int], tags: list[dict[str, str]], document: OsmDocument
) -> OsmRelations:
    """Relations without members after all others, the rest of the file included."""
    parts = (document.nodes.position, document.ways.position, relations.position, document.other_position)
    last = max(int(p.max(initial=-1)) for p in parts)
    like = relations.attributes.of_element(int(relations.offset.size) - 2) if len(relations.id) else {}
    return replace(
        relations,
        id=np.concatenate([relations.id, np.array(ids, dtype=np.int64)]),
        offset=np.concatenate([relations.offset, np.full(len(ids), relations.offset[-1])]),
        attributes=joined_tags(relations.attributes, Tags.of([like] * len(ids))),
        tags=joined_tags(relations.tags, Tags.of(tags)),
        position=np.concatenate([relations.position, last + 1 + np.arange(len(ids))]),
    )
