"""The truth is proven: with all noise at zero every world comes back as it is."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.scoring import ScoreParams, score_world
from flexmap_tasks.simulate.world import World

WORLDS = sorted((Path(__file__).resolve().parents[2] / "configs" / "worlds").glob("*.yaml"))


def scored(world: World) -> tuple[dict[str, Any], dict[str, Any]]:
    document = json.loads(score_world(ScoreParams(world=world))["evaluation.json"])
    return {m["name"]: m["value"] for m in document["measures"]}, document["matching"]


@pytest.mark.parametrize("file", WORLDS, ids=lambda f: f.stem)
def test_a_world_without_noise_comes_back(file: Path) -> None:
    figures, matching = scored(load_config(World, file).noiseless())
    assert figures["trajectory_planar_max"] <= 0.001
    assert figures["map_planar_max"] <= 0.001
    assert matching["release"]["link"]["f1"] >= 0.9999
    assert matching["release"]["all"]["f1"] >= 0.9999


def test_noise_is_seen_and_survived() -> None:
    world = load_config(World, WORLDS[-1]).changed(osm={"field_sigma_m": 3.0})
    figures, matching = scored(world)
    assert figures["trajectory_planar_rmse"] > 0.001
    assert matching["release"]["all"]["f1"] > matching["nearest_way"]["all"]["f1"] - 0.02
    assert matching["release"]["all"]["f1"] >= 0.95
