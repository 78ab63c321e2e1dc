"""Runs of the graph without a store, for tests of what is made of their results."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.graph import Ref, SourceRef
from flexmap_tasks.engine.keys import arguments, input_types
from flexmap_tasks.engine.stage import AnyStage
from flexmap_tasks.model.source import Source
from flexmap_tasks.pipeline import map_update

GARCHING = {
    "map": "garching",
    "gnss": {"file": "route_1_GPS.txt"},
    "slam": {"file": "route1_pose_kitti.txt"},
    "lanelet_map": {"file": "lanelet2_route_1.osm"},
    "osm": {"file": "osm_2023.osm"},
    "alignment": {"method": "rubber_sheet", "control_points_file": "control_points_peer.csv"},
}


def garching(folder: Path, **changes: Any) -> FlexMapConfig:
    """The configuration of the route in Garching, with its files in `folder`."""
    settings = {**GARCHING, **changes}
    placed: dict[str, Any] = {}
    for name, value in settings.items():
        if isinstance(value, dict):
            placed[name] = {k: str(folder / v) if k.endswith("file") else v for k, v in value.items()}
        else:
            placed[name] = value
    return FlexMapConfig.model_validate(placed)


def inputs_of(config: FlexMapConfig, *stages: str) -> dict[str, dict[str, Any]]:
    """What each of the named stages is fed with, by stage and input; stages per item are not run."""
    graph = map_update(config)
    values: dict[str, Any] = {}
    found: dict[str, dict[str, Any]] = {}
    for node in graph:
        if any(isinstance(r, Ref) and r.node not in values for r in node.inputs.values()) or node.each:
            continue
        inputs = dict.fromkeys(input_types(node.stage)) | {
            name: _value(values, ref) for name, ref in node.inputs.items()
        }
        if node.params is not None:
            inputs["params"] = node.params
        if node.name in stages:
            found[node.name] = inputs
            if len(found) == len(stages):
                break
        values[node.name] = made(node.stage, inputs)
    return found


def made(stage: AnyStage, inputs: dict[str, Any]) -> Any:
    """What a stage makes of inputs by name, as `inputs_of` gives them."""
    params = {"params": inputs["params"]} if "params" in inputs else {}
    return stage(**arguments(stage, inputs), **params)


def _value(values: dict[str, Any], ref: Ref | SourceRef) -> Any:
    if isinstance(ref, SourceRef):
        return Source(ref.name, ref.path)
    value = values[ref.node]
    return getattr(value, ref.part) if ref.part else value


@functools.cache
def garching_inputs(folder: Path) -> dict[str, Any]:
    """What the report of Garching is made of."""
    return inputs_of(garching(folder), "report")["report"]
