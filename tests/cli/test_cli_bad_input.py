"""Bad input gets one clear line and exit code 2, and leaves nothing half-written."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.simulate.world import World
from flexmap_tasks.simulate.write import write_world
from flows import cli

PROJECT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("town")
    write_world(load_config(World, PROJECT / "configs" / "worlds" / "small_town.yaml"), folder)
    (folder / "gnss.txt").write_text("".join(f"48.{26000 + i} 11.{66900 + i}\n" for i in range(50)))
    return folder


@pytest.fixture
def inputs(town: Path, tmp_path: Path) -> Path:
    """A copy of the town that a test may spoil, and a configuration beside it."""
    folder = tmp_path / "town"
    shutil.copytree(town, folder, ignore=shutil.ignore_patterns("truth", "*.pcd"))
    (folder / "map.yaml").write_text(
        "map: town\n"
        "gnss: {file: recording.mcap}\n"
        "slam: {file: recording.mcap}\n"
        "lanelet_map: {file: lanelet2_map.osm}\n"
        "osm: {file: osm_extract.osm}\n"
        "alignment: {method: rubber_sheet, control_points_file: control_points.csv}\n"
    )
    return folder


Result = tuple[int, str]


@pytest.fixture
def flexmap(
    inputs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Result]:
    """Run the command on the town; exit code and what stands on stderr."""

    def call(*more: str, store: Path | None = None) -> Result:
        store = store or inputs.parent / "store"
        argv = ["flexmap", "run", str(inputs / "map.yaml"), "--no-prefect", "--store", str(store), *more]
        monkeypatch.setattr("sys.argv", argv)
        code = 0
        try:
            cli.main()
        except SystemExit as done:
            code = int(done.code or 0)
        return code, capsys.readouterr().err

    return call


def replaced(text: str, old: str, new: str, count: int = 1) -> str:
    assert old in text
    return text.replace(old, new, count)


def spoil(file: str, edit: Callable[[bytes], bytes]) -> Callable[[Path], list[str]]:
    def act(folder: Path) -> list[str]:
        content = (folder / file).read_bytes()
        (folder / file).write_bytes(edit(content))
        return []

    return act


def write_text(file: str, content: str, *sets: str) -> Callable[[Path], list[str]]:
    def act(folder: Path) -> list[str]:
        (folder / file).write_text(content)
        return [part for s in sets for part in ("--set", s.format(folder=folder))]

    return act


def remove(file: str) -> Callable[[Path], list[str]]:
    def act(folder: Path) -> list[str]:
        (folder / file).unlink()
        return []

    return act


def first_way_ref(content: bytes) -> bytes:
    return re.sub(rb'<nd ref="\d+"', b'<nd ref="99999999"', content, count=1)


def doubled_node(content: bytes) -> bytes:
    node = re.search(rb"  <node .*?</node>\n", content, re.S)
    assert node
    return content.replace(node[0], node[0] * 2, 1)


def points(*rows: str) -> Callable[[Path], list[str]]:
    return write_text("control_points.csv", "source_row,target_row,name\n" + "".join(f"{r}\n" for r in rows))


TEXT_GNSS = "gnss.file={folder}/gnss.txt"
BAD: dict[str, tuple[Callable[[Path], list[str]], str]] = {
    "no such file": (remove("recording.mcap"), "recording.mcap"),
    "empty recording": (spoil("recording.mcap", lambda _c: b""), "recording.mcap"),
    "truncated recording": (spoil("recording.mcap", lambda c: c[: len(c) // 2]), "recording.mcap"),
    "no recording at all": (spoil("recording.mcap", lambda _c: os.urandom(1000)), "recording.mcap"),
    "no fitting topic": (lambda _f: ["--set", "gnss.topic=/none"], "/none"),
    "header line": (write_text("gnss.txt", "lat lon\n48.1 11.2\n", TEXT_GNSS), "gnss.txt line 1"),
    "not a number": (write_text("gnss.txt", "48.1 11.2\n48.1 nan\n", TEXT_GNSS), "gnss.txt line 2"),
    "out of range": (write_text("gnss.txt", "48.1 11.2\n98.1 11.2\n", TEXT_GNSS), "gnss.txt line 2"),
    "too few poses": (
        write_text("poses.txt", "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "slam.file={folder}/poses.txt"), "3 distinct"
    ),
    "tracks that cannot belong together": (
        write_text(
            "poses.txt", "".join(f"{i} {i * 1000} {i * i * 90} 0 0 0 0 1\n" for i in range(30)),
            "slam.file={folder}/poses.txt",
        ),
        "SLAM",
    ),
    "camera axes": (
        write_text(
            "poses.txt", "".join(f"{i} 0 0 {i} 0 0 0 1\n" for i in range(100)), "slam.file={folder}/poses.txt",
            "alignment.method=pose_graph", "alignment.control_points_file=null",
        ),
        "z must point up",
    ),
    "no control points": (points(), "control"),
    "two control points": (points("10,100,a", "200,1000,b"), "at least 3"),
    "doubled control points": (points("10,100,a", "10,400,b", "300,1500,c", "400,2000,d"), "same source"),
    "dangling reference": (spoil("lanelet2_map.osm", first_way_ref), "99999999"),
    "doubled id": (spoil("lanelet2_map.osm", doubled_node), "lanelet2_map.osm"),
    "XML with entities": (
        spoil("osm_extract.osm", lambda c: c.replace(b"<osm", b'<!DOCTYPE x [<!ENTITY a "b">]><osm', 1)), "osm_extract.osm"
    ),
    "map with entities": (
        spoil("lanelet2_map.osm", lambda c: c.replace(b"<osm", b'<!DOCTYPE x [<!ENTITY a "b">]><osm', 1)),
        "lanelet2_map.osm",
    ),
    "truncated XML": (spoil("lanelet2_map.osm", lambda c: c[:-200]), "lanelet2_map.osm"),
    "unknown key": (lambda _f: ["--set", "alignment.metod=rigid"], "alignment.metod: unknown key"),
    "wrong value": (lambda _f: ["--set", "alignment.umeyama.points=two"], "alignment.umeyama.points"),
    "broken YAML": (write_text("map.yaml", "map: [town\n"), "map.yaml line"),
    "doubled key": (write_text("map.yaml", "map: a\nmap: b\n"), "stands twice"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_clear_line(case: str, inputs: Path, flexmap: Callable[..., Result]) -> None:
    act, words = BAD[case]
    code, err = flexmap(*act(inputs))
    assert code == 2, err
    lines = err.strip().splitlines()
    assert len(lines) == 1, err
    assert lines[0].startswith("flexmap: ")
    assert words in lines[0]
    assert "Traceback" not in err
    store = inputs.parent / "store"
    assert not (store / "releases").exists()
    assert not list((store / "tmp").glob("*")) if (store / "tmp").exists() else True


def test_an_extract_of_another_place_is_refused(
    inputs: Path, flexmap: Callable[..., Result], shared_data: Path
) -> None:
    code, err = flexmap("--set", f"osm.file={shared_data / 'osm' / 'liechtenstein.osm.pbf'}")
    assert code == 2
    assert len(err.strip().splitlines()) == 1
    assert "cover" in err or "track" in err


def test_a_store_that_cannot_be_written_is_one_clear_line(
    inputs: Path, flexmap: Callable[..., Result]
) -> None:
    (inputs / "file").write_text("")
    code, err = flexmap(store=inputs / "file")
    assert code == 2
    assert err.startswith("flexmap: artifact store")
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize("value", ["variable", "", "2;3", "-1", "99999999999999999999"])
def test_odd_values_in_osm_never_end_a_run(inputs: Path, flexmap: Callable[..., Result], value: str) -> None:
    file = inputs / "osm_extract.osm"
    text = re.sub(r'<tag k="(lanes|maxspeed)" v="[^"]*"', rf'<tag k="\1" v="{value}"', file.read_text())
    file.write_text(text)
    code, err = flexmap()
    assert (code, err) == (0, "")


def test_a_lanelet_without_a_bound_is_kept_and_reported(inputs: Path, flexmap: Callable[..., Result]) -> None:
    file = inputs / "lanelet2_map.osm"
    text = file.read_text()
    lanelet = next(r for r in re.findall(r"  <relation .*?</relation>\n", text, re.S) if 'v="lanelet"' in r)
    id_ = re.search(r'id="(\d+)"', lanelet)
    assert id_
    maimed = re.sub(
        r'    <member type="way" ref="\d+" role="left"\s*/>\n|    <member type="way" role="left"[^\n]*\n',
        "",
        lanelet,
    )
    assert maimed != lanelet
    file.write_text(text.replace(lanelet, maimed))
    code, err = flexmap()
    assert (code, err) == (0, "")
    release = inputs.parent / "store" / "releases" / "town" / "latest"
    assert f'<relation id="{id_[1]}"' in (release / "lanelet2_map.osm").read_text()
    findings = pq.read_table(release / "map_findings.parquet").to_pylist()
    assert any(f["id"] == int(id_[1]) and f["code"] == "lanelet-without-bound" for f in findings)
