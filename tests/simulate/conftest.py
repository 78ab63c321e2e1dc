"""Worlds for the tests of simulate, made once."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import pytest

from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.simulate.generate import Simulation, simulate
from flexmap_tasks.simulate.world import World

WORLDS = Path(__file__).resolve().parents[2] / "configs" / "worlds"
NAMES = ("city_grid", "left_hand", "motorway", "multilevel", "roundabouts", "small_town")


@lru_cache
def world(name: str) -> World:
    return load_config(World, WORLDS / f"{name}.yaml")


@lru_cache
def simulated(name: str, noiseless: bool) -> Simulation:
    return simulate(world(name).noiseless() if noiseless else world(name))


@pytest.fixture(params=NAMES)
def noisy(request) -> Simulation:
    """Every world as it stands in configs/worlds."""
    return simulated(request.param, False)


@pytest.fixture(params=NAMES)
def exact(request) -> Simulation:
    """Every world with all errors at zero."""
    return simulated(request.param, True)


@pytest.fixture(scope="session")
def small_town() -> World:
    return world("small_town")
