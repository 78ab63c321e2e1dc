"""Operations on tags, against dictionaries."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from flexmap_tasks.model.osm import Tags, rows_of

KEYS = st.sampled_from(["type", "subtype", "ele", "local_x", ""])
ROWS = st.lists(st.dictionaries(KEYS, st.text(max_size=3)), min_size=1, max_size=6)


def as_dicts(tags: Tags) -> list[dict[str, str]]:
    return [tags.of_element(i) for i in range(len(tags))]


@given(ROWS, st.data())
def test_with_values_is_dict_update_and_keeps_order(rows: list[dict[str, str]], data: st.DataObject) -> None:
    changes = data.draw(
        st.lists(st.tuples(st.integers(0, len(rows) - 1), KEYS, st.text(max_size=3)), max_size=8)
    )
    tags = Tags.of(rows)
    out = tags.with_values(
        np.array([c[0] for c in changes], dtype=np.int64), [c[1] for c in changes], [c[2] for c in changes]
    )
    wanted = [dict(r) for r in rows]
    for row, key, value in changes:
        wanted[row][key] = value
    assert [list(d.items()) for d in as_dicts(out)] == [list(d.items()) for d in wanted]
    assert as_dicts(tags) == rows


@given(ROWS, st.data())
def test_take_and_column(rows: list[dict[str, str]], data: st.DataObject) -> None:
    picked = data.draw(st.lists(st.integers(0, len(rows) - 1), max_size=8))
    tags = Tags.of(rows)
    assert as_dicts(tags.take(np.array(picked, dtype=np.int64))) == [rows[i] for i in picked]
    assert tags.column("ele").tolist() == [r.get("ele") for r in rows]
    assert tags.owner().tolist() == [i for i, r in enumerate(rows) for _ in r]


@given(st.lists(st.integers(-5, 5), unique=True), st.lists(st.integers(-6, 6)))
def test_rows_of(ids: list[int], wanted: list[int]) -> None:
    found = rows_of(np.array(ids, dtype=np.int64), np.array(wanted, dtype=np.int64))
    assert found.tolist() == [ids.index(w) if w in ids else -1 for w in wanted]
