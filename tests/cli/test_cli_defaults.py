"""The reference of settings is what the models say, and every configuration here is valid."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.formats.config_defaults import defaults_yaml
from flexmap_tasks.formats.config_file import dump_config, load_config

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


def test_defaults_yaml_is_up_to_date() -> None:
    assert (CONFIGS / "defaults.yaml").read_text() == defaults_yaml(FlexMapConfig), (
        "run `flexmap defaults > configs/defaults.yaml`"
    )


def test_defaults_yaml_holds_the_defaults() -> None:
    data = yaml.safe_load((CONFIGS / "defaults.yaml").read_text())
    data |= {"map": "x", "alignment": {**data["alignment"], "method": "rigid"}}
    config = FlexMapConfig.model_validate(data)
    bare = FlexMapConfig.model_validate(
        {
            "map": "x",
            "gnss": {"file": "path/to/file"},
            "slam": {"file": "path/to/file"},
            "alignment": {"method": "rigid"},
        }
    )
    assert config == bare


@pytest.mark.parametrize("name", ["demo.yaml", "garching.yaml"])
def test_a_configuration_survives_being_shown(name: str, tmp_path: Path) -> None:
    config = load_config(FlexMapConfig, CONFIGS / name)
    (tmp_path / "shown.yaml").write_text(dump_config(config))
    assert load_config(FlexMapConfig, tmp_path / "shown.yaml") == config
    assert config.gnss.file.is_absolute()
