"""A simulated fleet: small towns, each with a drive, and files as a fleet finds them."""

from __future__ import annotations

import shutil
from pathlib import Path

import yaml

from flexmap_tasks.simulate.world import World
from flexmap_tasks.simulate.write import write_world

BASE = {
    "map": "any",
    "gnss": {"file": "arrives.mcap"},
    "slam": {"file": "arrives.mcap"},
    "lanelet_map": {"file": "lanelet2_map.osm"},
    "osm": {"file": "osm_extract.osm"},
    "alignment": {"method": "rigid"},
}


def town(seed: int) -> World:
    """Four streets around a block, driven along once."""
    return World(
        name=f"town{seed}",
        seed=seed,
        network={"blocks_x": 1, "blocks_y": 1, "block_m": 100.0},
        drive={"length_m": 300.0},
        cloud={"points": 500, "truth_points": 10},
        control_points={"count": 3},
    )


def write_town(folder: Path, seed: int, **settings: object) -> None:
    """A town with its first recording, and the config that leaves the recording to the fleet."""
    write_world(town(seed), folder / "simulated")
    for name in ("lanelet2_map.osm", "osm_extract.osm"):
        shutil.copy(folder / "simulated" / name, folder / name)
    (folder / "recordings").mkdir()
    shutil.copy(folder / "simulated" / "recording.mcap", folder / "recordings" / "night1.mcap")
    (folder / "map.yaml").write_text(yaml.safe_dump({**BASE, **settings}))


def drive_again(folder: Path, seed: int, night: int) -> None:
    """Another recording of the same town: the same way, with other errors of the receiver."""
    again = town(seed).changed(gnss={"white_sigma_m": 0.01 + 0.001 * night})
    write_world(again, folder / "again")
    shutil.copy(folder / "again" / "recording.mcap", folder / "recordings" / f"night{night}.mcap")


def write_fleet(root: Path, maps: int, **settings: object) -> Path:
    """A fleet of that many towns; the path of its file."""
    entries = []
    for n in range(maps):
        write_town(root / f"town{n:02d}", seed=n + 1)
        entries.append(
            {
                "name": f"town{n:02d}",
                "config": f"town{n:02d}/map.yaml",
                "recordings": {"folder": f"town{n:02d}/recordings", "settle_s": 0, "order": "name"},
            }
        )
    file = root / "fleet.yaml"
    file.write_text(yaml.safe_dump({"name": "towns", "store": "store", "maps": entries, **settings}))
    return file


def break_log(folder: Path) -> None:
    """The recording as a lost connection leaves it."""
    log = folder / "recordings" / "night1.mcap"
    log.write_bytes(log.read_bytes()[:3000])
