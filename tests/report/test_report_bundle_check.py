"""The bundle read back: a good one passes, and each way to break it is found by its rule."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from report_runs import garching as garching_config
from report_runs import inputs_of

from flexmap_tasks.config import PointCloudParams
from flexmap_tasks.formats.pointcloud_metadata import metadata_bytes
from flexmap_tasks.model.arrays import strings
from flexmap_tasks.model.clouds import TileKeys
from flexmap_tasks.report.bundle_check import CODES, METADATA_FILE, check_bundle

MAP, PROJECTOR = "lanelet2_map.osm", "map_projector_info.yaml"
CORNERS = {"0_0.pcd": (0, 0), "-1_2.pcd": (-20, 40)}
KEYS = TileKeys(strings(["0_0", "-1_2"]))


@pytest.fixture(scope="module", params=["MGRS", "LocalCartesianUTM", "Local"])
def bundle(request: pytest.FixtureRequest, shared_data: Path) -> dict[str, bytes]:
    config = garching_config(shared_data / "garching", georeference={"projector": request.param})
    return inputs_of(config, "check_bundle")["check_bundle"]["bundle"]


def codes(bundle: dict[str, bytes], tiles: TileKeys | None = None, listed: bytes | None = None) -> list[str]:
    metadata = None if listed is None else {METADATA_FILE: listed}
    return sorted(set(check_bundle(bundle, metadata, tiles).code.tolist()))


def test_a_good_bundle_has_no_findings(bundle: dict[str, bytes]) -> None:
    assert codes(bundle, KEYS, metadata_bytes(PointCloudParams().tile_size_m, CORNERS)) == []


def edited(name: str, pattern: bytes, new: bytes) -> Callable[[dict[str, bytes]], dict[str, bytes]]:
    def edit(bundle: dict[str, bytes]) -> dict[str, bytes]:
        content, hits = re.subn(pattern, new, bundle[name], count=1)
        assert hits == 1
        return bundle | {name: content}

    return edit


BROKEN = {
    "bundle-file-missing": lambda b: {MAP: b[MAP]},
    "bundle-file-unreadable": lambda b: b | {MAP: b[MAP][:-40]},
    "bundle-file-unexpected": lambda b: b | {"lanelet2_map.pcd": b""},
    "projector-type-unknown": edited(PROJECTOR, rb"projector_type: \w+", b"projector_type: Mercator"),
    "metainfo-missing": edited(MAP, rb"<MetaInfo[^>]*/>", b""),
    "id-not-positive": edited(MAP, rb'<node id="\d+"', b'<node id="-5"'),
    "node-without-ele": edited(MAP, rb'<tag k="ele" v="[^"]*"/>', b""),
    "node-without-local": edited(MAP, rb'<tag k="local_x" v="[^"]*"/>', b'<tag k="local_x" v="here"/>'),
}


@pytest.mark.parametrize("code", sorted(BROKEN))
def test_what_is_broken_is_found(bundle: dict[str, bytes], code: str) -> None:
    assert code in codes(BROKEN[code](bundle))


def test_what_needs_a_place_on_the_earth_is_found(bundle: dict[str, bytes]) -> None:
    if b"projector_type: Local\n" in bundle[PROJECTOR]:
        pytest.skip("a local map has no latitude to compare with")
    moved = edited(MAP, rb'k="local_y" v="([-\d]+)\.', rb'k="local_y" v="\g<1>9.')
    assert codes(moved(bundle)) == ["coordinates-disagree"]
    blank = edited(MAP, rb'lat="[^"]*" lon="[^"]*"', b'lat="" lon=""')
    assert codes(blank(bundle)) == ["node-without-latlon"]
    lacking = edited(PROJECTOR, rb"(?s)(mgrs_grid|map_origin):.*", b"")
    assert "projector-field-missing" in codes(lacking(bundle))


def test_tiles_are_compared_with_their_list(bundle: dict[str, bytes]) -> None:
    def listed(corners: dict[str, tuple[int, int]]) -> bytes:
        return metadata_bytes(20, corners)

    assert codes(bundle, KEYS, listed({"0_0.pcd": (0, 0)})) == ["tile-not-listed"]
    assert codes(bundle, KEYS, listed(CORNERS | {"9_9.pcd": (180, 180)})) == ["tile-missing"]
    assert codes(bundle, KEYS, listed(CORNERS | {"0_0.pcd": (0, 20)})) == ["tile-misplaced"]
    assert codes(bundle, KEYS) == ["bundle-file-missing"]
    assert codes(bundle, KEYS, b"- 1\n") == ["bundle-file-missing"]


def test_many_of_one_kind_are_counted(bundle: dict[str, bytes]) -> None:
    content = re.sub(rb'<tag k="ele" v="[^"]*"/>', b"", bundle[MAP])
    found = check_bundle(bundle | {MAP: content}, None, None)
    assert len(found) < 60
    assert "more like this" in found.message[-1]


def test_every_rule_is_tested() -> None:
    elsewhere = {
        "projector-field-missing", "node-without-latlon", "coordinates-disagree", "tile-not-listed", "tile-missing",
        "tile-misplaced",
    }  # fmt: skip
    assert set(BROKEN) | elsewhere == set(CODES)


def test_hostile_documents_give_findings_not_crashes() -> None:
    anything: list[dict[str, Any]] = [
        {}, {MAP: b"", PROJECTOR: b""}, {MAP: b"<osm/>", PROJECTOR: b"a: [1"}, {MAP: b"\xff", PROJECTOR: b"[]"},
        {MAP: b"<osm version='0.6'/>", PROJECTOR: b"projector_type: {a: 1}\n"},
        {MAP: b"<osm version='0.6'><node id='1' lat='4' lon='5'/></osm>",
         PROJECTOR: b"projector_type: LocalCartesianUTM\nvertical_datum: x\nmap_origin: {latitude: .nan, longitude: a}\n"},
    ]  # fmt: skip
    for bundle in anything:
        assert len(check_bundle(bundle, None, KEYS)) > 0
