"""Whatever happens to a store, in whatever order: what it serves is what was put."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from flexmap_tasks.engine.gc import collect
from flexmap_tasks.engine.runs import read_runs, write_last_run
from flexmap_tasks.engine.verify import verify
from flexmap_tasks.store.artifact import Artifact, Blob, digest_of
from flexmap_tasks.store.store import ActionRecord, CorruptBlobError, Store, object_key

CONTENTS = st.binary(max_size=12)
KEYS = st.integers(0, 5).map(lambda i: digest_of(str(i).encode()))


class Machine(RuleBasedStateMachine):
    @initialize()
    def begin(self) -> None:
        self.patch = pytest.MonkeyPatch()
        self.patch.setattr(os, "fsync", lambda _descriptor: None)  # damage is no loss of power
        self.folder = Path(tempfile.mkdtemp())
        self.store = Store.open(self.folder)
        self.other = Store.open(self.folder)  # a second process on the same folder
        self.known: dict[Blob, bytes] = {}
        self.made: dict[str, list[Artifact]] = {}
        self.damaged = False

    def teardown(self) -> None:
        self.patch.undo()
        shutil.rmtree(self.folder, ignore_errors=True)

    def files(self) -> list[Path]:
        return sorted(
            p
            for part in ("objects", "actions", "runs")
            for p in (self.folder / part).rglob("*")
            if p.is_file()
        )

    @rule(content=CONTENTS, second=st.booleans())
    def put(self, content: bytes, second: bool) -> None:
        blob = (self.other if second else self.store).put_blob(content)
        assert blob == Blob(digest_of(content), len(content))
        self.known[blob] = content

    @rule(key=KEYS, contents=st.lists(CONTENTS, max_size=3), second=st.booleans())
    def act(self, key: str, contents: list[bytes], second: bool) -> None:
        store = self.other if second else self.store
        blobs = {str(i): store.put_blob(content) for i, content in enumerate(contents)}
        self.known |= {blobs[str(i)]: content for i, content in enumerate(contents)}
        artifact = Artifact.of(blobs)
        before = store.find(key)
        kept = store.put_record(ActionRecord(key, {}, artifact, 0.0, "", ""))
        assert kept.output == (before.output if before else artifact)  # the first one counts
        self.made.setdefault(key, []).append(artifact)

    @rule(key=KEYS)
    def finish(self, key: str) -> None:
        if self.store.find(key) is not None:
            write_last_run(self.store, "map", {"stage": key})

    @rule(key=KEYS, content=CONTENTS)
    def crash_before_the_record(self, key: str, content: bytes) -> None:
        self.known[self.store.put_blob(content)] = content
        (self.folder / "tmp").mkdir(exist_ok=True)
        (self.folder / "tmp" / digest_of(content)[:8]).write_bytes(content[: len(content) // 2])

    @rule(data=st.data())
    def damage(self, data: st.DataObject) -> None:
        files = self.files()
        if not files:
            return
        file = data.draw(st.sampled_from(files))
        content = bytearray(file.read_bytes())
        how = data.draw(st.sampled_from(["flip", "cut", "delete"]))
        file.unlink()
        self.damaged = True
        if how == "flip" and content:
            content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
        if how == "cut":
            content = content[: data.draw(st.integers(0, max(0, len(content) - 1)))]
        if how != "delete":
            file.write_bytes(bytes(content))

    @rule(repair=st.booleans())
    def check(self, repair: bool) -> None:
        checked = verify(self.store, repair=repair)
        if not self.damaged:
            assert all("is gone" in damage.what for damage in checked.damages)
        if repair:
            assert all("is gone" in damage.what for damage in verify(self.store).damages)

    @rule(young=st.booleans())
    def sweep(self, young: bool) -> None:
        last = next(read_runs(self.store), None)
        found = self.store.find(last.actions["stage"]) if last else None
        collect(self.store, keep_runs=1, keep_days=0, grace_s=60 if young else 0)
        assert list((self.folder / "tmp").iterdir()) == [] or young
        if last is not None:
            assert self.store.find(last.actions["stage"]) == found  # what the last run needs stays

    @rule()
    def grow_old(self) -> None:
        for file in self.files():
            os.utime(file, (0, 0))

    @invariant()
    def what_is_served_is_what_was_put(self) -> None:
        for blob, content in list(self.known.items()):
            if self.store.backend.size(object_key(blob.sha256)) is not None:
                with contextlib.suppress(CorruptBlobError):
                    assert self.store.read_blob(blob) == content

    @invariant()
    def what_is_found_is_what_was_made(self) -> None:
        for key, artifacts in self.made.items():
            record = self.store.find(key)
            if record is None:
                continue
            assert record.output in artifacts
            for _, blob in record.output.files:
                with contextlib.suppress(CorruptBlobError):  # found, but damaged: refused, never served
                    assert self.store.read_blob(blob) == self.known[blob]


TestMachine = Machine.TestCase
TestMachine.settings = settings(
    max_examples=40, stateful_step_count=25, deadline=None, suppress_health_check=list(HealthCheck)
)
