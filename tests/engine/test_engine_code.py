"""Which code a stage is said to run."""

from __future__ import annotations

from dataclasses import replace

import pytest

from flexmap_tasks.engine import fingerprint
from flexmap_tasks.engine.fingerprint import code_modules, learn_code
from flexmap_tasks.errors import InputError

MODULE = "flexmap_tasks.alignment.umeyama"


def edited(monkeypatch, module: str, **changes) -> None:
    source = replace(fingerprint._SOURCES[module], **changes)
    monkeypatch.setitem(fingerprint._SOURCES, module, source)


def test_a_stage_reaches_what_it_imports_and_no_more():
    found = code_modules(MODULE)
    assert {MODULE, "flexmap_tasks.geometry.rigid"} <= set(found)
    assert not any(name.startswith(("flexmap_tasks.engine", "flexmap_tasks.config")) for name in found)
    assert "flexmap_tasks.matching.match" not in found


def test_comments_and_docstrings_do_not_count_but_code_does(monkeypatch):
    before = code_modules(MODULE)
    content = fingerprint._SOURCES[MODULE].content
    edited(monkeypatch, MODULE, content=b'"""Other words."""\n# a comment\n' + content.partition(b'"""\n')[2])
    assert code_modules(MODULE) == before
    edited(monkeypatch, MODULE, content=content + b"\nNEW = 1\n")
    changed = code_modules(MODULE)
    assert {name for name in changed if changed[name] != before.get(name)} == {MODULE}


def test_code_edited_while_the_process_was_starting_is_refused(monkeypatch):
    edited(monkeypatch, MODULE, late=True)
    with pytest.raises(InputError, match=r"umeyama\.py: was edited while FlexMap was starting"):
        code_modules(MODULE)
    assert code_modules("flexmap_tasks.geometry.utm")


def test_what_is_parsed_once_is_remembered(monkeypatch):
    memo = learn_code(None)
    assert memo is not None
    assert learn_code(memo) is None
    before = code_modules(MODULE)
    monkeypatch.setattr(fingerprint, "_PARSED", {})
    monkeypatch.setattr(fingerprint.ast, "parse", lambda _: pytest.fail("parsed again"))
    assert learn_code(memo) is None
    assert code_modules(MODULE) == before


@pytest.mark.parametrize("memo", [b"", b"{}", b"[1]", b"\xff"])
def test_a_damaged_memo_is_no_memo(memo):
    assert learn_code(memo) is not None
