"""How long planning takes for very many maps: `python -m tests.fleet.fleet_planner --maps 100000`.

One town is run for real; the others are links to its files under other names, settled as the real one was. What is
timed is what an update does before it starts anything: read the fleet file, look at every map.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from fleet_town import drive_again, write_fleet

from flexmap_tasks.engine.sources import look
from flexmap_tasks.store.artifact import seal, unseal
from flows import fleet_commands
from flows.fleet_index import Index, made_with
from flows.fleet_jobs import load_fleet, open_store
from flows.fleet_plan import plan_fleet

LINKS = 10_000
"""File systems allow some ten thousand links to one file."""


@dataclass(frozen=True, slots=True)
class Planned:
    """What an update of that many maps costs before it starts anything, CPU seconds.

    read_s : the fleet file; plan_s : to look at every map; wall_s : both, by the clock on the wall
    """

    maps: int
    read_s: float
    plan_s: float
    wall_s: float


def planned(sizes: Sequence[int], new: int) -> Iterator[Planned]:
    """Plan fleets of growing size in which that many maps have a new recording and all others none."""
    with tempfile.TemporaryDirectory(prefix="flexmap-planner-") as name:
        root = Path(name)
        file = write_fleet(root, 1)
        time.sleep(2.5)  # what is younger than two seconds is not trusted by its time stamps
        fleet_commands._update_here(file)
        fleet_commands._update_here(file)
        shutil.copy(root / "store" / "fleets" / "towns.json", root / "first_index.json")
        there = 0
        for size in sizes:
            grow(root, file, there, size)
            there = size
            for n in range(new):
                drive_again(root / f"town{size - 1 - n:06d}", 1, night=2)
            yield _plan(file, size, new)


def _plan(file: Path, maps: int, new: int) -> Planned:
    wall, clock = time.perf_counter(), time.process_time()
    fleet = load_fleet(file)
    read_s = time.process_time() - clock
    rows, todo = plan_fleet(open_store(fleet), fleet)
    plan_s = time.process_time() - clock - read_s
    assert len(todo) == new, [item.why for item in todo]
    assert len(rows) == maps - new
    return Planned(maps, read_s, plan_s, time.perf_counter() - wall)


def grow(root: Path, file: Path, begin: int, end: int) -> None:
    """Maps of these numbers, each with files of its own; then the lines that an update of all would have left."""
    store = open_store(load_fleet(file))
    latest = (store.releases / "town00" / "latest").readlink()
    for n in range(begin, end):
        name = f"town{n:06d}"
        _same_files(root / "town00", root / f"copy{n // LINKS:03d}", root / name, fresh=n % LINKS == 0)
        (store.releases / name).mkdir()
        (store.releases / name / "latest").symlink_to(latest)
    entries = []
    for n in range(end):
        name = f"town{n:06d}"
        recordings = f"{{folder: {name}/recordings, settle_s: 0, order: name}}"
        entries.append(f"- {{name: {name}, config: {name}/map.yaml, recordings: {recordings}}}\n")
    file.write_text(f"name: towns\nstore: store\nmaps:\n{''.join(entries)}")
    settle(root, file)


def _same_files(town: Path, copy: Path, folder: Path, *, fresh: bool) -> None:
    """The town's files in another folder, as links to a copy that is made anew now and then."""
    if fresh:
        shutil.copytree(town, copy, ignore=shutil.ignore_patterns("simulated"))
    (folder / "recordings").mkdir(parents=True)
    for file in ("map.yaml", "lanelet2_map.osm", "osm_extract.osm", "recordings/night1.mcap"):
        os.link(copy / file, folder / file)


def settle(root: Path, file: Path) -> None:
    """Write the lines of all maps."""
    fleet = load_fleet(file)
    store = open_store(fleet)
    index = Index(store, fleet, made_with())
    body = unseal((root / "first_index.json").read_bytes())
    assert body is not None
    first = body["lines"]["town00"]
    lines = {}
    for entry in fleet.maps:
        files = [path.replace("/town00/", f"/{entry.name}/") for path in first["files"]]
        lines[entry.name] = {**first, "entry": index._mark(entry)[0], "files": {f: look(f) for f in files},
                             "row": {**first["row"], "map": entry.name}}  # fmt: skip
    store.backend.put("fleets/towns.json", seal({**body, "lines": lines}), replace=True)


def main() -> None:
    """Say how long it takes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--maps", type=int, default=100_000)
    parser.add_argument("--new", type=int, default=3)
    given = parser.parse_args()
    for found in planned([given.maps], given.new):
        print(json.dumps({"new": given.new, **asdict(found)}))


if __name__ == "__main__":
    main()
