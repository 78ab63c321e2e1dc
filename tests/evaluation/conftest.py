"""A simulated world taken through the whole update."""

from __future__ import annotations

from pathlib import Path

import pytest
from evaluation_run import WORLDS, Run, update

from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.simulate.world import World


@pytest.fixture(scope="session")
def small_town() -> World:
    return load_config(World, WORLDS / "small_town.yaml")


@pytest.fixture(scope="session")
def noiseless_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("noiseless")


@pytest.fixture(scope="session")
def noiseless(small_town: World, noiseless_folder: Path) -> Run:
    """A town recorded without any error, and what the update makes of it."""
    return update(small_town.noiseless(), noiseless_folder)
