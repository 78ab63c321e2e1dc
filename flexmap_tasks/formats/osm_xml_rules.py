"""What must hold in an OSM document beyond being XML; errors name the element."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from flexmap_tasks.errors import InputError
from flexmap_tasks.model.arrays import Bools, Floats, Ints, Strings
from flexmap_tasks.model.osm import OsmDocument, Tags, rows_of


def lonlat_deg(name: str, ids: Ints, attributes: Tags) -> Floats:
    """(n, 2) float64 from `lon` and `lat` of nodes, NaN where they are blank or absent; WGS84 degrees.

    Raises InputError where a value is no number or out of range, or only one of the two is there.
    """
    out = np.empty((len(ids), 2))
    for column, (key, limit) in enumerate((("lon", 180.0), ("lat", 90.0))):
        out[:, column] = _degrees(name, ids, attributes.column(key), key, limit)
    half = np.flatnonzero(np.isnan(out).any(axis=1) & ~np.isnan(out).all(axis=1))
    if len(half):
        raise InputError(name, "has only one of lat and lon; give both or none", f"node {ids[half[0]]}")
    return out


def _degrees(name: str, ids: Ints, text: Strings, key: str, limit: float) -> Floats:
    value, blank = numbers(text)
    bad = np.flatnonzero(~blank & ~(np.abs(value) <= limit))
    if len(bad):
        rule = f"{key} must be a number of degrees from {-limit:g} to {limit:g}, found {str(text[bad[0]])[:40]!r}"
        raise InputError(name, rule, f"node {ids[bad[0]]}")
    return value


def numbers(text: Strings) -> tuple[Floats, Bools]:
    """(n,) float64 of decimal texts, and where they are blank or None; NaN there, infinity for what is no number."""
    blank: Bools = (text == None) | (text == "")  # noqa: E711  (an array of objects)
    try:
        column = pa.array(text, type=pa.string(), mask=blank).cast(pa.float64())
        return column.to_numpy(zero_copy_only=False), blank
    except pa.ArrowInvalid:
        return np.array([np.nan if b else _number(t) for b, t in zip(blank, text, strict=True)]), blank


def _number(text: str) -> float:
    try:
        return np.inf if "_" in text else float(text)
    except ValueError:
        return np.inf


def check_unique(document: OsmDocument, name: str) -> None:
    """Raise InputError where two elements of one kind have the same id."""
    kinds = (("node", document.nodes.id), ("way", document.ways.id), ("relation", document.relations.id))
    for kind, ids in kinds:
        ordered = np.sort(ids)
        doubled = ordered[1:][ordered[1:] == ordered[:-1]]
        if len(doubled):
            rule = (
                f"the id stands {np.count_nonzero(ids == doubled[0])} times; ids must be unique, rename one"
            )
            raise InputError(name, rule, f"{kind} {doubled[0]}")


def check_references(document: OsmDocument, name: str) -> None:
    """Raise InputError where a way names a node, or a relation a member, that the file does not hold."""
    ways, relations = document.ways, document.relations
    missing = np.flatnonzero(rows_of(document.nodes.id, ways.ref) < 0)
    if len(missing):
        owner = np.searchsorted(ways.offset, missing[0], side="right") - 1
        _dangling(name, "way", ways.id[owner], "node", ways.ref[missing[0]])
    known = (("node", document.nodes.id), ("way", ways.id), ("relation", relations.id))
    found = np.zeros(len(relations.member_ref), dtype=bool)
    for kind, ids in known:
        wanted = np.flatnonzero(relations.member_type == kind)
        found[wanted] = rows_of(ids, relations.member_ref[wanted]) >= 0
    lost = np.flatnonzero(~found)
    if len(lost):
        owner = np.searchsorted(relations.offset, lost[0], side="right") - 1
        kind = str(relations.member_type[lost[0]])
        if kind not in ("node", "way", "relation"):
            rule = f"member type must be node, way or relation, found {kind[:40]!r}"
            raise InputError(name, rule, f"relation {relations.id[owner]}")
        _dangling(name, "relation", relations.id[owner], kind, relations.member_ref[lost[0]])


def _dangling(name: str, kind: str, element: int, target: str, ref: int) -> None:
    rule = f"refers to {target} {ref}, which the file does not hold; add it or remove the reference"
    raise InputError(name, rule, f"{kind} {element}")
