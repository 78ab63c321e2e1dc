"""What every test may use."""

from __future__ import annotations

import os
from pathlib import Path

import hypothesis
import pytest

hypothesis.settings.register_profile("ci", derandomize=True)  # the same commit has the same outcome
if os.environ.get("CI"):
    hypothesis.settings.load_profile("ci")

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real inputs, which is not part of the project; skips where it is absent."""
    folder = SHARED / "data"
    if not folder.is_dir():
        pytest.skip("real inputs are absent: ../shared/data does not exist beside the project")
    return folder


@pytest.fixture(scope="session")
def judge() -> Path:
    """The independent judge of harm to a Lanelet2 map; skips where it is absent."""
    tool = SHARED / "tools" / "judge_map.py"
    if not tool.is_file():
        pytest.skip("the judge is absent: ../shared/tools/judge_map.py does not exist beside the project")
    return tool
