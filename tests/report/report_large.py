"""The same town many times over, side by side: a large map with real shapes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from flexmap_tasks.model.maps import LaneletMap
from flexmap_tasks.model.osm import Tags

IDS_APART = 1_000_000_000
APART_M = 1_500.0
IDS = {"id", "ref", "member_ref", "lanelet_id", "source_lanelet_id"}


def many(inputs: dict[str, Any], copies: int) -> dict[str, Any]:
    """Inputs of the report with `copies` times as many lanelets; roads and the drive stay as they are."""
    names = ("matches", "transfers", "lane_check")
    return inputs | {
        "source_map": _many(inputs["source_map"], copies),
        "final_map": _many(inputs["final_map"], copies),
        **{name: _many(inputs[name], copies) for name in names},
    }


def _many(value: Any, copies: int) -> Any:
    if isinstance(value, Tags):
        return Tags(_offsets(value.offset, copies), np.tile(value.key, copies), np.tile(value.value, copies))
    if not dataclasses.is_dataclass(value):
        return value
    fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if isinstance(value, LaneletMap):
        return LaneletMap(_many(value.document, copies), _apart(value.xyz_m, copies), value.findings)
    return type(value)(**{name: _field(name, field, copies) for name, field in fields.items()})


def _field(name: str, field: Any, copies: int) -> Any:
    if name == "offset":
        return _offsets(field, copies)
    if name in IDS:
        step = np.repeat(np.arange(copies), len(field)) * IDS_APART
        return np.tile(field, copies) + step
    if isinstance(field, np.ndarray) and not name.startswith("other"):
        return np.tile(field, (copies, 1)) if field.ndim == 2 else np.tile(field, copies)
    return _many(field, copies) if dataclasses.is_dataclass(field) else field


def _offsets(offset: np.ndarray, copies: int) -> np.ndarray:
    sizes = np.tile(np.diff(offset), copies)
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


def _apart(xyz_m: np.ndarray, copies: int) -> np.ndarray:
    side = int(np.ceil(np.sqrt(copies)))
    k = np.arange(copies)
    shift = np.column_stack([k % side, k // side, np.zeros(copies)]) * APART_M
    return np.tile(xyz_m, (copies, 1)) + np.repeat(shift, len(xyz_m), axis=0)
