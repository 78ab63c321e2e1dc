"""Configurations as YAML: read with one clear line per mistake, written in full."""

from __future__ import annotations

import functools
import os
import typing
from collections.abc import Hashable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from flexmap_tasks.config import Params
from flexmap_tasks.errors import ConfigError
from flexmap_tasks.model.source import BUCKET

P = TypeVar("P", bound=Params)


MAX_DEPTH = 50
"""No configuration needs more."""


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]  # C reads 7 times faster
    """Safe YAML in which a key that stands twice is an error."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=deep)
            if not isinstance(key, Hashable):
                break  # refused below, with its place
            if key in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"key {key!r} stands twice", problem_mark=key_node.start_mark
                )
            seen.add(key)
        found: dict[Any, Any] = super().construct_mapping(node, deep)
        return found


def load_config(kind: type[P], file: Path, overrides: Iterable[str] = ()) -> P:
    """The settings of `kind` in `file`, with `key.path=value` overrides; paths relative to the file.

    Overriding paths are relative to the working directory. Raises ConfigError.
    """
    data = _resolve_paths(kind, _read(file), file.parent.resolve())
    _override(kind, data, overrides)
    return _validated(kind, data, file.name)


def change_config(config: P, overrides: Iterable[str]) -> P:
    """The same settings with some overridden, as `load_config` does. Raises ConfigError."""
    data = config.model_dump(mode="json", exclude_unset=True)
    _override(type(config), data, overrides)
    return _validated(type(config), data, "--set")


def parse_values(text: str, source: str) -> list[Any]:
    """Values between commas, each as YAML. Raises ConfigError."""
    values: list[Any] = _parse(f"[{text}]", source)
    return values


def _override(kind: type[BaseModel], data: dict[str, Any], overrides: Iterable[str]) -> None:
    for override in overrides:
        key, equals, text = override.partition("=")
        if not equals or not key:
            raise ConfigError("--set", f"expected key.path=value, got {override!r}")
        value = _parse(text, f"--set {key}")
        _put(data, key.split("."), _resolve_paths_at(kind, key.split("."), value), override)


def _validated(kind: type[P], data: dict[str, Any], source: str) -> P:
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "top level"
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        raise ConfigError(source, f"{_readable(first)}{more}", where) from None


def dump_config(config: BaseModel) -> str:
    """Settings as YAML, every one with its value."""
    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, allow_unicode=True, width=100)


def dump_yaml(data: Any) -> str:
    """Plain data as YAML in the order given."""
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=100)


def _read(file: Path) -> dict[str, Any]:
    try:
        text = file.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(
            str(file), f"no such configuration ({error.strerror}); give the path of a YAML file"
        ) from error
    except UnicodeDecodeError:
        raise ConfigError(file.name, "is not UTF-8 text; a configuration is a YAML file") from None
    data = _parse(text, file.name)
    if not isinstance(data, dict):
        raise ConfigError(file.name, "expected keys and values (YAML), found something else")
    return data


def _parse(text: str, source: str) -> Any:
    try:
        _refuse_depth(text, source)
        return yaml.load(text, _Loader)  # noqa: S506 - a SafeLoader
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}" if error.problem_mark else None
        raise ConfigError(source, f"is not valid YAML: {error.problem}", line) from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ConfigError(source, f"is not valid YAML: {str(error).splitlines()[0]}") from None


def _refuse_depth(text: str, source: str) -> None:
    """Reading nested values recurses, in C where nothing catches it; telling the depth does not."""
    depth = 0
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > MAX_DEPTH:
            line = f"line {event.start_mark.line + 1}" if event.start_mark else None
            raise ConfigError(source, f"is nested deeper than {MAX_DEPTH} levels", line)


def _readable(error: Mapping[str, Any]) -> str:
    if error["type"] == "extra_forbidden":
        return "unknown key; see configs/defaults.yaml for those there are"
    if error["type"] == "missing":
        return "is missing"
    found = error.get("input")
    shown = "" if isinstance(found, dict | list) else f", got {found!r}"
    return f"{error['msg'].removeprefix('Value error, ')}{shown}"


def _put(data: dict[str, Any], keys: list[str], value: Any, override: str) -> None:
    for key in keys[:-1]:
        inner = data.setdefault(key, {})
        if inner is None:
            inner = data[key] = {}
        if not isinstance(inner, dict):
            raise ConfigError("--set", f"{override!r} goes below {key!r}, which is a value")
        data = inner
    data[keys[-1]] = value


def _kinds(kind: Any) -> list[Any]:
    """The alternatives of a type, None left out."""
    return [a for a in typing.get_args(kind) if a is not type(None)] or [kind]


def _model_of(kind: Any) -> type[BaseModel] | None:
    return next((k for k in _kinds(kind) if isinstance(k, type) and issubclass(k, BaseModel)), None)


@functools.cache
def _fields_with_paths(kind: type[BaseModel]) -> Mapping[str, type[BaseModel] | None]:
    """Fields that hold a path (None) or settings in which a path may stand (their model)."""
    found: dict[str, type[BaseModel] | None] = {}
    for name, field in kind.model_fields.items():
        model = _model_of(field.annotation)
        if Path in _kinds(field.annotation):
            found[name] = None
        elif model is not None:
            found[name] = model
    return found


def _resolve_paths(kind: type[BaseModel], data: dict[str, Any], base: Path) -> dict[str, Any]:
    out = dict(data)
    for name, model in _fields_with_paths(kind).items():
        value = out.get(name)
        if model is None:
            out |= {name: _absolute(value, base)} if isinstance(value, str) else {}
        elif isinstance(value, dict):
            out[name] = _resolve_paths(model, value, base)
        elif isinstance(value, list):
            out[name] = [_resolve_paths(model, v, base) if isinstance(v, dict) else v for v in value]
    return out


def _absolute(path: str, base: Path) -> str:
    """A path from the folder it is relative to; one in a bucket as it is.

    Asked of every file of a fleet: only what needs it is looked up.
    """
    if path.startswith(BUCKET):
        return path
    whole = os.path.join(base, os.path.expanduser(path))  # noqa: PTH111, PTH118 - see above
    return os.path.realpath(whole) if ".." in path else os.path.normpath(whole)


def _resolve_paths_at(kind: type[BaseModel], keys: list[str], value: Any) -> Any:
    for key in keys[:-1]:
        field = kind.model_fields.get(key)
        model = _model_of(field.annotation) if field else None
        if model is None:
            return value
        kind = model
    return _resolve_paths(kind, {keys[-1]: value}, Path.cwd())[keys[-1]]
