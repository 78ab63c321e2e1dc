"""The reference of all settings: YAML with every default and what it means, made from the models."""

from __future__ import annotations

import typing
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from flexmap_tasks.formats.config_file import dump_yaml

INDENT = "  "


def defaults_yaml(kind: type[BaseModel]) -> str:
    """Every setting of `kind`: required ones are named as such, optional sections are commented out."""
    head = [
        f"# {_first_line(kind)}",
        "# Every setting with its default; written by `flexmap defaults`, do not edit.",
    ]
    return "\n".join([*head, *_section(kind)]) + "\n"


def _section(kind: type[BaseModel]) -> typing.Iterator[str]:
    for name, field in kind.model_fields.items():
        yield from _field(name, field)


def _field(name: str, field: FieldInfo) -> typing.Iterator[str]:
    model = _model_of(field.annotation)
    if model is None or isinstance(field.default, tuple):
        note = _note(field)
        if note:
            yield f"# {note}"
        yield from dump_yaml({name: _example(field)}).splitlines()
        return
    optional = field.default is None
    yield f"# {_first_line(model)}{' (optional)' if optional else ''}"
    inner = [f"{name}:", *(INDENT + line for line in _section(model))]
    yield from (f"# {line}" if optional else line for line in inner)


def _example(field: FieldInfo) -> Any:
    if field.default is not PydanticUndefined:
        default = field.default
        if isinstance(default, tuple):
            return [d.model_dump(mode="json") if isinstance(d, BaseModel) else d for d in default]
        return default
    return "path/to/file" if Path in _kinds(field.annotation) else "..."


def _note(field: FieldInfo) -> str:
    parts = [field.description] if field.description else []
    if field.default is PydanticUndefined:
        parts.append("required")
    choices = [a for k in _kinds(field.annotation) if _is_literal(k) for a in typing.get_args(k)]
    if len(choices) > 1:
        parts.append("one of " + ", ".join(str(c) for c in choices))
    return "; ".join(parts)


def _is_literal(kind: Any) -> bool:
    return typing.get_origin(kind) is typing.Literal


def _kinds(kind: Any) -> list[Any]:
    if _is_literal(kind) or typing.get_origin(kind) is tuple:
        return [kind]
    return [a for a in typing.get_args(kind) if a is not type(None)] or [kind]


def _model_of(kind: Any) -> type[BaseModel] | None:
    kinds = _kinds(kind)
    if any(_is_literal(k) for k in kinds):
        return None
    return next((k for k in kinds if isinstance(k, type) and issubclass(k, BaseModel)), None)


def _first_line(kind: type[BaseModel]) -> str:
    return (kind.__doc__ or "").strip().split("\n")[0]
