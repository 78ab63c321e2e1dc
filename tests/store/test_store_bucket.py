"""Input files in a bucket, over a real connection to moto's server: whole and right, or not at all."""

from __future__ import annotations

import random
import threading
import time
from datetime import timedelta
from pathlib import Path

import obstore
import pytest
from s3_server import BUCKET, BreakingProxy, serve_s3

from flexmap_tasks.engine import sources
from flexmap_tasks.engine.sources import file_stamp, local_path, look, source_artifact
from flexmap_tasks.errors import InputError, StoreError
from flexmap_tasks.store import bucket, s3
from flexmap_tasks.store.artifact import digest_of
from flexmap_tasks.store.store import Store

CONTENT = random.Random(1).randbytes(3_000_000)


@pytest.fixture(scope="module")
def server():
    with serve_s3() as environment:
        yield environment


@pytest.fixture
def url(server, tmp_path, monkeypatch) -> str:
    for name, value in server.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("FLEXMAP_CACHE", str(tmp_path / "cache"))
    return f"s3://{BUCKET}/{tmp_path.name}"


def put(url: str, content: bytes) -> bucket.BucketFile:
    name, key = bucket._parts(url)
    obstore.put(s3.open_bucket(name, None, url), key, content)
    found = bucket.look_at(url)
    assert found is not None
    return found


def test_an_object_looks_the_same_alone_and_in_a_list(url):
    for name in ("a/1.mcap", "a/b c/2.mcap", "ab/3.mcap"):
        put(f"{url}/{name}", name.encode())
    listed = {file.url: file for file in bucket.list_files(f"{url}/a")}
    assert sorted(listed) == [f"{url}/a/1.mcap", f"{url}/a/b c/2.mcap"]
    assert all(bucket.look_at(address) == file for address, file in listed.items())
    assert bucket.look_at(f"{url}/a/none.mcap") is None


def test_content_is_fetched_once_and_checked_whenever_it_is_used(url, monkeypatch):
    file = put(f"{url}/drive.mcap", CONTENT)
    first = bucket.fetch(file)
    assert first.read_bytes() == CONTENT
    asked: list[int] = []
    really = bucket._append
    monkeypatch.setattr(bucket, "_append", lambda f, p, have: (asked.append(have), really(f, p, have)))
    assert bucket.fetch(file, digest_of(CONTENT)) == first
    assert asked == []
    damaged = bytearray(CONTENT)
    damaged[1_000_000] ^= 1
    first.write_bytes(damaged)
    assert bucket.fetch(file).read_bytes() == CONTENT
    first.write_bytes(damaged)
    assert bucket.fetch(file, digest_of(CONTENT)).read_bytes() == CONTENT
    assert asked == [0, 0]


def test_a_fetch_that_broke_off_goes_on_where_it_stopped(url, monkeypatch):
    file = put(f"{url}/drive.mcap", CONTENT)
    target = bucket.fetch(file)
    target.rename(target.with_suffix(".part"))
    with target.with_suffix(".part").open("r+b") as part:
        part.truncate(1_234_567)  # as a killed process leaves it
    asked: list[int] = []
    really = bucket._append
    monkeypatch.setattr(bucket, "_append", lambda f, p, have: (asked.append(have), really(f, p, have)))
    assert bucket.fetch(file).read_bytes() == CONTENT
    assert asked == [1_234_567]
    target.unlink()
    target.with_suffix(".part").write_bytes(bytes(2_000_000))  # a full disk can leave holes
    with pytest.raises(StoreError, match="not what the server described"):
        bucket.fetch(file)
    assert not target.exists()
    assert bucket.fetch(file).read_bytes() == CONTENT


def test_lost_connections_cost_no_byte(url, server, monkeypatch):
    file = put(f"{url}/drive.mcap", CONTENT)
    monkeypatch.setattr(s3, "RETRIES", 0)  # so that it is ours to go on
    with BreakingProxy(server, down_bytes=700_000) as (port, broken):
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}")
        assert bucket.fetch(file).read_bytes() == CONTENT
    assert len(broken) >= 3


def test_an_object_that_changes_is_refused(url):
    old = put(f"{url}/drive.mcap", CONTENT)
    put(f"{url}/drive.mcap", CONTENT[::-1])
    with pytest.raises(InputError, match="changed while it was fetched"):
        bucket.fetch(old)


def test_a_server_that_is_gone_is_one_clear_line(url, monkeypatch):
    monkeypatch.setattr(s3, "RETRIES", 0)
    monkeypatch.setattr(s3, "RETRY_FOR", timedelta(seconds=1))
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    with pytest.raises(StoreError, match="cannot be used") as caught:
        file_stamp(Path(f"{url}/drive.mcap"))
    assert "\n" not in str(caught.value)


def test_a_bucket_file_is_a_source_like_any_other(url, tmp_path, monkeypatch):
    monkeypatch.setattr(sources, "RACY_NS", 0)
    store, path = Store.open(tmp_path / "store"), Path(f"{url}/drive.mcap")
    with pytest.raises(InputError, match="no such object"):
        source_artifact(store, path)
    assert look(path) == []
    put(f"{url}/drive.mcap", CONTENT)
    time.sleep(1.1)  # the server tells whole seconds
    artifact = source_artifact(store, path)
    ((_, blob),) = artifact.files
    assert (blob.sha256, blob.size) == (digest_of(CONTENT), len(CONTENT))
    with monkeypatch.context() as patch:
        patch.setattr(bucket, "fetch", lambda *_: pytest.fail("its digest is known"))
        assert source_artifact(store, path) == artifact
    assert tuple(look(path)) == file_stamp(path)


def test_two_processes_fetch_once(url):
    file = put(f"{url}/drive.mcap", CONTENT)
    found: list[bytes] = []
    threads = [
        threading.Thread(target=lambda: found.append(bucket.fetch(file).read_bytes())) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert found == [CONTENT] * 4


def test_local_files_stay_where_they_are(tmp_path):
    file = tmp_path / "a"
    file.write_bytes(b"1")
    assert local_path(file) == file
