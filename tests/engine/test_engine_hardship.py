"""Full disks, read-only stores and clocks that jump: one clear line, nothing lost, the same bytes afterwards."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from work import files_of, run_toy

from flexmap_tasks.engine.gc import collect
from flexmap_tasks.engine.verify import verify
from flexmap_tasks.store.store import Store

SMALL_DISK = """
import json, os, subprocess, sys
from pathlib import Path
sys.path[:0] = json.loads(sys.argv[3])
from work import files_of, run_toy
from flexmap_tasks.engine.verify import verify
from flexmap_tasks.errors import FlexMapError
from flexmap_tasks.store.store import Store

disk, numbers = Path(sys.argv[1]), Path(sys.argv[2])
filler, said, early = disk / "filler", [], 0
for left in range(0, 140_000, 12_288):
    subprocess.run(["rm", "-rf", *map(str, disk.iterdir())], check=True)
    free = os.statvfs(disk)
    filler.write_bytes(bytes(max(0, free.f_bavail * free.f_frsize - left)))
    store = Store.open(disk / "store", disk / "releases")
    try:
        run_toy(store, numbers)
    except FlexMapError as error:
        early += 1
        said.append(str(error))
    filler.unlink()
    release = run_toy(store, numbers)
    assert verify(store).damages == ()
    files = {name: content.hex() for name, content in files_of(release.folder).items()}
subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
readable = store.find(next(iter(store.records())).key) is not None
try:
    store.check_writable()
    refused = ""
except FlexMapError as error:
    refused = str(error)
print(json.dumps({"said": said, "early": early, "files": files, "readable": readable, "refused": refused}))
"""


@pytest.fixture
def numbers(tmp_path: Path) -> Path:
    file = tmp_path / "numbers.txt"
    file.write_text("1\n2\n3\n4\n")
    return file


def test_a_disk_that_fills_at_any_moment_and_one_that_is_read_only(tmp_path, numbers):
    """On a real file system of half a megabyte, in a name space of its own."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["unshare", "--map-root-user", "--mount", "sh", "-c"]
    probe = f"mount -t tmpfs -o size=512k tmpfs {disk}"
    tried = (
        subprocess.run([*mount, probe], capture_output=True, check=False) if shutil.which("unshare") else None
    )
    if tried is None or tried.returncode != 0:
        pytest.skip("this machine lets nobody mount a file system of his own")
    paths = json.dumps([str(Path(__file__).parent), str(Path(__file__).parents[2])])
    inside = f'{probe} && exec "$0" -c "$1" "$2" "$3" "$4"'
    done = subprocess.run(
        [*mount, inside, sys.executable, SMALL_DISK, str(disk), str(numbers), paths],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    calm = run_toy(Store.open(tmp_path / "calm"), numbers)
    assert told["files"] == {name: content.hex() for name, content in files_of(calm.folder).items()}
    assert told["early"] >= 4, "else this proved little"
    assert all("o space left" in line and "\n" not in line for line in told["said"]), told["said"]
    assert told["readable"]
    assert "read-only" in told["refused"]


@pytest.mark.parametrize("jump_s", [-10 * 365 * 86_400, 10 * 365 * 86_400])
def test_a_clock_that_jumps_costs_no_result(tmp_path, numbers, jump_s):
    store = Store.open(tmp_path / "store")
    first = run_toy(store, numbers)
    before = files_of(first.folder)
    for part in ("objects", "actions", "runs", "memo"):
        for file in (tmp_path / "store" / part).rglob("*"):
            os.utime(file, (time.time() + jump_s, time.time() + jump_s))
    swept = collect(store, keep_runs=1, keep_days=0, grace_s=3600)
    assert (swept.blobs, swept.records) == (0, 0), "all of it is part of a release"
    assert verify(store).damages == ()
    again = run_toy(store, numbers)
    assert (again.id, again.fresh, files_of(again.folder)) == (first.id, False, before)
