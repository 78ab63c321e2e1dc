"""A small DAG to try the engine with: files of numbers, doubled, summed, per item."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexmap_tasks.config import Params
from flexmap_tasks.engine.graph import Graph, SourceRef
from flexmap_tasks.engine.stage import stage
from flexmap_tasks.errors import InputError
from flexmap_tasks.model.arrays import Floats, Strings
from flexmap_tasks.model.source import Source

CALLS: list[str] = []


class Factor(Params):
    factor: float = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Numbers:
    value: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    parts: dict[str, Numbers]
    total: Numbers


@stage("numbers")
def read_numbers(source: Source) -> Numbers:
    CALLS.append("read_numbers")
    return Numbers(np.sort(np.loadtxt(source.path, ndmin=1)))


@stage("scaled")
def scale(numbers: Numbers, params: Factor) -> Numbers:
    CALLS.append("scale")
    return Numbers(numbers.value * params.factor)


@stage("split")
def split(numbers: Numbers) -> Parts:
    CALLS.append("split")
    even = numbers.value % 2 == 0
    parts = {"even": Numbers(numbers.value[even]), "odd": Numbers(numbers.value[~even])}
    return Parts(parts, Numbers(numbers.value.sum(keepdims=True)))


@stage("shifted")
def shift(item: Numbers, offset: Numbers) -> dict[str, Numbers]:
    CALLS.append("shift")
    moved = item.value + offset.value.sum()
    return {"low": Numbers(moved[moved < 10]), "high": Numbers(moved[moved >= 10])}


@stage("shifted")
def refuse_odd(item: Numbers, offset: Numbers) -> dict[str, Numbers]:
    if (item.value % 2 == 1).any():
        raise InputError("numbers.txt", "odd numbers are refused", "line 1")
    return {"low": item, "high": offset}


@stage("text")
def merge(parts: dict[str, Numbers]) -> dict[str, bytes]:
    CALLS.append("merge")
    return {"all.txt": " ".join(str(v) for key in sorted(parts) for v in parts[key].value).encode()}


@dataclass(frozen=True, slots=True, eq=False)
class Keys:
    key: Strings


@stage("listing")
def listing(items: Keys) -> dict[str, bytes]:
    CALLS.append("listing")
    return {"list.txt": ",".join(items.key.tolist()).encode()}


@stage("sum")
def add(a: Numbers, b: Numbers, extra: Numbers | None) -> Numbers:
    CALLS.append("add")
    return Numbers(np.array([a.value.sum() + b.value.sum() + (0 if extra is None else extra.value.sum())]))


def narrow_offset(key: str, values: Mapping[str, Any]) -> Mapping[str, Any]:
    """Only the even numbers are moved by the offset."""
    return {"offset": values["offset"] if key == "even" else Numbers(np.zeros(1))}


def toy_graph(file: Path, factor: float = 2.0) -> Graph:
    graph = Graph()
    numbers = graph.run(read_numbers, source=SourceRef(file))
    scaled = graph.run(scale, Factor(factor=factor), numbers=numbers)
    parts = graph.run(split, numbers=numbers)
    moved = graph.run_each(shift, "item", item=parts.field("parts"), offset=scaled, narrow=narrow_offset)
    merged = graph.run_each(merge, "parts", parts=moved.transpose())
    listed = graph.run(listing, items=merged.keys())
    total = graph.run(add, a=scaled, b=parts.field("total"), extra=None)
    graph.publish("sum.parquet", total)
    graph.publish("texts/", merged)
    graph.publish(".", listed)
    return graph
