"""Thousands of flipped bits and cut files: not one wrong byte is served."""

from __future__ import annotations

import os
import random
from pathlib import Path

import pytest

from flexmap_tasks.store.artifact import Artifact, digest_of
from flexmap_tasks.store.store import ActionRecord, CorruptBlobError, Store

DAMAGES = 2000
ACTIONS = 4


def fill(store: Store) -> dict[str, dict[str, bytes]]:
    rng = random.Random(1)
    made = {}
    for i in range(ACTIONS):
        key = digest_of(str(i).encode())
        made[key] = {f"{n}.bin": rng.randbytes(rng.randrange(1, 400)) for n in range(3)}
        output = Artifact.of({name: store.put_blob(content) for name, content in made[key].items()})
        store.put_record(
            ActionRecord(key, {"stage": str(i)}, output, 1.0, "2026-01-01T00:00:00+00:00", "host")
        )
    return made


def test_two_thousand_damages_and_not_one_wrong_byte(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda _descriptor: None)
    store = Store.open(tmp_path)
    made = fill(store)
    rng = random.Random(2)
    met = 0
    victims = sorted(
        p for part in ("objects", "actions") for p in (tmp_path / part).rglob("*") if p.is_file()
    )
    for i in range(DAMAGES):
        victim = rng.choice(victims)
        content = bytearray(victim.read_bytes())
        victim.unlink()
        if rng.random() < 0.5:
            content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        else:
            content = content[: rng.randrange(len(content))]
        victim.write_bytes(bytes(content))
        met += read_all(store, made)
        if i % 50 == 0:
            assert read_all(store, made) == 0  # healed, as by a run
    assert met == DAMAGES


def read_all(store: Store, made: dict[str, dict[str, bytes]]) -> int:
    """Serve every action as a run would, and make anew what cannot be served; how often that was."""
    anew = 0
    for i, (key, files) in enumerate(made.items()):
        record = store.find(key)
        try:
            if record is None:
                raise CorruptBlobError(key)
            assert record.preimage == {"stage": str(i)}
            assert {name: store.read_blob(blob) for name, blob in record.output.files} == files
        except CorruptBlobError:
            anew += 1
            output = Artifact.of({name: store.put_blob(content) for name, content in files.items()})
            store.put_record(
                ActionRecord(key, {"stage": str(i)}, output, 1.0, "2026-01-01T00:00:00+00:00", "host")
            )
    return anew


@pytest.mark.parametrize("content", [b"", b"{}", b"null", b"[]", b'{"checksum":1}', b"\xff\xfe"])
def test_what_is_no_record_is_a_miss(tmp_path: Path, content):
    store = Store.open(tmp_path)
    key = digest_of(b"1")
    store.backend.put(f"actions/{key[:2]}/{key[2:]}.json", content)
    assert store.find(key) is None
