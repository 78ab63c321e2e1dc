"""The same store on an S3-compatible server, over a real connection to moto's."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from s3_server import BUCKET, BreakingProxy, serve_s3

from flexmap_tasks.engine.gc import collect
from flexmap_tasks.engine.sync import copy_missing
from flexmap_tasks.engine.verify import verify
from flexmap_tasks.errors import StoreError
from flexmap_tasks.store import s3
from flexmap_tasks.store.artifact import Artifact, digest_of
from flexmap_tasks.store.store import ActionRecord, CorruptBlobError, Store, object_key


@pytest.fixture(scope="module")
def server():
    with serve_s3() as environment:
        yield environment


@pytest.fixture
def url(server, tmp_path, monkeypatch):
    for name, value in server.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("FLEXMAP_CACHE", str(tmp_path / "cache"))
    return f"s3://{BUCKET}/{tmp_path.name}"


@pytest.fixture
def store(url, tmp_path) -> Store:
    return Store.open(url, tmp_path / "releases")


def act(store: Store, number: int, content: bytes) -> ActionRecord:
    output = Artifact.of({"a": store.put_blob(content)})
    return store.put_record(ActionRecord(digest_of(str(number).encode()), {}, output, 0.0, "", "host"))


def files_in(folder: Path) -> list[Path]:
    return sorted(p for p in folder.rglob("*") if p.is_file())


def test_blobs_and_records(store, tmp_path):
    store.check_writable()
    record = act(store, 1, b"lane")
    assert store.find(record.key) == record
    assert store.find_all([record.key]) == [record]
    assert store.find(digest_of(b"nothing")) is None
    (blob,) = (blob for _, blob in record.output.files)
    assert store.read_blob(blob) == b"lane"
    assert store.local_blob(blob).read_bytes() == b"lane"
    assert store.local_blob(blob).is_relative_to(tmp_path / "cache")


def test_the_first_of_two_writers_counts(store, url):
    store.backend.put("actions/x", b"first")
    Store.open(url).backend.put("actions/x", b"second")
    assert store.backend.get("actions/x") == b"first"
    store.backend.put("actions/x", b"third", replace=True)
    assert store.backend.get("actions/x") == b"third"
    first, second = act(store, 1, b"1"), act(Store.open(url), 1, b"2")
    assert first == second


def test_large_content_goes_up_in_parts(store, monkeypatch):
    monkeypatch.setattr(s3, "PARTS_OVER_BYTES", 1_000_000)
    content = os.urandom(12_000_000)
    blob = store.put_blob(content)
    assert store.read_blob(blob) == content


def test_damage_on_the_server_is_never_served(store, url, tmp_path, monkeypatch):
    record = act(store, 1, b"lane")
    (blob,) = (blob for _, blob in record.output.files)
    store.backend.put(object_key(blob.sha256), b"line", replace=True)
    with pytest.raises(CorruptBlobError):
        Store.open(url).read_blob(blob)
    assert store.find(record.key) is None


def test_damage_in_the_cache_is_never_served(store, tmp_path):
    blob = store.put_blob(b"lane")
    store.read_blob(blob)
    (kept,) = files_in(tmp_path / "cache")
    kept.unlink()
    kept.write_bytes(b"line")
    assert store.read_blob(blob) == b"lane"
    assert kept.read_bytes() == b"lane"


def test_verify_looks_past_the_cache(store):
    blob = store.put_blob(b"lane")
    store.read_blob(blob)
    store.backend.put(object_key(blob.sha256), b"line", replace=True)
    assert [d.where for d in verify(store).damages] == [object_key(blob.sha256)]
    verify(store, repair=True)
    assert verify(store).damages == ()


def test_gc_sweeps_what_nothing_needs(store):
    act(store, 1, b"lane")
    assert collect(store, grace_s=3600).blobs == 0
    assert collect(store, keep_runs=0, keep_days=0, grace_s=-5).blobs == 1
    assert list(store.backend.entries("objects")) == []


def test_push_and_pull_copy_only_what_is_missing(store, tmp_path):
    folder, back = Store.open(tmp_path / "a"), Store.open(tmp_path / "b")
    records = [act(folder, i, str(i).encode()) for i in range(5)]
    act(store, 0, b"0")
    assert copy_missing(folder, store).blobs == 4
    assert copy_missing(folder, store).records == 0
    copy_missing(store, back)
    assert [back.find(record.key) for record in records] == records


@pytest.mark.parametrize("parts_over", [10_000_000, 500_000])
def test_a_connection_lost_in_the_middle_of_an_upload(server, monkeypatch, url, tmp_path, parts_over):
    content = bytes(range(256)) * 30_000
    monkeypatch.setattr(s3, "PARTS_OVER_BYTES", parts_over)
    with monkeypatch.context() as patch, BreakingProxy(server, up_bytes=700_000) as (port, broken):
        patch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}")
        patch.setattr(s3, "RETRIES", 0)
        with pytest.raises(StoreError, match="nothing that was stored is lost") as caught:
            Store.open(url).put_blob(content)
        assert broken
    assert "\n" not in str(caught.value)
    store = Store.open(url, tmp_path / "releases")
    assert store.backend.size(object_key(digest_of(content))) is None, "whole or not at all"
    assert store.read_blob(store.put_blob(content)) == content


def test_errors_are_one_clear_line(server, monkeypatch, url):
    with pytest.raises(StoreError, match="no such bucket"):
        Store.open("s3://nowhere/x").check_writable()
    with pytest.raises(StoreError, match="expected s3://bucket/prefix"):
        Store.open("s3://")
    with pytest.raises(StoreError, match="expected a folder or s3"):
        Store.open("gs://bucket/x")
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.setattr(s3, "RETRIES", 0)
    with pytest.raises(StoreError) as caught:
        Store.open(f"s3://{BUCKET}/x").check_writable()
    assert "\n" not in str(caught.value)
