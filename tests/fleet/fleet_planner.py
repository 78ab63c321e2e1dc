"""How long planning takes for very many maps: `python -m tests.fleet.fleet_planner --maps 100000`.

One town is run for real; the others are links to its files under other names, settled as the real one was. What is
timed is what an update does before it starts anything: read the fleet file, look at every map.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from fleet_town import drive_again, write_fleet

from flexmap_tasks.store.artifact import seal, unseal
from flows import fleet_commands
from flows.fleet_index import Index, look, made_with
from flows.fleet_jobs import load_fleet, open_store
from flows.fleet_plan import plan_fleet


def grow(root: Path, file: Path, maps: int) -> None:
    """That many maps, each with files of its own, and the lines that an update of them would have left."""
    store = open_store(load_fleet(file))
    body = unseal(store.backend.get("fleets/towns.json"))
    assert body is not None
    lines = body["lines"]
    first, entries = lines["town00"], []
    for n in range(maps):
        name = f"town{n:06d}"
        folder = root / name
        shutil.copytree(root / "town00", folder, copy_function=lambda a, b: Path(b).hardlink_to(a),
                        ignore=shutil.ignore_patterns("simulated"))  # fmt: skip
        (store.releases / name).mkdir()
        (store.releases / name / "latest").symlink_to(first["latest"])
        recordings = f"{{folder: {name}/recordings, settle_s: 0, order: name}}"
        entries.append(f"- {{name: {name}, config: {name}/map.yaml, recordings: {recordings}}}\n")
    file.write_text(f"name: towns\nstore: store\nmaps:\n{''.join(entries)}")
    settle(root, file, maps)


def settle(root: Path, file: Path, maps: int) -> None:
    """Write the lines of all maps."""
    fleet = load_fleet(file)
    store = open_store(fleet)
    index = Index(store, fleet, made_with())
    body = unseal(store.backend.get("fleets/towns.json"))
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
    with tempfile.TemporaryDirectory(prefix="flexmap-planner-") as name:
        root = Path(name)
        file = write_fleet(root, 1)
        time.sleep(2.5)
        fleet_commands._update_here(file)
        fleet_commands._update_here(file)
        grow(root, file, given.maps)
        for n in range(given.new):
            drive_again(root / f"town{n:06d}", 1, night=2)
        clock = time.perf_counter()
        fleet = load_fleet(file)
        read_s = time.perf_counter() - clock
        rows, todo = plan_fleet(open_store(fleet), fleet)
        seconds = time.perf_counter() - clock
        assert len(todo) == given.new, [item.why for item in todo]
        assert len(rows) == given.maps - given.new
        print(
            json.dumps(
                {
                    "maps": given.maps,
                    "new": given.new,
                    "read_s": round(read_s, 1),
                    "plan_s": round(seconds, 1),
                }
            )
        )


if __name__ == "__main__":
    main()
