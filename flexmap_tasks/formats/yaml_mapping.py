"""Small YAML documents of other programs."""

from __future__ import annotations

from typing import Any

import yaml


def yaml_mapping(content: bytes) -> dict[str, Any] | None:
    """The mapping a document holds; None where it is no YAML or no mapping."""
    try:
        value = yaml.safe_load(content)
    except (yaml.YAMLError, ValueError):
        return None
    return {str(key): item for key, item in value.items()} if isinstance(value, dict) else None
