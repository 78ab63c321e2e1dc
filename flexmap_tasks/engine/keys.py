"""Action keys: a digest over everything that can change what a stage makes."""

from __future__ import annotations

import dataclasses
import functools
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flexmap_tasks.config import Params
from flexmap_tasks.engine.fingerprint import code_modules
from flexmap_tasks.engine.libraries import library_versions
from flexmap_tasks.engine.stage import AnyStage
from flexmap_tasks.store.artifact import canonical_json, digest_of

CODECS = ("flexmap_tasks.formats.artifacts", "flexmap_tasks.formats.columns")


def preimage(stage: AnyStage, params: Params | None, inputs: Mapping[str, str]) -> dict[str, Any]:
    """All that the key of an action is made of, readable; `inputs` holds artifact digests by name."""
    return {
        "stage": stage.name,
        "artifact": stage.artifact,
        "code": _code_of(stage.function.__module__),
        "params": params_json(params),
        "inputs": dict(inputs),
        "libraries": library_versions(),
    }


@functools.cache
def _code_of(module: str) -> dict[str, str]:
    """The code a stage's module can reach, walked once per process: stages that run per item ask for every item."""
    return code_modules(module, *CODECS)


def action_key(image: Mapping[str, Any]) -> str:
    """Digest of a preimage."""
    return digest_of(canonical_json(image))


def params_json(params: Params | None) -> dict[str, Any]:
    """Settings by value; empty ones left out, so that a new option does not spoil old results."""
    if params is None:
        return {}
    _refuse_paths(params)
    return typing.cast("dict[str, Any]", _without_empty(params.model_dump(mode="json")))


def _refuse_paths(params: Params) -> None:
    """A path says nothing about content: files are inputs, never settings of a stage."""
    for name in type(params).model_fields:
        if isinstance(getattr(params, name), Path):
            raise TypeError(f"{type(params).__name__}.{name} is a path and cannot be part of a key")


def _without_empty(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_empty(v) for k, v in value.items() if v is not None}
    return [_without_empty(v) for v in value] if isinstance(value, list) else value


@functools.cache
def input_types(stage: AnyStage) -> dict[str, Any]:
    """Types of a stage's inputs by name, `params` and the return value left out; gathered ones by their fields."""
    types: dict[str, Any] = {}
    for name, kind in _parameters(stage).items():
        types |= _fields(kind) if _is_gathered(kind) else {name: kind}
    return types


def arguments(stage: AnyStage, values: Mapping[str, Any]) -> dict[str, Any]:
    """What the stage is called with: inputs by name, None where there is none, gathered where it takes them as one.

    A parameter whose type is a dataclass with `gathered = True` takes the inputs that are named as its fields.
    """
    out: dict[str, Any] = {}
    for name, kind in _parameters(stage).items():
        if _is_gathered(kind):
            out[name] = kind(**{field: values.get(field) for field in _fields(kind)})
        else:
            out[name] = values.get(name)
    return out


def _parameters(stage: AnyStage) -> dict[str, Any]:
    hints = typing.get_type_hints(stage.function)
    return {name: kind for name, kind in hints.items() if name not in ("params", "return")}


def _is_gathered(kind: Any) -> bool:
    return dataclasses.is_dataclass(kind) and getattr(kind, "gathered", False)


def _fields(kind: Any) -> dict[str, Any]:
    hints = typing.get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}
