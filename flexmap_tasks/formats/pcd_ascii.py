"""The points of an ASCII PCD file: one line each, parsed in blocks by Arrow's CSV reader."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
from numpy.typing import NDArray

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.pcd_header import AXES, PcdHeader
from flexmap_tasks.model.source import Source

BLOCK_BYTES = 16 * 1024 * 1024
MAX_NUMBER_BYTES = 400
"""No number, however it is printed, needs more characters."""

_WHITE = bytes.maketrans(b"\t\r\v\f", b"    ")


def ascii_type(header: PcdHeader) -> np.dtype[Any]:
    """Type of the records of an ASCII file: packed, coordinates in float64."""
    return np.dtype(
        [(f.name, "<f8" if f.name in AXES else f.dtype, f.shape) for f in header.fields if not f.padding]
    )


def ascii_records(file: BinaryIO, header: PcdHeader, source: Source) -> Iterator[NDArray[np.void]]:
    """All points behind the header, in blocks; `file` stands at the first of them."""
    done = 0
    for line, text in _whole_lines(file, header, source):
        block = _parse(text, header, source, line)
        done += len(block)
        if done > header.points:
            raise InputError(source.name, f"POINTS says {header.points}, but there are more lines of data")
        if len(block):
            yield block
    if done < header.points:
        raise InputError(
            source.name, f"POINTS says {header.points}, but only {done} follow; the file is cut off"
        )


def _whole_lines(file: BinaryIO, header: PcdHeader, source: Source) -> Iterator[tuple[int, bytes]]:
    """Stretches of whole lines, each with the number of its first line in the file."""
    longest = MAX_NUMBER_BYTES * sum(f.count for f in header.fields)
    rest, line = b"", header.lines + 1
    while chunk := file.read(max(BLOCK_BYTES, longest)):
        text = rest + chunk
        end = text.rfind(b"\n") + 1
        if not end and len(text) > longest:
            raise InputError(source.name, "a line without an end; is this really DATA ascii?", f"line {line}")
        rest = text[end:]
        if end:
            yield line, text[:end]
            line += text.count(b"\n", 0, end)
    if rest.strip():
        yield line, rest


def _parse(text: bytes, header: PcdHeader, source: Source, first_line: int) -> NDArray[np.void]:
    columns = _columns(header)
    clean = _single_spaces(text)
    if clean == b"\n":
        return np.empty(0, ascii_type(header))
    try:
        table = pc.read_csv(
            pa.BufferReader(clean),
            read_options=pc.ReadOptions(column_names=list(columns), block_size=len(clean) + 1),
            parse_options=pc.ParseOptions(delimiter=" ", quote_char=False, escape_char=False),
            convert_options=pc.ConvertOptions(
                column_types=columns, null_values=[], strings_can_be_null=False
            ),
        )
    except pa.ArrowInvalid as error:
        raise _diagnose(text, header, source, first_line, str(error)) from None
    records = np.zeros(len(table), ascii_type(header))
    for i, (field, k) in enumerate((f, k) for f in header.fields for k in range(f.count)):
        if not field.padding:
            target = records[field.name] if field.count == 1 else records[field.name][:, k]
            target[...] = table.column(i).to_numpy()
    return records


def _columns(header: PcdHeader) -> dict[str, pa.DataType]:
    """Arrow's type per value of a line; coordinates in float64, padding as text that is not looked at."""
    types: dict[str, pa.DataType] = {}
    for field in header.fields:
        for _ in range(field.count):
            kind = pa.from_numpy_dtype(np.dtype("f8") if field.name in AXES else field.dtype)
            types[str(len(types))] = pa.binary() if field.padding else kind
    return types


def _single_spaces(text: bytes) -> bytes:
    """Values parted by exactly one space, no space at either end of a line, no empty lines."""
    if any(
        white in text for white in (b"\t", b"\r", b"\v", b"\f")
    ):  # looking is much cheaper than translating
        text = text.translate(_WHITE)
    while b"  " in text:
        text = text.replace(b"  ", b" ")
    return text.replace(b" \n", b"\n").replace(b"\n ", b"\n").strip(b" \n") + b"\n"


def _diagnose(text: bytes, header: PcdHeader, source: Source, first_line: int, reason: str) -> InputError:
    """The first line that breaks the rules, in words."""
    fields = [f for f in header.fields for _ in range(f.count)]
    for number, line in enumerate(text.split(b"\n"), first_line):
        words = line.split()
        if words and len(words) != len(fields):
            return InputError(
                source.name, f"expected {len(fields)} values per point, got {len(words)}", f"line {number}"
            )
        for word, field in zip(words, fields, strict=False):
            wrong = None if field.padding else _wrong(word, field.dtype)
            if wrong:
                shown = word[:40].decode("latin-1")
                return InputError(
                    source.name, f"field {field.name}: {wrong}, got {shown!r}", f"line {number}"
                )
    return InputError(
        source.name, f"the points cannot be read: {reason.splitlines()[0][:200]}", f"line {first_line}"
    )


def _wrong(word: bytes, dtype: np.dtype[Any]) -> str | None:
    try:
        if dtype.kind == "f":
            float(word)
            return None
        limits = np.iinfo(dtype)
        if limits.min <= int(word) <= limits.max:
            return None
    except ValueError:
        return "expected a number" if dtype.kind == "f" else "expected a whole number"
    return f"expected {limits.min} to {limits.max}"
