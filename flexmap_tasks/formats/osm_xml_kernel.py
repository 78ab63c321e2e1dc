"""The compiled steps of the OSM XML scanner, from single names up to the whole document.

All read (n,) uint8 bytes that end with a zero, which stops every loop, and say -1 where the plain form ends.
They stand in one file: the compiler's cache only notices changes of the file a function stands in.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

NODE, WAY, RELATION, OTHER = 0, 1, 2, 3
PROBES = 64
"""A text not found in so many steps counts as new: hostile texts that collide cost no more than that."""
MAX_ATTRIBUTES = 32
"""More attributes on one element are left to the full parser."""

_ELEMENTS, _ATTRIBUTES, _TAGS, _ITEMS, _ROOT_ATTRIBUTES, _TEXTS = range(6)
_LT, _GT, _SLASH, _EQUALS, _QUOTE, _APOSTROPHE, _AND, _BRACKET = (ord(c) for c in "<>/=\"'&]")
_K, _V = ord("k"), ord("v")
_LARGEST = 2**63 - 1
_OSM, _NODE, _WAY, _RELATION = b"osm", b"node", b"way", b"relation"
_TAG, _ND, _MEMBER = b"tag", b"nd", b"member"
_ID, _REF, _TYPE, _ROLE, _XMLNS = b"id", b"ref", b"type", b"role", b"xmlns"

F = TypeVar("F", bound=Callable[..., Any])


def _compiled(function: F) -> F:
    """Compile for the machine; kept beside the module."""
    return cast("F", njit(cache=True)(function))


@_compiled
def _is_name(c: int) -> bool:
    return 97 <= c <= 122 or 65 <= c <= 90 or c == 95 or 48 <= c <= 57 or c in (45, 46)


@_compiled
def _name(d: Any, i: int) -> int:
    """End of the plain name at i; i itself where there is none."""
    c = d[i]
    if not (97 <= c <= 122 or 65 <= c <= 90 or c == 95):
        return i
    while _is_name(d[i]):
        i += 1
    return i


@_compiled
def _space(d: Any, i: int) -> int:
    while d[i] == 32 or d[i] == 10 or d[i] == 9 or d[i] == 13:
        i += 1
    return i


@_compiled
def _attribute(d: Any, i: int) -> tuple[int, int, int, int]:
    """Name and value at i as (name end, value start, value end, next); next is -1 where it is not plain."""
    end = _name(d, i)
    j = _space(d, end)
    if end == i or d[j] != _EQUALS:
        return i, i, i, -1
    j = _space(d, j + 1)
    quote = d[j]
    if quote not in (_QUOTE, _APOSTROPHE):
        return i, i, i, -1
    value = j + 1
    j = value
    while d[j] != quote:
        # Line ends and tabs are changed by XML's rules, and control bytes are none of its characters.
        if d[j] < 32 or d[j] == _LT:
            return i, i, i, -1
        j += 1
    return end, value, j, j + 1


@_compiled
def _is(d: Any, i: int, end: int, word: Any) -> bool:
    if end - i != len(word):
        return False
    for k in range(len(word)):  # noqa: SIM110  (compiled)
        if d[i + k] != word[k]:
            return False
    return True


@_compiled
def _integer(d: Any, i: int, end: int) -> tuple[bool, Any]:
    """A plain integer of 64 bits (its lowest value left out)."""
    negative = d[i] == 45
    if negative:
        i += 1
    value = np.int64(0)
    if end <= i or end - i > 19:
        return False, value
    while i < end:
        digit = np.int64(d[i]) - 48
        if digit < 0 or digit > 9 or value > (_LARGEST - digit) // 10:
            return False, value
        value = value * 10 + digit
        i += 1
    return True, -value if negative else value


@_compiled
def _same(d: Any, i: int, end: int, j: int, j_end: int) -> bool:
    if end - i != j_end - j:
        return False
    for k in range(end - i):  # noqa: SIM110  (compiled)
        if d[i + k] != d[j + k]:
            return False
    return True


@_compiled
def _text(d: Any, i: int, end: int, text: Any, table: Any, size: Any) -> Any:
    """Number of a text; equal texts get the same number as a rule."""
    h = np.uint64(14695981039346656037)
    for k in range(i, end):
        h = (h ^ np.uint64(d[k])) * np.uint64(1099511628211)
    h ^= h >> np.uint64(32)
    tag = np.int64(h >> np.uint64(1))
    mask = len(table) - 1
    slot = tag & mask
    for _ in range(PROBES):
        known = table[slot]
        if known < 0 or (text[known, 2] == tag and _same(d, i, end, text[known, 0], text[known, 1])):
            break
        slot = (slot + 1) & mask
    known = table[slot]
    if known >= 0 and text[known, 2] == tag and _same(d, i, end, text[known, 0], text[known, 1]):
        return np.int64(known)
    number = size[_TEXTS]
    size[_TEXTS] += 1
    text[number, 0], text[number, 1], text[number, 2] = i, end, tag
    if known < 0:
        table[slot] = number
    return number


@_compiled
def _attributes(
    d: Any, i: int, skip_id: bool, into: Any, first: int, text: Any, table: Any, size: Any
) -> Any:
    """All attributes of a start tag, from after its name.

    Returns (next, number of attributes kept, id start, id end); next stands on "/" or ">", or is -1.
    """
    count, id_start, id_end = 0, -1, -1
    while True:
        j = _space(d, i)
        if d[j] == _GT or d[j] == _SLASH:
            return j, count, id_start, id_end
        end, value, value_end, after = _attribute(d, j)
        if after < 0 or j == i or count >= MAX_ATTRIBUTES or _is(d, j, end, _XMLNS):
            return -1, 0, 0, 0
        i = after
        if skip_id and _is(d, j, end, _ID):
            if id_start >= 0:
                return -1, 0, 0, 0
            id_start, id_end = value, value_end
            continue
        name = _text(d, j, end, text, table, size)
        for k in range(first, first + count):
            if _same(d, j, end, text[into[k, 0], 0], text[into[k, 0], 1]):
                return -1, 0, 0, 0
        into[first + count, 0] = name
        into[first + count, 1] = _text(d, value, value_end, text, table, size)
        count += 1


@_compiled
def _closed(d: Any, i: int) -> int:
    """After "/>" at i, or -1."""
    i = _space(d, i)
    return i + 2 if d[i] == _SLASH and d[i + 1] == _GT else -1


@_compiled
def _pair(d: Any, i: int, tag: Any, text: Any, table: Any, size: Any) -> int:
    """`k` and `v` of a tag, in any order; returns what follows the element, or -1."""
    key, value = -1, -1
    for _ in range(2):
        j = _space(d, i)
        end, start, stop, i = _attribute(d, j)
        if i < 0 or end - j != 1 or d[j - 1] > 32:
            return -1
        if d[j] == _K and key < 0:
            key = _text(d, start, stop, text, table, size)
        elif d[j] == _V and value < 0:
            value = _text(d, start, stop, text, table, size)
        else:
            return -1
    n = size[_TAGS]
    tag[n, 0], tag[n, 1] = key, value
    size[_TAGS] += 1
    return _closed(d, i)


@_compiled
def _item(d: Any, i: int, member: bool, item: Any, text: Any, table: Any, size: Any) -> int:
    """`ref` of an nd, or `type`, `ref` and `role` of a member; returns what follows the element, or -1."""
    kind, role = -1, -1
    seen_ref, ref = False, np.int64(0)
    for _ in range(3 if member else 1):
        j = _space(d, i)
        end, start, stop, i = _attribute(d, j)
        if i < 0 or d[j - 1] > 32:
            return -1
        if _is(d, j, end, _REF) and not seen_ref:
            seen_ref, ref = _integer(d, start, stop)
            if not seen_ref:
                return -1
        elif member and _is(d, j, end, _TYPE) and kind < 0:
            kind = _text(d, start, stop, text, table, size)
        elif member and _is(d, j, end, _ROLE) and role < 0:
            role = _text(d, start, stop, text, table, size)
        else:
            return -1
    n = size[_ITEMS]
    item[n, 0], item[n, 1], item[n, 2] = ref, kind, role
    size[_ITEMS] += 1
    return _closed(d, i)


@_compiled
def _close_tag(d: Any, i: int, name: int, name_end: int) -> int:
    """What follows the end tag "</name>" at the "<" at i, or -1."""
    if d[i + 1] != _SLASH:
        return -1
    end = _name(d, i + 2)
    if not _same(d, i + 2, end, name, name_end):
        return -1
    end = _space(d, end)
    return end + 1 if d[end] == _GT else -1


@_compiled
def _children(d: Any, i: int, kind: int, out: Any, table: Any, size: Any) -> int:
    """All children of a node, way or relation; returns where its end tag stands, or -1."""
    tag, item, text = out.tag, out.item, out.text
    while True:
        i = _space(d, i)
        if d[i] != _LT:
            return -1
        if d[i + 1] == _SLASH:
            return i
        end = _name(d, i + 1)
        if _is(d, i + 1, end, _TAG):
            i = _pair(d, end, tag, text, table, size)
        elif kind == WAY and _is(d, i + 1, end, _ND):
            i = _item(d, end, False, item, text, table, size)
        elif kind == RELATION and _is(d, i + 1, end, _MEMBER):
            i = _item(d, end, True, item, text, table, size)
        else:
            return -1
        if i < 0:
            return -1


@_compiled
def _plain_text(d: Any, i: int) -> int:
    """End of text without markup, references or carriage returns; -1 where it is not plain."""
    while d[i] != _LT:
        if (d[i] < 32 and d[i] != 9 and d[i] != 10) or d[i] == _AND or d[i] == _BRACKET:
            return -1
        i += 1
    return i


@_compiled
def _kind(d: Any, name: int, end: int) -> int:
    if _is(d, name, end, _NODE):
        return NODE
    if _is(d, name, end, _WAY):
        return WAY
    return RELATION if _is(d, name, end, _RELATION) else OTHER


@_compiled
def _element(d: Any, i: int, out: Any, table: Any, size: Any) -> int:
    """One top-level element, from its "<"; returns what follows it, or -1."""
    start, name = i, i + 1
    end = _name(d, name)
    if end == name:
        return -1
    kind = _kind(d, name, end)
    plain = kind != OTHER
    first = size[_ATTRIBUTES]
    i, count, id_start, id_end = _attributes(d, end, plain, out.attribute, first, out.text, table, size)
    number = np.int64(0)
    if plain and i >= 0:
        size[_ATTRIBUTES] += count
        good, number = _integer(d, id_start, id_end)
        if id_start < 0 or not good:
            return -1
    if i < 0:
        return -1
    if d[i] == _SLASH:
        i = i + 2 if d[i + 1] == _GT else -1
    else:
        i = _children(d, i + 1, kind, out, table, size) if plain else _plain_text(d, i + 1)
        if i >= 0:
            i = _close_tag(d, i, name, end)
    n = size[_ELEMENTS]
    row = out.element[n]
    row[0], row[1], row[5], row[6] = kind, number, start, i
    row[2], row[3], row[4] = size[_ATTRIBUTES], size[_TAGS], size[_ITEMS]
    size[_ELEMENTS] += 1
    return i


@_compiled
def scan_document(d: Any, i: int, out: Any, table: Any, size: Any) -> bool:
    """The root element and everything in it, to the end of the file."""
    root, end = i + 1, _name(d, i + 1)
    if d[i] != _LT or not _is(d, root, end, _OSM):
        return False
    i, count, _, _ = _attributes(d, end, False, out.root, 0, out.text, table, size)
    size[_ROOT_ATTRIBUTES] = count
    if i < 0 or d[i] != _GT:
        return False
    i += 1
    while True:
        i = _space(d, i)
        if d[i] != _LT:
            return False
        if d[i + 1] == _SLASH:
            break
        i = _element(d, i, out, table, size)
        if i < 0:
            return False
    i = _close_tag(d, i, root, end)
    return i > 0 and _space(d, i) == len(d) - 1
