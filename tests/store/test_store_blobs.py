"""Blobs are what their names say, or they are not served; records count only while they can be trusted."""

from __future__ import annotations

import errno
import os
import random
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexmap_tasks.errors import StoreError
from flexmap_tasks.store.artifact import Artifact, Blob, seal, unseal
from flexmap_tasks.store.store import (
    ActionRecord,
    CorruptBlobError,
    Store,
    format_record,
    object_key,
    parse_record,
)


def record(key: str, artifact: Artifact) -> ActionRecord:
    return ActionRecord(key, {"stage": "s", "inputs": {}}, artifact, 0.1, "2026-01-01T00:00:00+00:00", "host")


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store.open(tmp_path / "store")


def test_a_blob_comes_back_and_cannot_be_written_to(store):
    blob = store.put_blob(b"lane")
    assert store.read_blob(blob) == b"lane"
    assert store.put_blob(b"lane") == blob
    mode = (store.backend.root / object_key(blob.sha256)).stat().st_mode
    assert mode & 0o222 == 0
    assert list((store.backend.root / "tmp").iterdir()) == []


def test_no_flipped_bit_is_ever_served(store):
    rng = random.Random(1)
    content = bytes(rng.randbytes(300))
    for _ in range(300):
        blob = store.put_blob(content)
        file = store.backend.root / object_key(blob.sha256)
        damaged = bytearray(content)
        damaged[rng.randrange(300)] ^= 1 << rng.randrange(8)
        file.unlink()
        file.write_bytes(bytes(damaged[: rng.choice([300, rng.randrange(300)])]))
        with pytest.raises(CorruptBlobError):
            store.read_blob(blob)
        assert not file.exists()


@given(st.data())
def test_no_damaged_record_is_ever_parsed(data):
    artifact = Artifact.of({"a.parquet": Blob("0" * 64, 4), "b/c.json": Blob("1" * 64, 5)})
    whole = record("k" * 64, artifact)
    content = format_record(whole)
    assert parse_record(content) == whole
    at = data.draw(st.integers(0, len(content) - 1))
    damaged = bytearray(content)
    damaged[at] ^= data.draw(st.integers(1, 255))
    assert parse_record(bytes(damaged)) is None
    assert parse_record(content[:at]) is None


@given(st.binary(max_size=200))
def test_arbitrary_bytes_are_no_document(content):
    assert unseal(content) is None
    assert unseal(seal({"x": content.hex()})) == {"x": content.hex()}


def test_a_record_without_its_blobs_is_a_miss(store):
    artifact = Artifact.of({"a": store.put_blob(b"1234")})
    store.put_record(record("a" * 64, artifact))
    assert store.find("a" * 64) is not None
    store.backend.delete(object_key(artifact.files[0][1].sha256))
    assert store.find("a" * 64) is None
    assert store.find("b" * 64) is None


def test_the_first_of_two_writers_counts(store):
    first = record("a" * 64, Artifact.of({"a": store.put_blob(b"1")}))
    second = record("a" * 64, Artifact.of({"a": store.put_blob(b"2")}))
    assert store.put_record(first) == first
    assert store.put_record(second) == first
    assert store.find("a" * 64) == first


def test_many_writers_at_once(store):
    blobs: list[Blob] = []

    def work(seed: int) -> None:
        rng = random.Random(seed)
        blobs.extend(store.put_blob(b"x" * rng.randrange(20)) for _ in range(40))

    threads = [threading.Thread(target=work, args=(i,)) for i in range(8)]
    [t.start() for t in threads]
    [t.join() for t in threads]
    assert len(blobs) == 320
    assert all(len(store.read_blob(b)) == b.size for b in blobs)


def test_a_full_disk_is_one_clear_line_and_leaves_nothing(store, monkeypatch):
    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StoreError, match="no space left") as caught:
        store.put_blob(b"lane")
    assert "\n" not in str(caught.value)
    assert [p for p in store.backend.root.rglob("*") if p.is_file()] == []


def test_a_store_that_is_no_folder_is_one_clear_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="no folder"):
        Store.open(tmp_path / "file").check_writable()


KILLED = """
import sys
from flexmap_tasks.store.store import Store
store = Store.open(sys.argv[1])
i = 0
while True:
    store.put_blob(str(i).encode() * 2000)
    i += 1
"""


def test_a_killed_writer_leaves_only_whole_blobs(tmp_path):
    for attempt in range(5):
        process = subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path)])
        store = Store.open(tmp_path)
        while not list(store.backend.entries("objects")):
            pass
        threading.Event().wait(0.02 * attempt)
        process.kill()
        process.wait()
        for entry in store.backend.entries("objects"):
            sha256 = entry.key.removeprefix("objects/").replace("/", "")
            content = store.backend.get(entry.key)
            assert store.read_blob(Blob(sha256, len(content or b""))) == content
